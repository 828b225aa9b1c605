"""UAV123 and its version of a third of the frames, UAV123@10fps.

M. Mueller, N. Smith, B. Ghanem: A Benchmark and Simulator for UAV Tracking, ECCV 2016. The layout, VERSION being
`UAV123` or `UAV123_10fps`:

* `data_seq/VERSION/FOLDER/000001.jpg` ...: one folder may hold several clips;
* `anno/VERSION/CLIP.txt`: x,y,w,h a frame of the clip, 1-based, NaN where the target is hidden or out of view;
* `anno/VERSION/att/CLIP.txt`: twelve flags in one line.
"""

from functools import partial
from pathlib import Path

from mscf.errors import SourceError
from mscf.evaluation.datasets.sequence import Catalogue, Sequence, checked, images_between, read_flags
from mscf.images import read_truth

# order of the flags: `perfPlot.m` of the authors' benchmark
ATTRIBUTES = ("SV", "ARC", "LR", "FM", "FOC", "POC", "OV", "BC", "IV", "VC", "CM", "SOB")

# versions by folder name: name as papers have it, and how many frames of UAV123 it goes on by
VERSIONS = {"UAV123_10fps": ("UAV123@10fps", 3), "UAV123": ("UAV123", 1)}

# first and last frame of each clip in UAV123, from the authors' `configSeqs.m`. A folder's only clip has its name,
# several have a number behind it: bird1_1, bird1_2, bird1_3
_FRAMES = """
bike1 1-3085, bike2 1-553, bike3 1-433
bird1 1-253 775-1477 1573-2437
boat1 1-901, boat2 1-799, boat3 1-901, boat4 1-553, boat5 1-505, boat6 1-805, boat7 1-535, boat8 1-685, boat9 1-1399
building1 1-469, building2 1-577, building3 1-829, building4 1-787, building5 1-481
car1 1-751 751-1627 1627-2629, car2 1-1321, car3 1-1717, car4 1-1345, car5 1-745
car6 1-487 487-1807 1807-2953 2953-3925 3925-4861, car7 1-1033, car8 1-1357 1357-2575, car9 1-1879
car10 1-1405, car11 1-337, car12 1-499, car13 1-415, car14 1-1327, car15 1-469
car16 1-415 415-1993, car17 1-1057, car18 1-1207
car1_s 1-1475, car2_s 1-320, car3_s 1-1300, car4_s 1-830
group1 1-1333 1333-2515 2515-3925 3925-4873, group2 1-907 907-1771 1771-2683
group3 1-1567 1567-2827 2827-4369 4369-5527
person1 1-799, person2 1-1189 1189-2623, person3 1-643, person4 1-1501 1501-2743, person5 1-877 877-2101
person6 1-901, person7 1-1249 1249-2065, person8 1-1075 1075-1525, person9 1-661, person10 1-1021, person11 1-721
person12 1-601 601-1621, person13 1-883, person14 1-847 847-1813 1813-2923, person15 1-1339, person16 1-1147
person17 1-1501 1501-2347, person18 1-1393, person19 1-1243 1243-2791 2791-4357, person20 1-1783
person21 1-487, person22 1-199, person23 1-397
person1_s 1-1600, person2_s 1-250, person3_s 1-505
truck1 1-463, truck2 1-385, truck3 1-535, truck4 1-577 577-1261
uav1 1-1555 1555-2377 2473-3469, uav2 1-133, uav3 1-265, uav4 1-157, uav5 1-139, uav6 1-109, uav7 1-373, uav8 1-301
wakeboard1 1-421, wakeboard2 1-733, wakeboard3 1-823, wakeboard4 1-697, wakeboard5 1-1675
wakeboard6 1-1165, wakeboard7 1-199, wakeboard8 1-1543, wakeboard9 1-355, wakeboard10 1-469
"""


def clips(step: int) -> dict[str, tuple[str, int, int]]:
    """Folder, first and last image number (1-based) of each of the 123 clips, where every `step`th frame is kept."""
    found = {}
    for entry in _FRAMES.strip().replace("\n", ",").split(","):
        folder, *ranges = entry.split()
        for number, frames in enumerate(ranges, start=1):
            first, last = ((int(frame) - 1) // step + 1 for frame in frames.split("-"))
            found[folder if len(ranges) == 1 else f"{folder}_{number}"] = (folder, first, last)
    return found


def catalogue(folder: Path) -> Catalogue | None:
    """The clips of which images or boxes are there; None where the folder has not this layout.

    A folder with both versions is refused; `data_seq/VERSION` in it tells which is meant.

    Raises
    ------
    SourceError
        If both versions are there, or one half of the layout is missing.
    """
    root = folder
    found = [version for version in VERSIONS if any((root / half / version).is_dir() for half in ("data_seq", "anno"))]
    path = folder.resolve()
    if path.parent.name == "data_seq" and path.name in VERSIONS:
        root, found = path.parent.parent, [path.name]
    if not found:
        return None
    if len(found) > 1:
        choices = " or ".join(str(root / "data_seq" / version) for version in found)
        raise SourceError(f"{folder} holds two versions of UAV123: give {choices}")
    images, boxes = root / "data_seq" / found[0], root / "anno" / found[0]
    for half in (images, boxes):
        if not half.is_dir():
            raise SourceError(f"{half} is missing: {found[0]} has its images in data_seq and its boxes in anno")
    name, step = VERSIONS[found[0]]
    return Catalogue(
        name,
        {
            clip: partial(_read, clip, images / source, first, last, boxes)
            for clip, (source, first, last) in clips(step).items()
            if (images / source).is_dir() or (boxes / f"{clip}.txt").is_file()
        },
    )


def _read(clip: str, images: Path, first: int, last: int, boxes: Path) -> Sequence:
    return checked(
        clip,
        images_between(images, first, last),
        read_truth(boxes / f"{clip}.txt"),
        read_flags(boxes / "att" / f"{clip}.txt", ATTRIBUTES),
    )
