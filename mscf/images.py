"""Image files and the ground truth beside them."""

import re
from collections.abc import Collection, Iterable
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


def read_rows(path: Path, lengths: Collection[int], expected: str) -> tuple[tuple[float, ...] | None, ...]:
    """Numbers of a text file, line by line; comma, tab or blank separated.

    None stands for a blank line; blank lines at the end do not count.

    Raises
    ------
    SourceError
        If the file cannot be read, or a line is not numbers, as many as one of `lengths` says; the error tells what
        was `expected`.
    """
    try:
        lines = path.read_text().rstrip().splitlines()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path} cannot be read: it is not text") from error
    rows: list[tuple[float, ...] | None] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            rows.append(None)
            continue
        try:
            row = tuple(float(word) for word in line.replace(",", " ").split())
        except ValueError:
            row = ()
        if len(row) not in lengths:
            raise SourceError(f"{path}, line {number}: expected {expected}, got {line.strip()[:60]!r}")
        rows.append(row)
    return tuple(rows)


def read_truth(path: Path) -> tuple[Box | None, ...]:
    """Boxes of a ground-truth file: x,y,w,h a line, 1-based; comma, tab or blank separated.

    NaN, a width or height of 0, or a blank line means that the target is absent; blank lines at the end do not count.

    Raises
    ------
    SourceError
        If the file cannot be read or a line is not four numbers.
    """
    rows = read_rows(path, {4}, "x,y,w,h")
    return tuple(None if row is None else present(Box.from_one_based(*row)) for row in rows)


def present(box: Box) -> Box | None:
    """The box, or None where it says that the target is absent: not finite, or without an area."""
    return box if box.is_finite and box.w > 0 and box.h > 0 else None
