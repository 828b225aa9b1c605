"""Where frames come from: a video file, images, a V4L2 camera, or the built-in synthetic flight."""

import glob
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.errors import SourceError
from mscf.geometry import Box
from mscf.images import IMAGE_SUFFIXES, image_files, in_order, read_image, read_truth

COUNTING_SUFFIXES = frozenset({".mp4", ".mov", ".m4v"})
SYNTHETIC_FLIGHT = "synthetic-flight"  # entry point in group mscf.sources; `sim` provides it, and imports us
IMAGE_FRAMES_PER_S = 30.0  # images carry no rate


class Source(Protocol):
    """Frames in order, and what is known of them beforehand."""

    @property
    def name(self) -> str: ...
    @property
    def frames_per_s(self) -> float: ...
    @property
    def frame_count(self) -> int | None: ...  # None: not known, or endless
    @property
    def truth(self) -> tuple[Box | None, ...]: ...  # 0-based, a box a frame; empty: not known
    @property
    def files(self) -> tuple[Path, ...]: ...  # what is read, and so must not be written

    def __iter__(self) -> Iterator[Image]: ...


@dataclass(frozen=True, slots=True)
class ImageSource:
    """A list of image files."""

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...] = ()
    truth_path: Path | None = None
    frames_per_s: float = IMAGE_FRAMES_PER_S

    @property
    def files(self) -> tuple[Path, ...]:
        """The images, and the truth beside them."""
        return self.images if self.truth_path is None else (*self.images, self.truth_path)

    @property
    def frame_count(self) -> int:
        """Number of images."""
        return len(self.images)

    def __iter__(self) -> Iterator[Image]:
        return map(read_image, self.images)


@dataclass(frozen=True, slots=True)
class VideoSource:
    """A video file."""

    path: Path
    frames_per_s: float
    frame_count: int | None  # as the container says
    truth: tuple[()] = ()

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def files(self) -> tuple[Path, ...]:
        """The file."""
        return (self.path,)

    @classmethod
    def open(cls, path: Path) -> "VideoSource":
        """Look into a file.

        Raises
        ------
        SourceError
            If it holds no video that can be decoded.
        """
        capture = cv2.VideoCapture(str(path))
        try:
            if not capture.isOpened() or not capture.grab():
                raise SourceError(f"{path} is not a video that can be decoded: play it elsewhere, or convert it to MP4")
            rate = capture.get(cv2.CAP_PROP_FPS)
            count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        finally:
            capture.release()
        # only these containers store a count; of others OpenCV guesses it from the duration
        has_count = count > 0 and path.suffix.lower() in COUNTING_SUFFIXES
        return cls(path, _sane_rate(rate), count if has_count else None)

    def __iter__(self) -> Iterator[Image]:
        capture = cv2.VideoCapture(str(self.path))
        done = 0
        try:
            while True:
                is_read, frame = capture.read()
                if not is_read:
                    break
                done += 1
                yield np.asarray(frame, dtype=np.uint8)
        finally:
            capture.release()
        # containers may count one frame more than there is; a larger rest is a damaged file
        if self.frame_count is not None and done < self.frame_count - 1:
            text = f"{self.path}: frame {done + 1} of {self.frame_count} cannot be decoded"
            raise SourceError(f"{text}: the file is damaged or cut short, copy it again")


class CameraSource:
    """A V4L2 camera, as fast as it delivers; endless."""

    frame_count: None = None
    truth: tuple[()] = ()
    files: tuple[()] = ()

    def __init__(self, device: str) -> None:
        """Open the camera, to know its rate.

        Raises
        ------
        SourceError
            If it cannot be opened.
        """
        self.name = device
        self._capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            text = f"camera {device} cannot be opened: is it there (ls /dev/video*), free, and readable for you"
            raise SourceError(f"{text} (group video)?")
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the default queue of four delivers old frames
        self.frames_per_s = _sane_rate(self._capture.get(cv2.CAP_PROP_FPS))

    def __iter__(self) -> Iterator[Image]:
        try:
            while True:
                is_read, frame = self._capture.read()
                if not is_read:
                    raise SourceError(f"camera {self.name} stopped delivering frames: was it unplugged?")
                yield np.asarray(frame, dtype=np.uint8)
        finally:
            self._capture.release()


def open_source(text: str | None) -> Source:
    """Source for a command-line argument.

    Parameters
    ----------
    text : a video file, a folder or glob of images, /dev/videoN or N; None: the built-in synthetic flight.

    Raises
    ------
    SourceError
        If nothing is there or it cannot be used; the text says how to mend it.
    """
    if text is None:
        return _synthetic_flight()
    if re.fullmatch(r"\d+", text):
        return CameraSource(f"/dev/video{int(text)}")
    if re.fullmatch(r"/dev/video\d+", text):
        return CameraSource(text)
    path = Path(text)
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise SourceError(f"{text} cannot be read: {error.strerror}") from error
    if path.is_dir():
        return _folder(path)
    if not path.exists() and glob.has_magic(text):
        images = in_order(p for p in map(Path, glob.glob(text)) if p.suffix.lower() in IMAGE_SUFFIXES)
        if not images:
            raise SourceError(f"no image matches {text}: quote the pattern, and give one of {_suffixes()}")
        return _images(text, images)
    if not path.exists():
        raise SourceError(f"{text} does not exist: give a video file, a folder or glob of images, or /dev/videoN")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return _images(path.name, [path])
    return VideoSource.open(path)


def _sane_rate(rate: float) -> float:
    return float(rate) if np.isfinite(rate) and 0 < rate <= 1000 else IMAGE_FRAMES_PER_S


def _folder(folder: Path) -> ImageSource:
    images = image_files(folder)
    if not images and (folder / "img").is_dir():  # the folder of a sequence, as data sets have it
        return _folder(folder / "img")
    if not images:
        raise SourceError(f"{folder} holds no images: give a folder with {_suffixes()} files")
    name = folder.parent.name if folder.name == "img" else folder.name
    return _images(name or str(folder), images)


def _images(name: str, images: list[Path]) -> ImageSource:
    """Source of images that are all or some of a folder's, each with its own line of the truth beside them."""
    folder = images[0].parent
    for path in (folder / "groundtruth.txt", folder.parent / "groundtruth.txt"):
        if path.is_file():
            truth = dict(zip(image_files(folder), read_truth(path), strict=False))
            return ImageSource(name, tuple(images), tuple(truth.get(image) for image in images), path)
    return ImageSource(name, tuple(images))


def _suffixes() -> str:
    return " ".join(sorted(IMAGE_SUFFIXES))


def _synthetic_flight() -> Source:
    found = entry_points(group="mscf.sources", name=SYNTHETIC_FLIGHT)
    if not found:
        raise SourceError("the built-in flight comes with the installed package: run `pip install .`, or give a SOURCE")
    source: Source = next(iter(found)).load()()
    return source
