"""How a tracker is run over a sequence: from where, and how often."""

import signal
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TextIO

import cv2
from threadpoolctl import threadpool_limits

from mscf.evaluation.datasets import Sequence
from mscf.evaluation.metrics import Score, score
from mscf.evaluation.peers import tracker_factory
from mscf.frame import MIN_BOX_PX
from mscf.geometry import Box

PROTOCOLS: tuple[str, ...] = ("ope", "jitter", "tre")
TRE_STARTS = 5


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins."""

    index: int  # first frame
    box: Box


@dataclass(frozen=True, slots=True)
class Run:
    """One tracker's run over one sequence."""

    sequence: str
    tracker: str
    start: Start
    score: Score
    update_ms: tuple[float, ...]  # of each update, image decoding excluded


def starts(sequence: Sequence, protocol: str) -> tuple[Start, ...]:
    """Runs of a protocol.

    ope : one, from the first frame's true box.
    jitter : nine, from the true box and its eight shifts by 1 px: single runs are bistable on some sequences.
    tre : five, from the true boxes of frames spread evenly over the sequence, each to its end (OTB's TRE); from
        the next frame where one has no box of at least 4 px.
    """
    first = sequence.truth[0]
    assert first is not None  # read_sequence refuses such a sequence
    if protocol == "ope":
        return (Start(0, first),)
    if protocol == "jitter":
        shifts = [(0, 0)] + [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (dx, dy) != (0, 0)]
        return tuple(Start(0, Box(first.x + dx, first.y + dy, first.w, first.h)) for dx, dy in shifts)
    count = len(sequence.truth)
    found: dict[int, Box] = {}  # a gap in the truth may send two segments to one frame
    for segment in range(TRE_STARTS):
        for index in range(segment * count // TRE_STARTS, count - 1):
            box = sequence.truth[index]
            if box is not None and min(box.w, box.h) >= MIN_BOX_PX:
                found[index] = box
                break
    return tuple(Start(index, box) for index, box in found.items())


def run_sequence(sequence: Sequence, name: str, protocol: str, color_table: Path | None = None) -> list[Run]:
    """Run a tracker from each start of a protocol; one thread, image decoding not timed."""
    cv2.setNumThreads(1)
    threadpool_limits(1, "blas")
    make = tracker_factory(name, color_table)
    frames = [sequence.read(index) for index in range(len(sequence.images))]
    runs = []
    for start in starts(sequence, protocol):
        tracker = make()
        tracker.init(frames[start.index], start.box)
        boxes, update_ms = [start.box], []
        for frame in frames[start.index + 1 :]:
            begin_s = time.perf_counter()
            boxes.append(tracker.update(frame).box)
            update_ms.append((time.perf_counter() - begin_s) * 1e3)
        runs.append(Run(sequence.name, name, start, score(boxes, sequence.truth[start.index :]), tuple(update_ms)))
    return runs


def run_dataset(
    sequences: tuple[Sequence, ...],
    names: tuple[str, ...],
    protocol: str,
    *,
    color_table: Path | None,
    jobs: int,
    log: TextIO,
) -> list[Run]:
    """Run every tracker over every sequence, `jobs` processes at a time; `log` hears of each that is done.

    Raises
    ------
    MscfError
        If a tracker is unknown or missing, or an image cannot be decoded.
    """
    for name in names:
        tracker_factory(name, color_table)  # fails now rather than after an hour
    runs: list[Run] = []
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_ignore_ctrl_c)
    try:
        waiting = {
            pool.submit(run_sequence, sequence, name, protocol, color_table): (sequence.name, name)
            for sequence in sequences
            for name in names
        }
        for done, future in enumerate(as_completed(waiting), start=1):
            runs += future.result()
            print(f"{done} of {len(waiting)}: {' '.join(waiting[future])}", file=log, flush=True)
    except BaseException:
        # neither Ctrl-C nor the first error waits for what is still in the queue
        for process in list(pool._processes.values()):  # noqa: SLF001 - terminate_workers comes with Python 3.14
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    pool.shutdown()
    return runs


def _ignore_ctrl_c() -> None:
    """Leave it to the parent, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
