"""One sequence with its ground truth, and the images it consists of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mscf.arrays import Image
from mscf.errors import SourceError
from mscf.geometry import Box
from mscf.images import image_files, read_image, read_rows


@dataclass(frozen=True, slots=True)
class Sequence:
    """Images of one sequence and the true boxes."""

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...]  # 0-based; None where the target is absent
    attributes: frozenset[str] = frozenset()  # what is hard in it, abbreviated as published: "OCC", ...

    def read(self, index: int) -> Image:
        """Frame `index` as (H, W, 3) BGR uint8.

        Raises
        ------
        SourceError
            If the image cannot be decoded; it names the file.
        """
        return read_image(self.images[index])


@dataclass(frozen=True, slots=True)
class Catalogue:
    """What a data set's folder holds, before any of it is read."""

    name: str
    readers: Mapping[str, Callable[[], Sequence]]  # by sequence; each raises SourceError where its own is incomplete


def checked(
    name: str, images: tuple[Path, ...], truth: tuple[Box | None, ...], attributes: frozenset[str] = frozenset()
) -> Sequence:
    """A sequence with a line of truth for every image and a box to start from.

    Raises
    ------
    SourceError
        If it is not so.
    """
    if len(images) != len(truth):
        raise SourceError(f"{name} has {len(images)} images and {len(truth)} lines of ground truth")
    if not truth or truth[0] is None:
        raise SourceError(f"{name} has no box in the first line of its ground truth")
    return Sequence(name, images, truth, attributes)


def images_in(folder: Path) -> tuple[Path, ...]:
    """All images of a folder, in the order of their numbers.

    Raises
    ------
    SourceError
        If there is no such folder.
    """
    if not folder.is_dir():
        raise SourceError(f"{folder}, the folder of its images, is missing")
    return tuple(image_files(folder))


def images_between(folder: Path, first: int, last: int) -> tuple[Path, ...]:
    """Images of a folder whose file names are the numbers `first` to `last`.

    Raises
    ------
    SourceError
        If one of them is missing: a clip is found by numbers, and a gap would shift what follows.
    """
    by_number = {int(path.stem): path for path in images_in(folder) if path.stem.isdecimal()}
    missing = [number for number in range(first, last + 1) if number not in by_number]
    if missing:
        raise SourceError(f"{folder} lacks image {missing[0]}, {len(missing)} of its images {first} to {last} in all")
    return tuple(by_number[number] for number in range(first, last + 1))


def read_flags(path: Path, abbreviations: tuple[str, ...]) -> frozenset[str]:
    """Those of `abbreviations` whose flag is 1 in an attribute file of one line; none where there is no file.

    Raises
    ------
    SourceError
        If the file cannot be read or has another number of flags.
    """
    if not path.is_file():  # attributes are an extra of the benchmarks: without them a sequence is still whole
        return frozenset()
    rows = read_rows(path, {len(abbreviations)}, f"{len(abbreviations)} flags, {' '.join(abbreviations)}")
    flags = rows[0] if rows else None
    if flags is None:
        raise SourceError(f"{path} has no flags in its first line")
    return frozenset(name for name, flag in zip(abbreviations, flags, strict=True) if flag)
