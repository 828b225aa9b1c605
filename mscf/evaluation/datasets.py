"""Sequences with ground truth, read from a folder."""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.errors import SourceError
from mscf.geometry import Box

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"})


@dataclass(frozen=True, slots=True)
class Sequence:
    """Images of one sequence and the true boxes."""

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...]  # 0-based; None where the target is absent

    def read(self, index: int) -> Image:
        """Frame `index` as (H, W, 3) BGR uint8.

        Raises
        ------
        SourceError
            If the image cannot be decoded.
        """
        return read_image(self.images[index])


def image_files(folder: Path) -> list[Path]:
    """Images directly in a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def read_image(path: Path) -> Image:
    """Decode an image as (H, W, 3) BGR uint8.

    Raises
    ------
    SourceError
        If it is missing, empty or no image.
    """
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from error
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise SourceError(f"{path} is not an image that can be decoded: remove it or copy it again")
    return np.asarray(image, dtype=np.uint8)


def read_truth(path: Path) -> tuple[Box | None, ...]:
    """Boxes of a ground-truth file: x,y,w,h a line, 1-based; comma, tab or blank separated.

    NaN or a width or height of 0 means that the target is absent.

    Raises
    ------
    SourceError
        If the file cannot be read or a line is not four numbers.
    """
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path} cannot be read: {error}") from error
    boxes: list[Box | None] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            x, y, w, h = (float(word) for word in line.replace(",", " ").split())
        except ValueError as error:
            raise SourceError(f"{path}, line {number}: expected x,y,w,h, got {line.strip()!r}") from error
        present = all(map(math.isfinite, (x, y, w, h))) and w > 0 and h > 0
        boxes.append(Box.from_one_based(x, y, w, h) if present else None)
    return tuple(boxes)


def read_sequence(folder: Path) -> Sequence:
    """A folder with `img/` and `groundtruth.txt`.

    Raises
    ------
    SourceError
        If one of them is missing, or there are fewer images than boxes, or the first box is absent.
    """
    truth_path = folder / "groundtruth.txt"
    if not truth_path.is_file() or not (folder / "img").is_dir():
        raise SourceError(f"{folder} is no sequence: expected groundtruth.txt and a folder img in it")
    truth, images = read_truth(truth_path), image_files(folder / "img")
    if len(images) != len(truth):
        raise SourceError(f"{folder} has {len(images)} images and {len(truth)} lines of ground truth")
    if not truth or truth[0] is None:
        raise SourceError(f"{truth_path} has no box in its first line")
    return Sequence(folder.name, tuple(images), truth)


def read_dataset(folder: Path) -> tuple[Sequence, ...]:
    """All sequences directly in a folder, by name.

    Raises
    ------
    SourceError
        If there is none.
    """
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder: give the one that holds the sequences' folders")
    folders = sorted(path.parent for path in folder.glob("*/groundtruth.txt"))
    if not folders:
        raise SourceError(f"{folder} holds no sequence: expected NAME/groundtruth.txt and NAME/img/ in it")
    return tuple(read_sequence(path) for path in folders)
