"""Long-term tracking: says when the target is lost, looks for it, and takes it back only when it is sure.

`Tracker.update` always returns a box, also when the target is gone: a correlation filter always has a maximum.
This is the answer to that. It learns nothing while it is unsure, so that it still knows the target when it comes
out again, and it would rather stay lost than follow something else.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import assert_never

from mscf.arrays import Image
from mscf.config import TrackerConfig
from mscf.errors import BoxError, ConfigError, FrameError, TrackerNotInitialisedError
from mscf.frame import check_frame
from mscf.geometry import Box
from mscf.kernels import Kernels
from mscf.search import RANKS, Looks, place_around
from mscf.tracker import Snapshot, Tracker, TrackResult

MIN_SHARE_INSIDE = 0.5  # of a box's area, within the frame: with less the box's centre, and its size, mean nothing
MAX_STEP = 1.0  # of a candidate from frame to frame, over its size: what is confirmed does not jump about


class TrackStatus(Enum):
    """What is known of the target."""

    TRACKING = auto()  # the box is a measurement
    UNSURE = auto()  # it may be hidden or the box may be off it: nothing is learned
    LOST = auto()  # it is searched for; the box is where it was trusted last
    CONFIRMING = auto()  # something like it was found and is watched: not a measurement yet


@dataclass(frozen=True, slots=True, kw_only=True)
class LongTermPolicy:
    """When to doubt, when to give up, what to take back.

    Raises
    ------
    ConfigError
        If a value is outside its range: the text names the field, the value and the range.
    """

    unsure_below: float = 0.4  # confidence from which on a box is a measurement
    trusted_from: float = 0.5  # confidence from which on a frame is one to go back to, and a candidate is taken
    min_similarity: float = 0.4  # of a candidate's looks with those of trusted frames, -1..1
    lost_after_s: float = 0.5  # since the last measurement
    size_ratio: float = 2.0  # a candidate's size over the last trusted one, at most, and at least its inverse
    confirm_frames: int = 4  # consistent frames before a candidate is the target

    def __post_init__(self) -> None:
        ranges = {
            "unsure_below": (0, 1),
            "trusted_from": (self.unsure_below, 1),
            "min_similarity": (-1, 1),
            "lost_after_s": (0, 60),
            "size_ratio": (1, 10),
            "confirm_frames": (2, 100),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"{name} must be from {low:g} to {high:g}, got {value!r}")


@dataclass(frozen=True, slots=True)
class Expected:
    """Where a lost target should be, as somebody knows who knows how the camera moved.

    xy : `Box.center_xy`, px; may lie outside the frame.
    growth : its size over that of the last box that was trusted. A filter sees
        little at a wrong size.
    """

    xy: tuple[float, float]
    growth: float = 1.0


@dataclass(frozen=True, slots=True)
class LongTermResult:
    """What is known of the target in one frame."""

    status: TrackStatus
    box: Box  # 0-based px; LOST: where the target was trusted last
    confidence: float  # 0..1; LOST: of the best place looked at
    peak: float  # maximum of that response
    threat: float  # mutation threat factor of that response
    scale: float  # size of the box over that in the first frame

    @property
    def is_measured(self) -> bool:
        """Whether the box is believed to be where the target is in this frame: the only one to act on."""
        return self.status is TrackStatus.TRACKING


@dataclass(frozen=True, slots=True)
class Memory:
    """What is carried from frame to frame; replaced whole."""

    status: TrackStatus
    time_s: float  # of the last frame; -inf before the first update
    measured_s: float  # of the last measurement, or of the first update while there is none
    trusted: Snapshot  # the tracker after the last trusted frame
    box: Box  # of the last trusted frame
    scale: float  # of the last trusted frame
    looks: Looks  # of the target in trusted frames
    candidate: Box  # CONFIRMING: the last one
    searched: int  # frames since the loss
    confirmed: int  # consistent frames since something was found


class LongTermTracker:
    """A `Tracker` that knows when it has lost its target, and finds it again.

    Frames come with their times, so that the policy holds at any frame rate.

    Examples
    --------
    >>> import numpy as np
    >>> from mscf import Box, LongTermTracker
    >>> frame = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    >>> tracker = LongTermTracker()
    >>> tracker.init(frame, Box(x=100, y=80, w=41, h=31))
    >>> tracker.update(frame, 0.1).status.name
    'TRACKING'
    >>> gone = np.full_like(frame, 128)
    >>> [tracker.update(gone, time_s).status.name for time_s in (0.2, 0.5, 0.8)]
    ['UNSURE', 'UNSURE', 'LOST']
    """

    def __init__(
        self,
        config: TrackerConfig | None = None,
        policy: LongTermPolicy = LongTermPolicy(),
        kernels: Kernels | None = None,
    ) -> None:
        self._tracker = Tracker(config, kernels)
        self._policy = policy
        self._memory: Memory | None = None

    def init(self, frame: Image, box: Box) -> None:
        """Learn the target in `box` of `frame`; may be called again for another target.

        Raises
        ------
        FrameError, BoxError
            As `Tracker.init`.
        """
        self._tracker.init(frame, box)
        self._memory = Memory(
            status=TrackStatus.TRACKING,
            time_s=-math.inf,
            measured_s=-math.inf,
            trusted=self._tracker.snapshot(),
            box=box,
            scale=1.0,
            looks=Looks.of(frame, box, self._tracker.kernels),
            candidate=box,
            searched=0,
            confirmed=0,
        )

    def update(self, frame: Image, time_s: float, expected: Expected | None = None) -> LongTermResult:
        """Locate the target in `frame`, or look for it.

        Parameters
        ----------
        frame : of the shape and dtype given to `init`.
        time_s : when it was taken, on any clock; not before the last one.
        expected : where the target is expected while it is lost; None: where it was trusted last, at that size.

        Raises
        ------
        TrackerNotInitialisedError, FrameError
            As `Tracker.update`; FrameError also where the time is not finite or runs backwards.
        BoxError
            If `expected` is not finite, or its growth not above 0.
        """
        memory = self._memory
        if memory is None:
            raise TrackerNotInitialisedError("update was called before init: call init(frame, box) first")
        check_frame(frame)
        if not (math.isfinite(time_s) and time_s >= memory.time_s):
            raise FrameError(f"the time of a frame must be finite and not before {memory.time_s:g} s, got {time_s!r}")
        if expected is not None and not (
            all(map(math.isfinite, (*expected.xy, expected.growth))) and expected.growth > 0
        ):
            raise BoxError(f"expected must be finite, its growth above 0, got {expected!r}")
        first = time_s if memory.measured_s == -math.inf else memory.measured_s
        memory = replace(memory, time_s=time_s, measured_s=first)
        match memory.status:
            case TrackStatus.TRACKING | TrackStatus.UNSURE:
                self._memory, result = self._follow(frame, memory)
            case TrackStatus.CONFIRMING:
                self._memory, result = self._confirm(frame, memory)
            case TrackStatus.LOST:
                self._memory, result = self._search(frame, memory, expected or Expected(memory.box.center_xy))
            case _ as never:
                assert_never(never)
        return result

    def _follow(self, frame: Image, memory: Memory) -> tuple[Memory, LongTermResult]:
        found = self._tracker.update(frame, learn=lambda found: self._is_measurement(frame, found))
        if self._is_measurement(frame, found):
            after = replace(memory, status=TrackStatus.TRACKING, measured_s=memory.time_s)
            if found.confidence >= self._policy.trusted_from:
                after = self._trusting(frame, found, after)
            return after, _said(TrackStatus.TRACKING, found)
        if memory.time_s - memory.measured_s < self._policy.lost_after_s:
            return replace(memory, status=TrackStatus.UNSURE), _said(TrackStatus.UNSURE, found)
        return self._lose(found, replace(memory, searched=0))

    def _lose(self, found: TrackResult, memory: Memory) -> tuple[Memory, LongTermResult]:
        self._tracker.restore(memory.trusted)
        where = replace(found, box=memory.box, scale=memory.scale)
        return replace(memory, status=TrackStatus.LOST, confirmed=0), _said(TrackStatus.LOST, where)

    def _search(self, frame: Image, memory: Memory, expected: Expected) -> tuple[Memory, LongTermResult]:
        turn = memory.searched
        # no size is asked for that a candidate may not have
        growth = min(max(expected.growth, 1 / self._policy.size_ratio), self._policy.size_ratio)
        scale = memory.scale * growth
        near = self._tracker.look(frame, place_around(frame.shape[:2], memory.box, expected.xy, turn), scale)
        anywhere_xy = memory.looks.best_match(frame, turn % RANKS)
        sightings = [near] if anywhere_xy is None else [near, self._tracker.look(frame, anywhere_xy, scale)]
        sightings.sort(key=lambda sighting: sighting.confidence, reverse=True)
        memory = replace(memory, searched=turn + 1)
        for sighting in sightings:
            if self._may_be_target(frame, sighting, memory):
                self._tracker.resume(sighting)
                after = replace(memory, status=TrackStatus.CONFIRMING, candidate=sighting.box, confirmed=1)
                return after, _said(TrackStatus.CONFIRMING, sighting)
        return self._lose(sightings[0], memory)

    def _confirm(self, frame: Image, memory: Memory) -> tuple[Memory, LongTermResult]:
        confirmed = memory.confirmed + 1
        is_last = confirmed >= self._policy.confirm_frames

        def is_consistent(found: TrackResult) -> bool:
            is_near = step_of(memory.candidate, found.box) <= MAX_STEP
            return is_near and self._may_be_target(frame, found, memory)

        found = self._tracker.update(frame, learn=lambda found: is_last and is_consistent(found))
        if not is_consistent(found):
            return self._lose(found, memory)
        if not is_last:
            after = replace(memory, candidate=found.box, confirmed=confirmed)
            return after, _said(TrackStatus.CONFIRMING, found)
        after = replace(memory, status=TrackStatus.TRACKING, measured_s=memory.time_s)
        return self._trusting(frame, found, after), _said(TrackStatus.TRACKING, found)

    def _is_measurement(self, frame: Image, found: TrackResult) -> bool:
        is_inside = share_inside(found.box, frame) >= MIN_SHARE_INSIDE
        # a box that cannot shrink on with its target finds the place where the target was, and a size that never was
        is_sized = not found.is_held and not found.is_smallest
        return found.confidence >= self._policy.unsure_below and is_inside and is_sized

    def _may_be_target(self, frame: Image, found: TrackResult, memory: Memory) -> bool:
        policy = self._policy
        ratio = found.scale / memory.scale
        return (
            found.confidence >= policy.trusted_from
            and not found.is_held
            and 1 / policy.size_ratio <= ratio <= policy.size_ratio
            and share_inside(found.box, frame) >= MIN_SHARE_INSIDE
            and memory.looks.similarity(frame, found.box) >= policy.min_similarity
        )

    def _trusting(self, frame: Image, found: TrackResult, memory: Memory) -> Memory:
        return replace(
            memory,
            trusted=self._tracker.snapshot(),
            box=found.box,
            scale=found.scale,
            looks=memory.looks.after(frame, found.box),
        )


def _said(status: TrackStatus, found: TrackResult) -> LongTermResult:
    return LongTermResult(status, found.box, found.confidence, found.peak, found.threat, found.scale)


def share_inside(box: Box, frame: Image) -> float:
    """Share of a box's area that is within the frame, 0..1."""
    rows, cols = frame.shape[:2]
    return box.overlap_px2(Box(0, 0, cols, rows)) / (box.w * box.h)


def step_of(one: Box, other: Box) -> float:
    """Distance of two boxes' centres over the size of the first."""
    return math.dist(one.center_xy, other.center_xy) / math.sqrt(one.w * one.h)
