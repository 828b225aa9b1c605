"""Image files and the ground truth beside them."""

import math
import re
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.errors import SourceError
from mscf.geometry import Box

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"})


def image_files(folder: Path) -> list[Path]:
    """Images directly in a folder, in the order of the numbers in their names."""
    return in_order(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Paths by name, numbers in it by value: 2.jpg before 10.jpg."""

    def key(path: Path) -> list[tuple[int, str]]:
        return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", path.name)]

    return sorted(paths, key=key)


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
    broken = SourceError(f"{path} is not an image that can be decoded: remove it or copy it again")
    try:
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    except cv2.error as error:  # a size beyond OpenCV's limits
        raise broken from error
    if image is None:
        raise broken
    return np.asarray(image, dtype=np.uint8)


def read_truth(path: Path) -> tuple[Box | None, ...]:
    """Boxes of a ground-truth file: x,y,w,h a line, 1-based; comma, tab or blank separated.

    NaN, a width or height of 0, or a blank line means that the target is absent; blank lines at the end do not count.

    Raises
    ------
    SourceError
        If the file cannot be read or a line is not four numbers.
    """
    try:
        lines = path.read_text().rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path} cannot be read: {error}") from error
    boxes: list[Box | None] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            boxes.append(None)
            continue
        try:
            x, y, w, h = (float(word) for word in line.replace(",", " ").split())
        except ValueError as error:
            raise SourceError(f"{path}, line {number}: expected x,y,w,h, got {line.strip()!r}") from error
        present = all(map(math.isfinite, (x, y, w, h))) and w > 0 and h > 0
        boxes.append(Box.from_one_based(x, y, w, h) if present else None)
    return tuple(boxes)
