"""Trackers to compare with, behind the two verbs `init` and `update`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2

from mscf.arrays import Image
from mscf.config import PRESETS, TrackerConfig
from mscf.errors import ConfigError
from mscf.features.color_names import load_table
from mscf.geometry import Box
from mscf.tracker import Tracker

CSRT = "csrt"
CSRT_MISSING = (
    "OpenCV's CSRT is not in this cv2: in an environment of its own, install opencv-contrib-python-headless "
    "in place of opencv-python-headless (never both; `make bench` does it)"
)


class Located(Protocol):
    """Anything with a box."""

    @property
    def box(self) -> Box: ...


class BoxTracker(Protocol):
    """What is asked of a tracker."""

    def init(self, frame: Image, box: Box, /) -> None: ...

    def update(self, frame: Image, /) -> Located: ...


@dataclass(frozen=True, slots=True)
class PeerResult:
    """A peer's answer; its last box where it reports a loss."""

    box: Box
    is_found: bool


class CsrtTracker:
    """OpenCV's CSR-DCF with its default parameters."""

    def __init__(self) -> None:
        """Make it.

        Raises
        ------
        ConfigError
            If this cv2 has no CSRT.
        """
        if not has_csrt():
            raise ConfigError(CSRT_MISSING)
        self._tracker: Any = cv2.TrackerCSRT.create()  # type: ignore[attr-defined]  # not in every cv2
        self._box = Box(0, 0, 0, 0)

    def init(self, frame: Image, box: Box, /) -> None:
        """Start; OpenCV takes whole pixels."""
        self._tracker.init(frame, (round(box.x), round(box.y), round(box.w), round(box.h)))
        self._box = box

    def update(self, frame: Image, /) -> PeerResult:
        """Follow."""
        is_found, (x, y, w, h) = self._tracker.update(frame)
        if is_found:
            self._box = Box(x, y, w, h)
        return PeerResult(self._box, is_found)


def has_csrt() -> bool:
    """Whether the installed cv2 has CSRT, which only its contrib builds have."""
    return hasattr(cv2, "TrackerCSRT")


def tracker_factory(name: str, color_table: Path | None = None) -> Callable[[], BoxTracker]:
    """What makes a tracker called `name`: a preset of ours, or `csrt`.

    Raises
    ------
    ConfigError
        If there is no such tracker, or its table cannot be read, or this cv2 has it not.
    """
    if name == CSRT:
        CsrtTracker()  # says now what is missing
        return CsrtTracker
    if name not in PRESETS:
        raise ConfigError(f"unknown tracker {name!r}: choose from {', '.join((*PRESETS, CSRT))}")
    config = TrackerConfig.preset(name, color_table=color_table)
    load_table(color_table)  # says now what is wrong with it
    return lambda: Tracker(config)
