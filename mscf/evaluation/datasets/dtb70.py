"""DTB70, the drone tracking benchmark.

S. Li, D.-Y. Yeung: Visual Object Tracking for Unmanned Aerial Vehicles: A Benchmark and New Motion Models, AAAI 2017.
The layout is that of OTB100 with five digits:

* `NAME/img/00001.jpg` ...;
* `NAME/groundtruth_rect.txt`: x,y,w,h a frame, 1-based;
* `anno/att/NAME.txt`: eleven flags in one line. This folder comes with the authors' code (`experiments/anno`), not with
  the images: copy it beside the sequences.
"""

from functools import partial
from pathlib import Path

from mscf.evaluation.datasets.plain import sequence_folders
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_in, read_flags
from mscf.images import image_files, read_truth

# order of the flags: the ten of `perfPlot.m` in the authors' code, and the paper's eleventh, motion blur
ATTRIBUTES = ("SV", "ARV", "OCC", "DEF", "FCM", "IPR", "OPR", "OV", "BC", "SOA", "MB")

# from the authors' `configDTBSeqs.m`
_NAMES = """
Animal1 Animal2 Animal3 Animal4 BMX2 BMX3 BMX4 BMX5 Basketball Car2 Car4 Car5 Car6 Car8 ChasingDrones Girl1 Girl2
Gull1 Gull2 Horse1 Horse2 Kiting ManRunning1 ManRunning2 Motor1 Motor2 MountainBike1 MountainBike5 MountainBike6
Paragliding3 Paragliding5 RaceCar RaceCar1 RcCar3 RcCar4 RcCar5 RcCar6 RcCar7 RcCar8 RcCar9 SUP2 SUP4 SUP5 Sheep1
Sheep2 SkateBoarding4 Skiing1 Skiing2 SnowBoarding2 SnowBoarding4 SnowBoarding6 Soccer1 Soccer2 SpeedCar2 SpeedCar4
StreetBasketball1 StreetBasketball2 StreetBasketball3 Surfing03 Surfing04 Surfing06 Surfing10 Surfing12 Vaulting
Wakeboarding1 Wakeboarding2 Walking Yacht2 Yacht4 Zebra
"""

NAMES = frozenset(_NAMES.split())

TRUTH = "groundtruth_rect.txt"


def catalogue(folder: Path) -> Catalogue | None:
    """The sequences in a folder; None where most of them are not DTB70's: OTB100's have the same layout."""
    folders = sequence_folders(folder, TRUTH)
    if 2 * sum(_is_of_dtb70(path) for path in folders) <= len(folders):
        return None
    flags = folder / "anno" / "att"
    return Catalogue("DTB70", {path.name: partial(_read, path, flags / f"{path.name}.txt") for path in folders})


def _is_of_dtb70(folder: Path) -> bool:
    """Whether a sequence has one of DTB70's names, and its images five digits: OTB100 has a Basketball, too."""
    if folder.name not in NAMES or not (folder / TRUTH).is_file() or not (folder / "img").is_dir():
        return False
    return [len(path.stem) for path in image_files(folder / "img")[:1]] == [5]


def _read(folder: Path, flags: Path) -> Sequence:
    return checked(folder.name, images_in(folder / "img"), read_truth(folder / TRUTH), read_flags(flags, ATTRIBUTES))
