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
from mscf.evaluation.datasets import IMAGE_SUFFIXES, image_files, read_image, read_truth
from mscf.geometry import Box

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

    def __iter__(self) -> Iterator[Image]: ...


@dataclass(frozen=True, slots=True)
class ImageSource:
    """A list of image files."""

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...] = ()
    frames_per_s: float = IMAGE_FRAMES_PER_S

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
    truth: tuple[Box | None, ...] = ()

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

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
        is_rate = np.isfinite(rate) and 0 < rate <= 1000
        return cls(path, float(rate) if is_rate else IMAGE_FRAMES_PER_S, count if count > 0 else None)

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


@dataclass(frozen=True, slots=True)
class CameraSource:
    """A V4L2 camera, as fast as it delivers; endless."""

    device: str
    frames_per_s: float = IMAGE_FRAMES_PER_S
    frame_count: None = None
    truth: tuple[Box | None, ...] = ()

    @property
    def name(self) -> str:
        """Path of the device."""
        return self.device

    def __iter__(self) -> Iterator[Image]:
        capture = cv2.VideoCapture(self.device, cv2.CAP_V4L2)
        try:
            if not capture.isOpened():
                text = f"camera {self.device} cannot be opened: is it there (ls /dev/video*), free, and readable"
                raise SourceError(f"{text} for you (group video)?")
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the default queue of four delivers old frames
            while True:
                is_read, frame = capture.read()
                if not is_read:
                    raise SourceError(f"camera {self.device} stopped delivering frames: was it unplugged?")
                yield np.asarray(frame, dtype=np.uint8)
        finally:
            capture.release()


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
    if path.is_dir():
        return _folder(path)
    if not path.exists() and glob.has_magic(text):
        images = [p for p in map(Path, sorted(glob.glob(text))) if p.suffix.lower() in IMAGE_SUFFIXES]
        if not images:
            raise SourceError(f"no image matches {text}: quote the pattern, and give one of {_suffixes()}")
        return ImageSource(text, tuple(images), _truth_beside(images[0].parent))
    if not path.exists():
        raise SourceError(f"{text} does not exist: give a video file, a folder or glob of images, or /dev/videoN")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageSource(path.name, (path,), _truth_beside(path.parent))
    return VideoSource.open(path)


def _folder(folder: Path) -> ImageSource:
    images = image_files(folder)
    if not images and (folder / "img").is_dir():  # the folder of a sequence, as data sets have it
        return _folder(folder / "img")
    if not images:
        raise SourceError(f"{folder} holds no images: give a folder with {_suffixes()} files")
    name = folder.parent.name if folder.name == "img" else folder.name
    return ImageSource(name or str(folder), tuple(images), _truth_beside(folder))


def _truth_beside(folder: Path) -> tuple[Box | None, ...]:
    for path in (folder / "groundtruth.txt", folder.parent / "groundtruth.txt"):
        if path.is_file():
            return read_truth(path)
    return ()


def _suffixes() -> str:
    return " ".join(sorted(IMAGE_SUFFIXES))


def _synthetic_flight() -> Source:
    found = entry_points(group="mscf.sources", name=SYNTHETIC_FLIGHT)
    if not found:
        raise SourceError("the built-in flight comes with the installed package: run `pip install .`, or give a SOURCE")
    source: Source = next(iter(found)).load()()
    return source
