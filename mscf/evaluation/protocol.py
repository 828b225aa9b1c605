"""From where, and how often, a tracker is run over a sequence.

The protocols are those of OTB: Wu, Lim, Yang, "Online Object Tracking: A Benchmark", CVPR 2013, and the code published
with it (`splitSeqTRE`, `shiftInitBB`).
"""

from dataclasses import dataclass

from mscf.errors import ConfigError
from mscf.evaluation.datasets import Sequence
from mscf.frame import MIN_BOX_PX
from mscf.geometry import Box

PROTOCOLS: tuple[str, ...] = ("ope", "tre", "sre")
TRE_STARTS = 20
TRE_LEAST_FRAMES = 20  # of a run
SRE_SHIFT = 0.1  # of the box's width and height
SRE_SCALES = (0.8, 0.9, 1.1, 1.2)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins; it goes on to the end of the sequence."""

    index: int  # first frame
    box: Box


def starts(sequence: Sequence, protocol: str, count: int = TRE_STARTS) -> tuple[Start, ...]:
    """Runs of a protocol, in the order of their first frames; none where the sequence has no box to start from.

    ope : one, from the first true box.
    tre : `count`, from the true boxes of frames spread evenly over those that a run can start from; at most one a
        frame. These are, as in OTB, the frames whose true box has its corner in the image and which have 20 frames
        of the sequence left, themselves included. Deviations: the box has sides of at least 4 px, as less is no target;
        a sequence of under 40 frames has half of it left, where OTB's code demands 20 and stops.
    sre : twelve, from the first true box shifted to its four sides by 10 % of its size, with one of its four corners
        moved outwards so, and scaled about its centre by 0.8, 0.9, 1.1 and 1.2. Deviation: OTB's code rounds to
        whole pixels, which of a target of 11 px makes a shift of 18 %, and cuts the box at the image's border.

    Raises
    ------
    ConfigError
        If there is no such protocol.
    """
    if protocol not in PROTOCOLS:
        raise ConfigError(f"unknown protocol {protocol!r}: choose from {', '.join(PROTOCOLS)}")
    if protocol == "tre":
        return _temporal(sequence.truth, count)
    first = next((Start(index, box) for index, box in enumerate(sequence.truth) if box is not None), None)
    if first is None:
        return ()
    return (first,) if protocol == "ope" else tuple(Start(first.index, box) for box in _spatial(first.box))


def _temporal(truth: tuple[Box | None, ...], count: int) -> tuple[Start, ...]:
    least = max(min(TRE_LEAST_FRAMES, len(truth) // 2), 2)  # two frames are one update
    usable = [
        Start(index, box)
        for index, box in enumerate(truth[: len(truth) - least + 1])
        if box is not None and min(box.w, box.h) >= MIN_BOX_PX and min(box.to_one_based()[:2]) > 0
    ]
    steps = max(count - 1, 1)
    # the last one is the last usable; a set, as of few usable frames some are found twice
    chosen = {min(step * len(usable) // steps, len(usable) - 1) for step in range(count)} if usable else set()
    return tuple(usable[number] for number in sorted(chosen))


def _spatial(box: Box) -> list[Box]:
    x, y, w, h = box.x, box.y, box.w, box.h
    dx, dy = SRE_SHIFT * w, SRE_SHIFT * h
    shifted = [Box(x - dx, y, w, h), Box(x + dx, y, w, h), Box(x, y - dy, w, h), Box(x, y + dy, w, h)]
    # with a corner moved outwards the box grows to both sides of it, and the opposite corner stays
    moved = [Box(left, top, w + dx, h + dy) for top in (y - dy, y) for left in (x - dx, x)]
    scaled = [Box(x + w * (1 - s) / 2, y + h * (1 - s) / 2, s * w, s * h) for s in SRE_SCALES]
    return shifted + moved + scaled
