"""UAVDT, its part for single-object tracking.

D. Du et al.: The Unmanned Aerial Vehicle Benchmark: Object Detection and Tracking, ECCV 2018. The layout:

* `UAV-benchmark-S/NAME/img000001.jpg` ...;
* `UAV-benchmark-SOT_v1.0/anno/NAME_gt.txt`: x,y,w,h a frame, 1-based;
* `UAV-benchmark-SOT_v1.0/anno/att/NAME_att.txt`: nine flags in one line.
"""

from functools import partial
from pathlib import Path

from mscf.errors import SourceError
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_in, read_flags
from mscf.images import read_truth

# order of the flags: the benchmark's plotting script, which has no abbreviations; these are those of the papers that
# evaluate on it: background clutter, camera motion, object motion, small object, illumination variation, object blur,
# scale variation, long-term tracking, large occlusion
ATTRIBUTES = ("BC", "CM", "OM", "SO", "IV", "OB", "SV", "LTT", "LO")

_IMAGES = "UAV-benchmark-S"
_BOXES = "UAV-benchmark-SOT_v1.0"
_SUFFIX = "_gt.txt"


def catalogue(folder: Path) -> Catalogue | None:
    """The sequences of which images or boxes are there; None where the folder has not this layout.

    Raises
    ------
    SourceError
        If one half of the layout is missing.
    """
    images, boxes = folder / _IMAGES, folder / _BOXES / "anno"
    if not images.is_dir() and not boxes.is_dir():
        return None
    for half in (images, boxes):
        if not half.is_dir():
            raise SourceError(f"{half} is missing: UAVDT has its images in {_IMAGES} and its boxes in {_BOXES}/anno")
    names = {path.name for path in images.iterdir() if path.is_dir()}
    names |= {path.name.removesuffix(_SUFFIX) for path in boxes.glob(f"*{_SUFFIX}")}
    return Catalogue("UAVDT", {name: partial(_read, name, images / name, boxes) for name in sorted(names)})


def _read(name: str, images: Path, boxes: Path) -> Sequence:
    return checked(
        name,
        images_in(images),
        read_truth(boxes / f"{name}{_SUFFIX}"),
        read_flags(boxes / "att" / f"{name}_att.txt", ATTRIBUTES),
    )
