"""Trackers to measure, behind the two verbs `init` and `update`: ours, OpenCV's, and one's own."""

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import cv2

from mscf.arrays import Image
from mscf.config import PRESETS, TrackerConfig
from mscf.errors import BoxError, ConfigError
from mscf.features.color_names import load_table
from mscf.geometry import Box
from mscf.tracker import Tracker

CSRT = "csrt"
OPENCV = (CSRT, "kcf", "mosse", "mil", "nano", "vit")
_CLASSES = {
    CSRT: "TrackerCSRT",
    "kcf": "TrackerKCF",
    "mosse": "legacy.TrackerMOSSE",
    "mil": "TrackerMIL",
    "nano": "TrackerNano",
    "vit": "TrackerVit",
}
_CONTRIB = (
    "in an environment of its own, install opencv-contrib-python-headless in place of opencv-python-headless "
    "(never both; `make bench` does it)"
)
CSRT_MISSING = f"OpenCV's CSRT is not in this cv2: {_CONTRIB}"
LEAST_SIDE_PX, LEAST_AREA_PX2 = 2, 20  # below, OpenCV's MIL never returns from init (measured with OpenCV 4.14)
_LIBC = ctypes.CDLL(None)


@dataclass(frozen=True, slots=True)
class Models:
    """Files of networks, which are the user's to bring; None: not given."""

    nano_backbone: Path | None = None  # ONNX, for cv2.TrackerNano
    nano_head: Path | None = None  # ONNX
    vit: Path | None = None  # ONNX, for cv2.TrackerVit


NO_MODELS = Models()


@dataclass(frozen=True, slots=True)
class PeerResult:
    """A tracker's answer."""

    box: Box  # its last one where it reports a loss
    is_found: bool


class BoxTracker(Protocol):
    """What is asked of a tracker."""

    def init(self, frame: Image, box: Box, /) -> None: ...

    def update(self, frame: Image, /) -> PeerResult: ...


class PlainTracker:
    """Any tracker with the two verbs, ours or one's own.

    Its `init(frame, box)` is given a `mscf.Box`; its `update(frame)` returns something with a `.box`, and perhaps with
    an `.is_found`, or a pair (found, box). The box is a `mscf.Box` or x, y, w, h, in pixels from 0,0.
    """

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self._box = Box(0, 0, 0, 0)

    def init(self, frame: Image, box: Box, /) -> None:
        self._tracker.init(frame, box)
        self._box = box

    def update(self, frame: Image, /) -> PeerResult:
        """Follow.

        Raises
        ------
        TypeError
            If the tracker's answer is none of the kinds above.
        BoxError
            If its box is not finite, or has no area.
        """
        answer = self._tracker.update(frame)
        if hasattr(answer, "box"):
            is_found, box = getattr(answer, "is_found", True), answer.box
        else:
            try:
                is_found, box = answer
            except (TypeError, ValueError):
                text = f"update returned {type(answer).__name__}: expected something with .box, or (found, box)"
                raise TypeError(text) from None
        if is_found:
            self._box = _box_of(box)
        return PeerResult(self._box, bool(is_found))


class OpenCvTracker:
    """A tracker of OpenCV, by its object.

    Deterministic: MIL draws from the random numbers of OpenCV and of the C library, which all trackers of a process
    share and nobody else seeds (measured with OpenCV 4.14).
    """

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self._box = Box(0, 0, 0, 0)
        self._updates = 0

    def init(self, frame: Image, box: Box, /) -> None:
        """Start, with whole pixels inside the frame, as OpenCV wants them.

        Raises
        ------
        BoxError
            If there are too few.
        cv2.error
            As OpenCV does.
        """
        rows, cols = frame.shape[:2]
        left, top = max(round(box.x), 0), max(round(box.y), 0)
        right, bottom = min(round(box.x) + round(box.w), cols), min(round(box.y) + round(box.h), rows)
        w, h = right - left, bottom - top
        if min(w, h) < LEAST_SIDE_PX or w * h < LEAST_AREA_PX2:
            text = f"{box} has too few pixels in the frame of {cols} x {rows} for a tracker of OpenCV"
            raise BoxError(f"{text}: sides of {LEAST_SIDE_PX} and {LEAST_AREA_PX2} in all are the least")
        self._seed(0)
        self._tracker.init(frame, (left, top, w, h))
        self._box = box
        self._updates = 0

    def update(self, frame: Image, /) -> PeerResult:
        """Follow.

        Raises
        ------
        cv2.error
            As OpenCV does.
        BoxError
            If its box is not finite, or has no area.
        """
        self._updates += 1
        self._seed(self._updates)
        is_found, box = self._tracker.update(frame)
        if is_found:
            self._box = _box_of(box)
        return PeerResult(self._box, bool(is_found))

    @staticmethod
    def _seed(number: int) -> None:
        cv2.setRNGSeed(number)
        _LIBC.srand(number)


class CsrtTracker(OpenCvTracker):
    """OpenCV's CSR-DCF with its default parameters."""

    def __init__(self) -> None:
        """Make it.

        Raises
        ------
        ConfigError
            If this cv2 has no CSRT.
        """
        super().__init__(_opencv_class(CSRT).create())


def has_csrt() -> bool:
    """Whether the installed cv2 has CSRT, which only its contrib builds have."""
    return hasattr(cv2, "TrackerCSRT")


def tracker_names() -> tuple[str, ...]:
    """Names of all that is built in, whether or not this cv2 has it."""
    return (*PRESETS, *OPENCV)


def tracker_factory(name: str, models: Models = NO_MODELS, color_table: Path | None = None) -> Callable[[], BoxTracker]:
    """What makes a tracker called `name`.

    Parameters
    ----------
    name : one of `tracker_names()`, a variant of ours (`TrackerConfig.named`), or module:Class.
    models : files for `nano` and `vit`.
    color_table : colour names for our presets in place of the package's own.

    Raises
    ------
    ConfigError
        If there is no such tracker, or this cv2 has it not, or a file of it cannot be read: now rather than later.
    """
    if ":" in name:
        own = _own_class(name)
        return lambda: PlainTracker(own())
    if name in PRESETS or "," in name:
        config = TrackerConfig.named(name)
        if config.color_table is not None:  # the campaign could not tell one content of that file from another
            raise ConfigError(f"{name}: give the table by --color-table NPZ, it is the same for all of ours")
        config = replace(config, color_table=color_table)
        load_table(color_table)  # says now what is wrong with it
        return lambda: PlainTracker(Tracker(config))
    if name not in OPENCV:
        known = ", ".join(tracker_names())
        raise ConfigError(f"unknown tracker {name!r}: choose from {known}, PRESET,FIELD=VALUE or module:Class")
    peer = _opencv_class(name)
    parameters = _parameters(name, models)

    def make() -> OpenCvTracker:
        return OpenCvTracker(peer.create(*parameters))

    if parameters:
        try:
            make()
        except cv2.error as error:
            raise ConfigError(f"{name}: OpenCV cannot read its model: {first_line(error)}") from error
    return make


def _opencv_class(name: str) -> Any:
    found: Any = cv2
    for part in _CLASSES[name].split("."):
        found = getattr(found, part, None)
    if found is None:
        raise ConfigError(CSRT_MISSING if name == CSRT else f"OpenCV's {name.upper()} is not in this cv2: {_CONTRIB}")
    return found


def _parameters(name: str, models: Models) -> tuple[Any, ...]:
    """What `create` is given: nothing, where there is no model."""
    if name == "nano":
        nano = cv2.TrackerNano.Params()
        nano.backbone = _model_file(models.nano_backbone, "nano_backbone")
        nano.neckhead = _model_file(models.nano_head, "nano_head")
        return (nano,)
    if name == "vit":
        vit = cv2.TrackerVit.Params()
        vit.net = _model_file(models.vit, "vit")
        return (vit,)
    return ()


def _model_file(path: Path | None, what: str) -> str:
    if path is None:
        raise ConfigError(
            f"no model {what}: bring its ONNX file, none comes with this package (--nano BACKBONE HEAD, --vit MODEL)"
        )
    if not path.is_file():
        raise ConfigError(f"the model {what} is to be read from {path}, which is not a file")
    return str(path)


def _own_class(name: str) -> type[Any]:
    module_name, _, class_name = name.partition(":")
    try:
        module = import_module(module_name)
    except Exception as error:
        text = f"{name}: {module_name!r} cannot be imported: {type(error).__name__}: {first_line(error)}"
        raise ConfigError(f"{text} (is its folder in PYTHONPATH?)") from error
    own: Any = getattr(module, class_name, None)
    if not (isinstance(own, type) and hasattr(own, "init") and hasattr(own, "update")):
        raise ConfigError(f"{name}: {module_name} has no class {class_name!r} with init(frame, box) and update(frame)")
    return own


def _box_of(value: Any) -> Box:
    """A box or four numbers as a `Box` of Python's floats.

    Raises
    ------
    BoxError
        If it is neither, not finite, or without area.
    """
    try:
        x, y, w, h = (value.x, value.y, value.w, value.h) if isinstance(value, Box) else value
        box = Box(float(x), float(y), float(w), float(h))
    except (TypeError, ValueError):
        raise BoxError(f"update gave the box {value!r}: expected x, y, w, h") from None
    if not all(map(math.isfinite, (box.x, box.y, box.w, box.h))) or box.w <= 0 or box.h <= 0:
        raise BoxError(f"update gave the box {value!r}: x, y, w, h must be finite, w and h above 0")
    return box


def first_line(error: BaseException) -> str:
    """What an error says, without what may follow: OpenCV's errors have several lines."""
    return str(error).strip().partition("\n")[0]
