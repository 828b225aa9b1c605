"""What the loop sees with: the rendered camera and the real tracker, or the truth of the geometry.

The truth is for the many runs that ask about control alone; it costs a hundredth of a rendered frame.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.types import Frame, Selection, TrackSample
from companion.vision import Vision
from mscf import Box, Expected, TrackStatus
from mscf.arrays import Image
from sim.camera import Truth, observe, render
from sim.stages import Stage
from sim.world import Pose

_MIN_VISIBLE = 0.5  # share of the target that a tracker needs to hold it
_MIN_HEIGHT_PX = 10.0  # of its box


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame's circumstances."""

    seq: int
    time_s: float  # since the start
    world_s: float  # of the world's movers
    pose: Pose  # of what carries the camera, the vehicle or its gimbal, when the shutter opens
    pose_at_close: Pose
    gain: float = 1.0  # brightness


@dataclass(frozen=True, slots=True)
class Sight:
    """What came of one frame; `image` is None where nothing was rendered."""

    sample: TrackSample
    truth: Truth
    image: Image | None


class Eyes(Protocol):
    """From an exposure to a sample of the track."""

    def see(self, exposure: Exposure, captured_s: float, selection: Selection, expected: Expected | None) -> Sight: ...


class RenderedEyes:
    """The camera of a stage, and the flight code's tracker behind it."""

    def __init__(self, stage: Stage, preset: str = "mscf") -> None:
        self._stage = stage
        self._vision = Vision(preset)

    def see(self, exposure: Exposure, captured_s: float, selection: Selection, expected: Expected | None) -> Sight:
        """Render, then track."""
        stage = self._stage
        image, truth = render(
            stage.world,
            stage.carried_camera,
            exposure.pose,
            exposure.world_s,
            pose_at_close=exposure.pose_at_close,
            exposure_gain=exposure.gain,
            noise_time_s=exposure.time_s,
        )
        image.setflags(write=False)
        frame = Frame(image, exposure.seq, captured_s)
        return Sight(self._vision.see(frame, selection, expected), truth, image)


class TrueEyes:
    """A tracker that reports the true box, a little noisy, wherever half of the target is visible.

    Whatever is selected counts as the target: who wants a wrong selection needs the rendered eyes.
    """

    def __init__(self, stage: Stage, seed: int = 0, noise_px: float = 0.5) -> None:
        self._stage = stage
        self._rng = np.random.default_rng((seed, 11))
        self._noise_px = noise_px

    def see(self, exposure: Exposure, captured_s: float, selection: Selection, expected: Expected | None) -> Sight:
        """Look the truth up."""
        stage = self._stage
        truth = observe(stage.world, stage.carried_camera, exposure.pose, exposure.world_s)
        dx, dy, dh = (float(value) for value in self._rng.normal(0, self._noise_px, 3))
        if selection.box is None:
            sample = TrackSample(exposure.seq, captured_s, captured_s, stage.camera.size_hw, selection.number)
            return Sight(sample, truth, None)
        is_large = truth.box is not None and truth.box.h >= _MIN_HEIGHT_PX
        is_visible = is_large and truth.visible_share >= _MIN_VISIBLE
        box = truth.box
        if box is not None:
            box = Box(box.x + dx, box.y + dy, box.w, max(box.h + dh, 1.0))
        sample = TrackSample(
            exposure.seq,
            captured_s,
            captured_s,
            stage.camera.size_hw,
            selection.number,
            TrackStatus.TRACKING if is_visible else TrackStatus.LOST,
            is_visible,
            box if is_visible else None,
            confidence=0.95 if is_visible else 0.1,
            peak=1.0 if is_visible else 0.0,
        )
        return Sight(sample, truth, None)
