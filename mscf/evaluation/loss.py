"""What long-term tracking is worth: python -m mscf.evaluation.loss DATASET.

Each sequence is run from ten frames spread over it (`tre`), over the frames as they are, and again over frames in which
the target is made to vanish for a while and comes back where it then is. A plain tracker calls every frame a
measurement; the long-term tracker is asked.
"""

import argparse
import sys
from collections.abc import Sequence as Rows
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TextIO

import cv2
from threadpoolctl import threadpool_limits

from mscf.arrays import Image
from mscf.errors import MscfError
from mscf.evaluation.calibration import LEAST_OVERLAP, RUNS
from mscf.evaluation.datasets import Sequence, read_dataset
from mscf.evaluation.occlusion import hidden_span, without_target
from mscf.evaluation.protocol import starts
from mscf.geometry import Box
from mscf.long_term import LongTermPolicy, LongTermResult, LongTermTracker, TrackStatus
from mscf.tracker import Tracker

EXIT_USAGE = 2
HEAD = (
    "| sequence | tracker | called ok, wrong | off it | visible, not ok | found again | at a wrong size | wrong thing |"
)


@dataclass(frozen=True, slots=True)
class Count:
    """Frames and events of some runs; sums add up."""

    frames: int = 0  # after the first
    visible: int = 0  # of these, the target is to be seen
    wrong: int = 0  # called a measurement, but the overlap with the truth is below 0.25 or the target is hidden
    off: int = 0  # of these, the box does not even touch the target
    missed: int = 0  # visible, but not called a measurement
    right_again: int = 0  # times it was called found again, and was
    loose_again: int = 0  # so, but with an overlap below 0.25
    wrong_again: int = 0  # so, and the box did not touch the target

    def __add__(self, other: "Count") -> "Count":
        return Count(*(one + two for one, two in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True, slots=True)
class Claim:
    """What a tracker says of a frame."""

    box: Box
    is_measured: bool
    is_again: bool  # the first measurement after a loss


def count(claims: Rows[Claim], truth: Rows[Box | None]) -> Count:
    """Judge claims by the truth, None where the target is not to be seen."""
    total = Count()
    for claim, true in zip(claims, truth, strict=True):
        overlap = 0.0 if true is None else claim.box.iou(true)
        is_right = overlap >= LEAST_OVERLAP
        total += Count(
            frames=1,
            visible=true is not None,
            wrong=claim.is_measured and not is_right,
            off=claim.is_measured and overlap == 0,
            missed=true is not None and not claim.is_measured,
            right_again=claim.is_again and is_right,
            loose_again=claim.is_again and 0 < overlap < LEAST_OVERLAP,
            wrong_again=claim.is_again and overlap == 0,
        )
    return total


def plain_claims(frames: Rows[Image], box: Box) -> list[Claim]:
    """What `Tracker` says: always that it has the target."""
    tracker = Tracker()
    tracker.init(frames[0], box)
    return [Claim(tracker.update(frame).box, is_measured=True, is_again=False) for frame in frames[1:]]


def long_term_claims(frames: Rows[Image], box: Box, frame_s: float, policy: LongTermPolicy) -> list[Claim]:
    """What `LongTermTracker` says."""
    tracker = LongTermTracker(policy=policy)
    tracker.init(frames[0], box)
    results: list[LongTermResult] = []
    claims = []
    for index, frame in enumerate(frames[1:], start=1):
        results.append(tracker.update(frame, index * frame_s))
        was_confirming = index > 1 and results[-2].status is TrackStatus.CONFIRMING
        measured = results[-1].is_measured
        claims.append(Claim(results[-1].box, is_measured=measured, is_again=was_confirming and measured))
    return claims


def compare(sequence: Sequence, frame_s: float, policy: LongTermPolicy) -> dict[tuple[str, bool], Count]:
    """Counts by tracker and by whether the target was made to vanish; one thread."""
    cv2.setNumThreads(1)
    threadpool_limits(1, "blas")
    pictures = [sequence.read(index) for index in range(len(sequence.images))]
    counts: dict[tuple[str, bool], Count] = {}
    runs = starts(sequence, "tre", RUNS)
    for is_staged in (False, True):
        for run, start in enumerate(runs):
            frames, truth = pictures[start.index :], list(sequence.truth[start.index :])
            for index in hidden_span(len(frames), run, len(runs)) if is_staged else range(0):
                true = truth[index]
                if true is not None:
                    frames[index], truth[index] = without_target(frames[index], true), None
            for name, claims in (
                ("plain", plain_claims(frames, start.box)),
                ("long-term", long_term_claims(frames, start.box, frame_s, policy)),
            ):
                key = name, is_staged
                counts[key] = counts.get(key, Count()) + count(claims, truth[1:])
    return counts


def report(counts: dict[str, dict[tuple[str, bool], Count]], out: TextIO) -> None:
    """Print the counts by sequence as Markdown: shares of all frames, and of the visible ones; events."""
    for is_staged, title in ((False, "frames as they are"), (True, "the target covered for a while")):
        print(f"\n{title}\n\n{HEAD}\n|---|---|---|---|---|---|---|---|", file=out)
        totals: dict[str, Count] = {}
        for sequence, parts in counts.items():
            for name in ("plain", "long-term"):
                part = parts[name, is_staged]
                totals[name] = totals.get(name, Count()) + part
                print(_row(sequence, name, part), file=out)
        for name, total in totals.items():
            print(_row("**all**", name, total), file=out)


def _row(sequence: str, name: str, part: Count) -> str:
    shares = f"{part.wrong / part.frames:.1%} | {part.off / part.frames:.1%} | {part.missed / max(part.visible, 1):.1%}"
    return f"| {sequence} | {name} | {shares} | {part.right_again} | {part.loose_again} | {part.wrong_again} |"


def main(argv: Rows[str] | None = None) -> int:
    """Run the command line and return the exit status: 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(prog="python -m mscf.evaluation.loss", description=__doc__)
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder of NAME/img/ and NAME/groundtruth.txt")
    parser.add_argument(
        "--fps", type=float, default=10.0, help="frames a second of the sequences (default: %(default)s)"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: %(default)s)")
    arguments = parser.parse_args(argv)
    try:
        sequences = read_dataset(arguments.dataset).sequences
        work = partial(compare, frame_s=1 / arguments.fps, policy=LongTermPolicy())
        with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
            counts = dict(zip([s.name for s in sequences], pool.map(work, sequences), strict=True))
    except MscfError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return EXIT_USAGE
    report(counts, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
