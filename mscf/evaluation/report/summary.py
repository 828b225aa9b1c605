"""What records come to: means over the runs of a sequence, then over sequences, with their intervals."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mscf.arrays import Real64
from mscf.evaluation.metrics import Score, precision_curve, score, success_curve
from mscf.evaluation.record import Record
from mscf.evaluation.statistics import Interval, bootstrap_mean
from mscf.geometry import Box

# fields of Score, and how they are called in print
METRICS = {"precision": "precision", "norm_precision": "norm. precision", "auc": "AUC", "op50": "OP@0.5"}
PLACES = 3  # how many of the best are marked


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """One tracker on one sequence; curves and scores are means over the runs, NaN where no frame has truth."""

    attributes: frozenset[str]
    score: Score
    precision_curve: Real64  # (51,)
    success_curve: Real64  # (21,)
    starts: tuple[tuple[int, Box], ...]  # first frame and box of each run
    update_ms: tuple[float, ...]  # of all updates that gave an answer
    updates: int
    lost: int  # updates after which the tracker had no box of its own
    faults: tuple[str, ...]  # what was raised first in each run that raised


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One tracker over several sequences."""

    tracker: str
    means: Mapping[str, Interval]  # by the keys of METRICS
    precision_curve: Real64  # (51,)
    success_curve: Real64  # (21,)
    updates_per_s: float  # NaN where no update was timed
    runs: int
    updates: int
    lost: int
    faults: Mapping[str, int]  # in how many runs a thing was raised first


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """All that tables, plots and the page show.

    trackers : in the order asked for, without those that have no record.
    missing : those.
    sequences : all of the records, by name.
    counted : those that every tracker has run from the same starts; means over other runs for each compare nothing.
    cells : by sequence and tracker; a tracker that has no record of a sequence has none here.
    rows : over the counted sequences, in the order of the trackers.
    having : counted sequences that have an attribute, by its name.
    attributes : rows over those.
    """

    trackers: tuple[str, ...]
    missing: tuple[str, ...]
    sequences: tuple[str, ...]
    counted: tuple[str, ...]
    cells: Mapping[str, Mapping[str, Cell]]
    rows: tuple[Row, ...]
    having: Mapping[str, tuple[str, ...]]
    attributes: Mapping[str, tuple[Row, ...]]


def summarize(records: Collection[Record], order: Sequence[str]) -> Summary:
    """Work out what a report shows of the trackers in `order`, which leaves all others out."""
    known = {record.tracker for record in records}
    trackers = tuple(name for name in dict.fromkeys(order) if name in known)
    cells: dict[str, dict[str, Cell]] = {}
    for record in sorted(records, key=lambda record: record.sequence):
        if record.tracker in trackers:
            cells.setdefault(record.sequence, {})[record.tracker] = _cell(record)
    counted = tuple(
        sequence
        for sequence, row in cells.items()
        if len(row) == len(trackers) and len({cell.starts for cell in row.values()}) == 1
    )

    def rows(sequences: Collection[str]) -> tuple[Row, ...]:
        return tuple(_row(name, [cells[sequence][name] for sequence in sequences]) for name in trackers)

    having: dict[str, list[str]] = {}
    for sequence in counted:
        for name in sorted({name for cell in cells[sequence].values() for name in cell.attributes}):
            having.setdefault(name, []).append(sequence)
    return Summary(
        trackers,
        tuple(dict.fromkeys(name for name in order if name not in known)),
        tuple(cells),
        counted,
        cells,
        rows(counted),
        {name: tuple(having[name]) for name in sorted(having)},
        {name: rows(having[name]) for name in sorted(having)},
    )


def places(values: Sequence[float]) -> tuple[int, ...]:
    """1, 2 and 3 for the best three, equal values alike; 0 for the others, and for all where there is one value."""
    known = [value for value in values if not math.isnan(value)]
    if len(known) < 2:
        return (0,) * len(values)
    ranks = (0 if math.isnan(value) else 1 + sum(other > value for other in known) for value in values)
    return tuple(rank if rank <= PLACES else 0 for rank in ranks)


def _cell(record: Record) -> Cell:
    scores = [score(run.errors) for run in record.runs]
    mean = {name: float(_mean([getattr(one, name) for one in scores])) for name in METRICS}
    return Cell(
        record.attributes,
        Score(**mean),
        _mean([precision_curve(run.errors) for run in record.runs]),
        _mean([success_curve(run.errors) for run in record.runs]),
        tuple((run.first, run.boxes[0]) for run in record.runs),
        tuple(ms for run in record.runs for ms in run.update_ms if not math.isnan(ms)),
        sum(len(run.boxes) - 1 for run in record.runs),
        sum(sum(run.is_lost) for run in record.runs),
        tuple(run.fault for run in record.runs if run.fault),
    )


def _row(tracker: str, cells: Sequence[Cell]) -> Row:
    times_ms = [ms for cell in cells for ms in cell.update_ms]
    return Row(
        tracker,
        {name: bootstrap_mean(np.array([getattr(cell.score, name) for cell in cells])) for name in METRICS},
        _mean([cell.precision_curve for cell in cells]),
        _mean([cell.success_curve for cell in cells]),
        1e3 * len(times_ms) / math.fsum(times_ms) if math.fsum(times_ms) > 0 else math.nan,
        sum(len(cell.starts) for cell in cells),
        sum(cell.updates for cell in cells),
        sum(cell.lost for cell in cells),
        Counter(fault for cell in cells for fault in cell.faults),
    )


def _mean(values: Sequence[Real64] | Sequence[float]) -> Real64:
    """Mean of what is not NaN along the first axis; NaN where nothing is left."""
    rows = np.array(values, dtype=np.float64)
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    return np.asarray(np.where(known, rows, 0).sum(axis=0) / np.where(count > 0, count, np.nan))
