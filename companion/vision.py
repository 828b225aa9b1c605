"""From frames to track samples: the long-term tracker and the selection in force. No thread, no clock."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from companion.point_selection import box_around
from companion.types import Frame, Selection, TrackSample
from mscf import Expected, LongTermTracker, MscfError, TrackerConfig
from mscf.kernels.choice import chosen_kernels

if TYPE_CHECKING:
    from mscf.arrays import Image

MAX_FROZEN_S = 0.5
FROZEN = "the camera repeats one picture"


class Vision:
    """Tracks what is selected, frame by frame.

    A selection takes effect on the first frame after it. A frame or box that the tracker refuses, and whatever else
    it raises, becomes the `fault` of every sample until the next selection: a loss, not an exception, because a
    process that dies leaves the vehicle with its last velocity for seconds.

    A picture that repeats itself to the bit for 0.5 s is no measurement, however new its time stamp: no sensor in
    flight is that quiet, and a vehicle that turns by such a picture turns for ever.
    """

    def __init__(self, preset: str = "mscf") -> None:
        self._config = TrackerConfig.preset(preset)
        self._kernels = chosen_kernels()
        self._tracker: LongTermTracker | None = None
        self._selection = 0
        self._fault = ""  # of the selection in force
        self._last: Image | None = None  # every eighth pixel of the newest picture that was new,
        self._renewed_s = -math.inf  # and when that was captured

    def see(self, frame: Frame, selection: Selection, expected: Expected | None) -> TrackSample:
        """What is to be said of `frame`; its `finished_s` is for the caller to set.

        Parameters
        ----------
        expected : where the target should be if it is searched for; None: no idea.
        """
        height, width = frame.image.shape[:2]
        nothing = TrackSample(frame.seq, frame.captured_s, frame.captured_s, (height, width), selection.number)
        is_frozen = self._is_frozen(frame)
        try:
            if selection.number != self._selection:
                self._selection = selection.number
                self._start(frame, selection)
            if self._tracker is None:
                return replace(nothing, fault=self._fault)
            result = self._tracker.update(frame.image, frame.captured_s, expected)
        except Exception as error:  # noqa: BLE001  # see the class; MscfError: the camera was changed, or a bad box
            self._tracker = None
            self._fault = str(error) if isinstance(error, MscfError) else f"{type(error).__name__}: {error}"
            return replace(nothing, fault=self._fault)
        return replace(
            nothing,
            status=result.status,
            is_measured=result.is_measured and not is_frozen,
            box=result.box,
            confidence=result.confidence,
            peak=result.peak,
            threat=result.threat,
            fault=FROZEN if is_frozen else "",
        )

    def _start(self, frame: Frame, selection: Selection) -> None:
        """Begin anew."""
        self._tracker, self._fault, box = None, "", selection.box
        if box is None:
            return
        if selection.is_point and box.is_finite:
            # a box counts areas, a point the middles of pixels
            u, v = box.center_xy
            box = box_around(frame.image, (u - 0.5, v - 0.5), box.w / 2)
        tracker = LongTermTracker(self._config, kernels=self._kernels)
        tracker.init(frame.image, box)
        self._tracker = tracker

    def _is_frozen(self, frame: Frame) -> bool:
        thinned = frame.image[::8, ::8]
        if self._last is None or not np.array_equal(thinned, self._last):
            self._last, self._renewed_s = thinned.copy(), frame.captured_s
        return frame.captured_s - self._renewed_s >= MAX_FROZEN_S
