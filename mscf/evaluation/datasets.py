"""Sequences with ground truth, read from a folder."""

from dataclasses import dataclass
from pathlib import Path

from mscf.arrays import Image
from mscf.errors import SourceError
from mscf.geometry import Box
from mscf.images import image_files, read_image, read_truth


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


def read_sequence(folder: Path) -> Sequence:
    """A folder with `img/` and `groundtruth.txt`.

    Raises
    ------
    SourceError
        If one of them is missing, their numbers differ, or the first box is absent.
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
        raise SourceError(
            f"{folder} holds no sequence: expected NAME/groundtruth.txt and NAME/img/ in it (of one, its parent)"
        )
    return tuple(read_sequence(path) for path in folders)
