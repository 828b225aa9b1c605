"""Data sets of sequences with ground truth, read as their authors publish them."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from mscf.errors import SourceError
from mscf.evaluation.datasets import dtb70, otb, plain, uav123, uavdt, vot
from mscf.evaluation.datasets.plain import read_sequence
from mscf.evaluation.datasets.sequence import Catalogue, Sequence

__all__ = ["Dataset", "Sequence", "Skipped", "read_dataset", "read_sequence"]

# the first that knows a folder has it: DTB70 is OTB100's layout with other names
_LAYOUTS: tuple[Callable[[Path], Catalogue | None], ...] = (
    uav123.catalogue,
    uavdt.catalogue,
    vot.catalogue,
    dtb70.catalogue,
    otb.catalogue,
    plain.catalogue,
)


@dataclass(frozen=True, slots=True)
class Skipped:
    """A sequence that is incomplete."""

    name: str
    why: str  # one line


@dataclass(frozen=True, slots=True)
class Dataset:
    """Sequences of one data set, and those of it that are not whole."""

    name: str
    sequences: tuple[Sequence, ...]
    skipped: tuple[Skipped, ...]


def read_dataset(folder: Path, names: Collection[str] = ()) -> Dataset:
    """The data set in a folder, or the sequences of it that are named; images are listed, not decoded.

    Raises
    ------
    SourceError
        If the folder has no known layout, there is no sequence of a name, or not one can be read.
    """
    catalogue = _catalogue(folder)
    for name in names:
        if name not in catalogue.readers:
            nearest = "".join(get_close_matches(name, catalogue.readers, n=1, cutoff=0))
            raise SourceError(f"{catalogue.name} has no sequence {name!r} in {folder}: did you mean {nearest!r}?")
    sequences, skipped = [], []
    for name, read in catalogue.readers.items():
        if names and name not in names:
            continue
        try:
            sequences.append(read())
        except (SourceError, OSError) as error:
            skipped.append(Skipped(name, str(error)))
    if not sequences:
        raise SourceError(f"{folder} has no whole sequence, the first of {len(skipped)}: {skipped[0].why}")
    return Dataset(catalogue.name, tuple(sequences), tuple(skipped))


def _catalogue(folder: Path) -> Catalogue:
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder: give the one that holds the sequences' folders")
    try:
        found = (layout(folder) for layout in _LAYOUTS)
        catalogue = next((catalogue for catalogue in found if catalogue is not None and catalogue.readers), None)
    except OSError as error:
        raise SourceError(f"{folder} cannot be read: {error}") from error
    if catalogue is not None:
        return catalogue
    raise SourceError(
        f"{folder} is no data set that can be read: expected in it NAME/img with NAME/groundtruth.txt (of one sequence,"
        " its parent) or NAME/groundtruth_rect.txt (OTB100, DTB70), data_seq and anno (UAV123, UAV123@10fps),"
        " UAV-benchmark-S and UAV-benchmark-SOT_v1.0 (UAVDT), or list.txt (VOT)"
    )
