"""Whether one tracker is better than another, or than its earlier self."""

from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from mscf.errors import SourceError
from mscf.evaluation.metrics import score
from mscf.evaluation.record import RUNS, Record, Run, read_tracker, tracker_of
from mscf.evaluation.statistics import LEAST_SEQUENCES, Difference, paired_difference

METRICS: dict[str, Callable[[Run], float]] = {
    "AUC": lambda run: score(run.errors).auc,
    "precision": lambda run: score(run.errors).precision,
    "OP@0.5": lambda run: score(run.errors).op50,
    "normalised precision": lambda run: score(run.errors).norm_precision,
}
MANY_SEQUENCES = 20  # from here on, the bootstrap's 95 % are 92 % and more; of eleven they are 90 %


def compare(a: Path, b: Path, out: TextIO) -> None:
    """Print the differences of two trackers, paired by sequence and start.

    Parameters
    ----------
    a, b : folders OUT/runs/TRACKER of one evaluation or of two.

    Raises
    ------
    SourceError
        If one of them is no such folder, or they have no run in common.
    OutputError
        If a file in them is damaged.
    """
    sides = {"A": _records(a), "B": _records(b)}
    differences = {name: paired_difference(sides["A"], sides["B"], value) for name, value in METRICS.items()}
    first = next(iter(differences.values()))
    if not first.pairs:
        raise SourceError(f"{a} and {b} have no run in common: give two of the same data set and protocol")
    for side, folder, other in (("A", a, "B"), ("B", b, "A")):
        names = {record.sequence for record in sides[side]}
        print(f"{side}: {sides[side][0].tracker}, {folder}: {_counted(len(names), 'sequence')}", file=out)
        alone = sorted(names - {record.sequence for record in sides[other]})
        if alone:
            print(f"   not in {other}, left out: {', '.join(alone)}", file=out)
    pairs, sequences = _counted(first.pairs, "pair"), _counted(first.sequences, "sequence")
    print(f"\n{pairs} of runs from the same start over {sequences};", file=out, end=" ")
    print(f"{_counted(first.unpaired, 'run')} without its like on the other side left out.", file=out)
    print("Means over runs, then over sequences; 95 % intervals by bootstrap over sequences.\n", file=out)
    print("| | A - B | 95 % interval | A higher in | B higher in | the difference is |", file=out)
    print("|---|---|---|---|---|---|", file=out)
    for name, found in differences.items():
        print(f"| {name} | {_row(found)} |", file=out)
    if first.sequences < LEAST_SEQUENCES:
        print(f"\nFewer than {LEAST_SEQUENCES} sequences show nothing: chance makes them agree too often.", file=out)
    elif first.sequences < MANY_SEQUENCES:
        print(
            f"\nOf fewer than {MANY_SEQUENCES} sequences, about 1 interval in 10 misses what it should hold.", file=out
        )


def _records(runs: Path) -> tuple[Record, ...]:
    """Records in OUT/runs/TRACKER.

    Raises
    ------
    SourceError
        If it is no such folder, or has none.
    """
    folder = runs.resolve()
    records = read_tracker(folder.parent.parent, tracker_of(folder)) if folder.parent.name == RUNS else ()
    if not records:
        raise SourceError(f"{runs} holds no runs: give OUT/{RUNS}/TRACKER of an evaluation")
    return records


def _row(found: Difference) -> str:
    """Cells of one metric."""
    verdict = "real" if found.is_real else "not shown by these sequences"
    interval = "-" if found.sequences == 1 else f"{found.low:+.3f} to {found.high:+.3f}"
    return f"{found.mean:+.3f} | {interval} | {found.wins} | {found.losses} | {verdict}"


def _counted(count: int, noun: str) -> str:
    """Number and noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
