"""VOT: the short-term and long-term challenges with boxes or polygons (2013 to 2019).

M. Kristan et al.: The Visual Object Tracking challenge results. The layout, as the authors' toolkit leaves it:

* `list.txt`: a sequence's name a line;
* `NAME/color/00000001.jpg` ..., or without `color/`;
* `NAME/groundtruth.txt`: x,y,w,h or x1,y1,...,x4,y4 a frame, 0-based: the toolkit paints a box from column x of
  an array that begins with column 0;
* `NAME/occlusion.tag` (older: `.label`) and the like: a 0 or 1 a frame.
"""

from functools import partial
from pathlib import Path

from mscf.errors import SourceError
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_in
from mscf.geometry import Box
from mscf.images import present, read_rows


def catalogue(folder: Path) -> Catalogue | None:
    """The sequences of `list.txt`; None where there is none, or it is another data set's.

    Raises
    ------
    SourceError
        If the list cannot be read.
    """
    path = folder / "list.txt"
    if not path.is_file():
        return None
    try:
        names = path.read_text().split()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path} cannot be read: {error}") from error
    if any(name.startswith("GOT-10k_") or (folder / name / "img").is_dir() for name in names):
        return None  # others have such a list, too, but 1-based boxes
    return Catalogue("VOT", {name: partial(_read, folder / name) for name in names})


def _read(folder: Path) -> Sequence:
    color = folder / "color"
    images = images_in(color if color.is_dir() else folder)
    return checked(folder.name, images, _read_regions(folder / "groundtruth.txt"), _tags(folder))


def _read_regions(path: Path) -> tuple[Box | None, ...]:
    rows = read_rows(path, {4, 8}, "x,y,w,h or x1,y1,x2,y2,x3,y3,x4,y4")
    return tuple(None if row is None else present(_box(row)) for row in rows)


def _box(numbers: tuple[float, ...]) -> Box:
    """Box of a region; a polygon's is the upright one around its points, as the authors' toolkit converts it."""
    if len(numbers) == 4:
        return Box(*numbers)
    xs, ys = numbers[0::2], numbers[1::2]
    return Box(min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys))


def _tags(folder: Path) -> frozenset[str]:
    """What is hard in at least one frame, by the tag's own name ("occlusion"): VOT has no abbreviations."""
    paths = (*folder.glob("*.tag"), *folder.glob("*.label"))
    return frozenset(path.stem for path in paths if (1.0,) in read_rows(path, {1}, "0 or 1"))
