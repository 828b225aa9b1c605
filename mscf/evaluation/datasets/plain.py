"""The plain layout: NAME/img/ with images and NAME/groundtruth.txt, a line x,y,w,h an image, 1-based."""

from functools import partial
from pathlib import Path

from mscf.errors import SourceError
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_in
from mscf.images import read_truth

TRUTH = "groundtruth.txt"


def catalogue(folder: Path) -> Catalogue | None:
    """The sequences directly in a folder; None where none has a ground truth."""
    folders = sequence_folders(folder, TRUTH)
    if not any((path / TRUTH).is_file() for path in folders):
        return None
    return Catalogue(folder.resolve().name, {path.name: partial(read_sequence, path) for path in folders})


def sequence_folders(folder: Path, truth_pattern: str) -> list[Path]:
    """Folders in a folder that hold `img/` or a file like `truth_pattern`, by name: a half of a sequence counts."""
    return sorted(
        path
        for path in folder.iterdir()
        if path.is_dir() and ((path / "img").is_dir() or any(path.glob(truth_pattern)))
    )


def read_sequence(folder: Path) -> Sequence:
    """The sequence in a folder with `img/` and `groundtruth.txt`.

    Raises
    ------
    SourceError
        If one of them is missing, their numbers differ, or the first box is absent.
    """
    if not (folder / TRUTH).is_file() or not (folder / "img").is_dir():
        raise SourceError(f"{folder} is no sequence: expected {TRUTH} and a folder img in it")
    return checked(folder.resolve().name, images_in(folder / "img"), read_truth(folder / TRUTH))
