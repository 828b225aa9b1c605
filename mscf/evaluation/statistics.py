"""Means over sequences and how far they can be trusted.

The sequence is the unit of the spread: runs over one sequence are alike, so more of them make no more evidence.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from mscf.arrays import Real64
from mscf.evaluation.record import Record, Run
from mscf.geometry import Box

RESAMPLES = 10_000
OUTSIDE = 0.05  # of the 95 % interval, half on each side
LEAST_SEQUENCES = 6  # of five, all differ in one direction by chance in 1 of 16 cases: more often than OUTSIDE

Start = tuple[str, int, Box]  # sequence, first frame and first box


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and its 95 % interval; all NaN where there is no value, and no limits of a single one."""

    mean: float
    low: float
    high: float
    count: int  # values that count


@dataclass(frozen=True, slots=True)
class Difference:
    """A minus B over what both have run: mean over the pairs of runs of a sequence, then over sequences."""

    mean: float
    low: float
    high: float
    sequences: int
    pairs: int
    wins: int  # sequences in which A is higher
    losses: int
    unpaired: int  # runs that only one side has

    @property
    def is_real(self) -> bool:
        """Whether the interval does not touch zero; never so of fewer than six sequences."""
        return self.sequences >= LEAST_SEQUENCES and (self.low > 0 or self.high < 0)


def bootstrap_mean(values: Real64, seed: int = 0) -> Interval:
    """Mean and its percentile bootstrap interval (Efron, Tibshirani, "An Introduction to the Bootstrap", 1993, 13).

    The order of the values does not matter; the same values give the same interval on every machine. It is narrow
    where there are few: of 6, 11, 20 and 40 normal values it held the true mean in 87, 92, 93 and 93 % of 2 000 cases,
    of skewed ones in 85, 90, 92 and 93 %.

    Parameters
    ----------
    values : (n,), one a sequence; NaN is left out.
    """
    known = np.sort(values[~np.isnan(values)])
    if not known.size:
        return Interval(math.nan, math.nan, math.nan, 0)
    mean = fmean(known)
    if known.size == 1:
        return Interval(mean, math.nan, math.nan, 1)
    rng = np.random.Generator(np.random.PCG64(seed))
    total = np.zeros(RESAMPLES)
    for _ in known:  # added one by one: the order of a sum over an axis, and with it the last bit, is the machine's
        total += known[rng.integers(known.size, size=RESAMPLES)]
    low, high = np.quantile(total / known.size, (OUTSIDE / 2, 1 - OUTSIDE / 2))
    return Interval(mean, float(low), float(high), known.size)


def sequence_values(records: Sequence[Record], value: Callable[[Run], float]) -> dict[str, float]:
    """Mean of a value over the runs of each sequence, by its name.

    OTB's code weights the runs of a sequence by their frames; here each counts the same, as the long ones are the
    early ones. Runs whose value is NaN are left out; NaN where no run has one.

    Parameters
    ----------
    records : of one tracker.
    """
    assert len({record.sequence for record in records}) == len(records)
    return {record.sequence: _known_mean([value(run) for run in record.runs]) for record in records}


def paired_difference(
    a: Sequence[Record], b: Sequence[Record], value: Callable[[Run], float], seed: int = 0
) -> Difference:
    """Difference of two trackers, paired by sequence, frame and box of the start.

    Runs that only one side has are counted, but not used. Pairs in which a value is NaN are not counted: the frames
    they share have no truth.
    """
    values_a, values_b = dict(_by_start(a, value)), dict(_by_start(b, value))
    by_sequence: dict[str, list[float]] = {}
    for start in values_a.keys() & values_b.keys():  # in any order: neither a mean nor an interval feels it
        difference = values_a[start] - values_b[start]
        if not math.isnan(difference):
            by_sequence.setdefault(start[0], []).append(difference)
    means = np.array([fmean(differences) for differences in by_sequence.values()], dtype=np.float64)
    interval = bootstrap_mean(means, seed)
    return Difference(
        mean=interval.mean,
        low=interval.low,
        high=interval.high,
        sequences=interval.count,
        pairs=sum(map(len, by_sequence.values())),
        wins=int(np.count_nonzero(means > 0)),
        losses=int(np.count_nonzero(means < 0)),
        unpaired=len(values_a.keys() ^ values_b.keys()),
    )


def _by_start(records: Sequence[Record], value: Callable[[Run], float]) -> Iterator[tuple[Start, float]]:
    """Value of each run."""
    return (((record.sequence, run.first, run.boxes[0]), value(run)) for record in records for run in record.runs)


def _known_mean(values: Sequence[float]) -> float:
    """Mean of what is not NaN; NaN where nothing is."""
    known = [value for value in values if not math.isnan(value)]
    return fmean(known) if known else math.nan
