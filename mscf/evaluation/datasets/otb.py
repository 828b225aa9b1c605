"""OTB100, the object tracking benchmark.

Y. Wu, J. Lim, M.-H. Yang: Object Tracking Benchmark, TPAMI 2015. The layout:

* `NAME/img/0001.jpg` ...;
* `NAME/groundtruth_rect.txt`: x,y,w,h a frame, 1-based, comma, tab or blank separated;
* `NAME/groundtruth_rect.1.txt` and `.2.txt` where two targets are annotated: these are sequences NAME-1 and NAME-2.

Attributes stand on the benchmark's web page, not in its files.
"""

import re
from functools import partial
from pathlib import Path

from mscf.evaluation.datasets.plain import sequence_folders
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_between, images_in
from mscf.images import read_truth

# first and last image of the sequences of which only a part is annotated; elsewhere a line belongs to each image,
# also where the first is not 1 (BlurCar1, BlurCar3, BlurCar4)
RANGES = {"David": (300, 770), "Diving": (1, 215), "Football1": (1, 74), "Freeman3": (1, 460), "Freeman4": (1, 283)}

# by folder: both targets of a sequence share them
_ATTRIBUTES = """
Basketball IV OCC DEF OPR BC, Biker SV OCC MB FM OPR OV LR, Bird1 DEF FM OV, Bird2 OCC DEF FM IPR OPR
BlurBody SV DEF MB FM IPR, BlurCar1 MB FM, BlurCar2 SV MB FM, BlurCar3 MB FM, BlurCar4 MB FM, BlurFace MB FM IPR
BlurOwl SV MB FM IPR, Board SV MB FM OPR OV BC, Bolt OCC DEF IPR OPR, Bolt2 DEF BC, Box IV SV OCC MB IPR OPR OV BC LR
Boy SV MB FM IPR OPR, Car1 IV SV MB FM BC LR, Car2 IV SV MB FM BC, Car24 IV SV BC, Car4 IV SV, CarDark IV BC
CarScale SV OCC FM IPR OPR, ClifBar SV OCC MB FM IPR OV BC, Coke IV OCC FM IPR OPR BC, Couple SV DEF FM OPR BC
Coupon OCC BC, Crossing SV DEF FM OPR BC, Crowds IV DEF BC, Dancer SV DEF IPR OPR, Dancer2 DEF
David IV SV OCC DEF MB IPR OPR, David2 IPR OPR, David3 OCC DEF OPR BC, Deer MB FM IPR BC LR, Diving SV DEF IPR
Dog SV DEF OPR, Dog1 SV IPR OPR, Doll IV SV OCC IPR OPR, DragonBaby SV OCC MB FM IPR OPR OV
Dudek SV OCC DEF FM IPR OPR OV BC, FaceOcc1 OCC, FaceOcc2 IV OCC IPR OPR, Fish IV, FleetFace SV DEF MB FM IPR OPR
Football OCC IPR OPR BC, Football1 IPR OPR BC, Freeman1 SV IPR OPR, Freeman3 SV IPR OPR, Freeman4 SV OCC IPR OPR
Girl SV OCC IPR OPR, Girl2 SV OCC DEF MB OPR, Gym SV DEF IPR OPR, Human2 IV SV MB OPR, Human3 SV OCC DEF OPR BC
Human4 IV SV OCC DEF, Human5 SV OCC DEF, Human6 SV OCC DEF FM OPR OV, Human7 IV SV OCC DEF MB FM, Human8 IV SV DEF
Human9 IV SV DEF MB FM, Ironman IV SV OCC MB FM IPR OPR OV BC LR, Jogging OCC DEF OPR, Jump SV OCC DEF MB FM IPR OPR
Jumping MB FM, KiteSurf IV OCC IPR OPR, Lemming IV SV OCC FM OPR OV, Liquor IV SV OCC MB FM OPR OV BC, Man IV
Matrix IV SV OCC FM IPR OPR BC, Mhyang IV DEF OPR BC, MotorRolling IV SV MB FM IPR BC LR, MountainBike IPR OPR BC
Panda SV OCC DEF IPR OPR OV LR, RedTeam SV OCC IPR OPR LR, Rubik SV OCC IPR OPR, Shaking IV SV IPR OPR BC
Singer1 IV SV OCC OPR, Singer2 IV DEF IPR OPR BC, Skater SV DEF IPR OPR, Skater2 SV DEF FM IPR OPR
Skating1 IV SV OCC DEF OPR BC, Skating2 SV OCC DEF FM OPR, Skiing IV SV DEF IPR OPR, Soccer IV SV OCC MB FM IPR OPR BC
Subway OCC DEF BC, Surfer SV FM IPR OPR LR, Suv OCC IPR OV, Sylvester IV IPR OPR, Tiger1 IV OCC DEF MB FM IPR OPR
Tiger2 IV OCC DEF MB FM IPR OPR OV, Toy SV FM IPR OPR, Trans IV SV OCC DEF, Trellis IV SV IPR OPR BC, Twinnings SV OPR
Vase SV FM IPR, Walking SV OCC DEF, Walking2 SV OCC LR, Woman IV SV OCC DEF MB FM OPR
"""


def attributes() -> dict[str, frozenset[str]]:
    """Attributes of OTB100's sequences by the names of their 98 folders."""
    entries = [entry.split() for entry in _ATTRIBUTES.strip().replace("\n", ",").split(",")]
    return {name: frozenset(abbreviations) for name, *abbreviations in entries}


def catalogue(folder: Path) -> Catalogue | None:
    """The sequences in a folder, OTB100's or others in its layout; None where none is."""
    known = attributes()
    folders = sequence_folders(folder, "groundtruth_rect*.txt")
    if not any(any(path.glob("groundtruth_rect*.txt")) for path in folders):
        return None
    is_otb = 2 * sum(path.name in known for path in folders) > len(folders)
    return Catalogue(
        "OTB100" if is_otb else folder.resolve().name,
        {
            name: partial(_read, name, path, truth, known.get(path.name, frozenset()))
            for path in folders
            for name, truth in _targets(path).items()
        },
    )


def _targets(folder: Path) -> dict[str, Path]:
    """Ground-truth file of each target in a sequence's folder."""
    found = {}
    for path in sorted(folder.glob("groundtruth_rect*.txt")):
        match = re.fullmatch(r"groundtruth_rect(?:\.(\d+))?\.txt", path.name)
        if match is None or (match[1] and path.stat().st_size == 0):  # the first of Human4's two is published empty
            continue
        found[f"{folder.name}-{match[1]}" if match[1] else folder.name] = path
    return found or {folder.name: folder / "groundtruth_rect.txt"}  # its reader says that it is missing


def _read(name: str, folder: Path, truth: Path, abbreviations: frozenset[str]) -> Sequence:
    images = folder / "img"
    numbers = RANGES.get(folder.name)
    found = images_in(images) if numbers is None else images_between(images, *numbers)
    return checked(name, found, read_truth(truth), abbreviations)
