"""Calibration of the confidence: python -m mscf.evaluation.calibration DATASET.

The tracker runs over each sequence from ten frames spread over it (`tre`), twice: over the frames as they are, and over
frames in which the target is made to vanish for a while. Each response becomes one row: what it measured, and
whether the box held the target. A logistic regression is fitted to the rows, every sequence with the same weight, and
judged on the sequence that was left out of the fit.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence as Rows
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from mscf.arrays import Real, Real64
from mscf.confidence import BIAS, LOG_PSR, LOWEST_PEAK, peak_to_sidelobe
from mscf.errors import MscfError, OutputError
from mscf.evaluation.datasets import Sequence, read_dataset
from mscf.evaluation.occlusion import hidden_span, without_target
from mscf.evaluation.protocol import starts
from mscf.figure import check_plottable
from mscf.recording import check_writable
from mscf.tracker import Tracker

LEAST_OVERLAP = 0.25  # with the truth, for a box to hold the target
RUNS = 10  # over a sequence, from frames spread over it: runs from one frame and its neighbours are all alike
CHOSEN = ("PSR",)  # what `mscf.confidence` uses; in the order of its coefficients
FIRST_RESPONSES = 5  # after the start, whose mean is what "over first" is relative to
RECENT_RATE = 0.2  # of the running mean, per response: its memory is five responses
SHOWN = ("truck2", "Surfing06", "car16_1")  # hidden, lost, and lost with a change of size
LOWEST_PSR = 1e-3  # of the argument of the logarithm
RIDGE = 1e-3  # of the fit, against separable data; the coefficients do not feel it
CONVERGED = 1e-9
BINS = 10
EXIT_USAGE = 2

Labels = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Responses:
    """Rows of one sequence."""

    sequence: str
    features: dict[str, Real64]  # (n,) each, by name
    is_held: Labels  # (n,) whether the box held the target
    is_covered: Labels  # (n,) whether the target was made to vanish
    is_staged: Labels  # (n,) whether the run is one with a target made to vanish


@dataclass(frozen=True, slots=True)
class Roc:
    """Receiver operating characteristic, from the highest threshold to the lowest."""

    false_rate: Real64  # share of the wrong boxes at or above the threshold
    true_rate: Real64  # share of the right ones
    auc: float


def peak_to_energy(response: Real) -> float:
    """Average peak-to-correlation energy: (maximum - minimum)^2 over the mean of (value - minimum)^2.

    High where one sharp peak stands over calm surroundings (Wang et al., CVPR 2017).

    Parameters
    ----------
    response : (M, N) float32.

    Returns
    -------
    1 .. M*N; 1 for a map that is constant.
    """
    above = response.astype(np.float64) - float(response.min())
    energy = float(np.mean(above * above))
    return float(above.max()) ** 2 / energy if energy > 0 else 1.0


def collect(sequence: Sequence) -> Responses:
    """Run the tracker over a sequence as the module says, one thread.

    A frame without truth has no target: no box holds it. A response without a peak is left out, as the confidence
    is 0 there without asking a regression.
    """
    cv2.setNumThreads(1)
    threadpool_limits(1, "blas")
    pictures = [sequence.read(index) for index in range(len(sequence.images))]
    columns: dict[str, list[Real64]] = {}
    is_held: list[bool] = []
    is_covered: list[bool] = []
    is_staged: list[bool] = []
    runs = starts(sequence, "tre", RUNS)
    for stage in (False, True):
        for run, start in enumerate(runs):
            frames, truth = pictures[start.index :], sequence.truth[start.index :]
            span = hidden_span(len(frames), run, len(runs)) if stage else range(0)
            tracker, rows = Tracker(), []
            tracker.init(frames[0], start.box)
            for index in range(1, len(frames)):
                true = truth[index]
                covers = true is not None and index in span
                frame = without_target(frames[index], true) if true is not None and covers else frames[index]
                seen: dict[str, Any] = {}
                result = tracker.update(frame, probe=seen.__setitem__)
                response = seen["response"]
                if not result.peak > LOWEST_PEAK:
                    continue
                log_psr = math.log(max(peak_to_sidelobe(response), LOWEST_PSR))
                rows.append((math.log(result.peak), math.log(peak_to_energy(response)), log_psr, result.threat))
                is_held.append(true is not None and not covers and result.box.iou(true) >= LEAST_OVERLAP)
                is_covered.append(covers)
                is_staged.append(stage)
            for name, column in features_of(np.array(rows)).items():
                columns.setdefault(name, []).append(column)
    features = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Responses(sequence.name, features, np.array(is_held), np.array(is_covered), np.array(is_staged))


def features_of(rows: Real64) -> dict[str, Real64]:
    """Candidates for the regression, of one run: (n, 4) log peak, log APCE, log PSR, threat -> (n,) each.

    "recent" is the running mean; "over first" is relative to the mean of the first responses of the run.
    """
    count = np.minimum(np.arange(1, len(rows) + 1), FIRST_RESPONSES)
    first = np.cumsum(rows, axis=0)[count - 1] / count[:, None]  # (n, 4)
    recent = rows.copy()
    for index in range(1, len(rows)):
        recent[index] = recent[index - 1] + RECENT_RATE * (rows[index] - recent[index - 1])
    features: dict[str, Real64] = {}
    for number, name in enumerate(("peak", "APCE", "PSR", "threat")):
        now, mean = rows[:, number], recent[:, number]
        features |= {name: now, f"recent {name}": mean}
        features |= {f"{name} over first": now - first[:, number], f"recent {name} over first": mean - first[:, number]}
    return features


def logistic(x: Real64, coefficients: Real64) -> Real64:
    """Probability of each row: (n, k) and (1 + k,), the bias first -> (n,)."""
    return np.asarray(1 / (1 + np.exp(-(coefficients[0] + x @ coefficients[1:]))))


def fit_logistic(x: Real64, is_held: Labels, weight: Real64) -> Real64:
    """Coefficients of the logistic regression of largest weighted likelihood, by Newton's method.

    Parameters
    ----------
    x : (n, k); is_held : (n,); weight : (n,), not negative.

    Returns
    -------
    (1 + k,), the bias first.
    """
    rows = np.column_stack([np.ones(len(x)), x])  # (n, 1 + k)
    ridge = RIDGE * np.diag([0.0] + [1.0] * x.shape[1])
    coefficients = np.zeros(rows.shape[1])
    for _ in range(100):
        p = logistic(x, coefficients)
        gradient = rows.T @ (weight * (is_held - p)) - ridge @ coefficients
        hessian = (rows * (weight * p * (1 - p))[:, None]).T @ rows + ridge
        step = np.linalg.solve(hessian, gradient)
        coefficients = coefficients + step
        if np.abs(step).max() < CONVERGED:
            break
    return coefficients


def equal_weights(sequences: npt.NDArray[np.intp]) -> Real64:
    """Weights that give every sequence the same sum, and the mean 1: (n,) numbers of sequences -> (n,)."""
    counts = np.bincount(sequences)
    return np.asarray(len(sequences) / np.count_nonzero(counts) / counts[sequences])


def roc(p: Real64, is_held: Labels, weight: Real64) -> Roc:
    """ROC of a score; equal scores share a threshold. The area is NaN where all boxes are right, or all are wrong."""
    _, level = np.unique(-p, return_inverse=True)
    right, wrong = np.bincount(level, weight * is_held), np.bincount(level, weight * ~is_held)
    if not (right.sum() > 0 and wrong.sum() > 0):
        return Roc(np.array([]), np.array([]), math.nan)
    true_rate = np.concatenate([[0], np.cumsum(right) / right.sum()])
    false_rate = np.concatenate([[0], np.cumsum(wrong) / wrong.sum()])
    return Roc(false_rate, true_rate, float(np.trapezoid(true_rate, false_rate)))


def log_loss(p: Real64, is_held: Labels, weight: Real64) -> float:
    """Mean of minus the logarithm of the probability given to what was the case."""
    likelihood = np.clip(np.where(is_held, p, 1 - p), 1e-12, 1)
    return float(np.average(-np.log(likelihood), weights=weight))


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of all sequences."""

    names: tuple[str, ...]  # of the sequences
    sequence: npt.NDArray[np.intp]  # (n,) index into names
    features: dict[str, Real64]
    is_held: Labels
    is_covered: Labels
    is_staged: Labels
    weight: Real64  # (n,)

    @classmethod
    def of(cls, parts: Rows[Responses]) -> "Table":
        """One below the other."""
        sequence = np.repeat(np.arange(len(parts)), [len(part.is_held) for part in parts])
        return cls(
            tuple(part.sequence for part in parts),
            sequence,
            {name: np.concatenate([part.features[name] for part in parts]) for name in parts[0].features},
            np.concatenate([part.is_held for part in parts]),
            np.concatenate([part.is_covered for part in parts]),
            np.concatenate([part.is_staged for part in parts]),
            equal_weights(sequence),
        )

    def fit(self, names: Rows[str]) -> Real64:
        """Coefficients from all sequences."""
        return fit_logistic(self._columns(names), self.is_held, self.weight)

    def left_out(self, names: Rows[str]) -> Real64:
        """Probability of each row by the regression on all other sequences: (n,)."""
        x, p = self._columns(names), np.empty(len(self.is_held))
        for index in range(len(self.names)):
            out = self.sequence == index
            p[out] = logistic(x[out], fit_logistic(x[~out], self.is_held[~out], self.weight[~out]))
        return p

    def roc(self, p: Real64, where: Labels | None = None) -> Roc:
        """ROC of all rows, or of some."""
        some = np.ones(len(p), bool) if where is None else where
        return roc(p[some], self.is_held[some], self.weight[some])

    def _columns(self, names: Rows[str]) -> Real64:
        return np.column_stack([self.features[name] for name in names])


@dataclass(frozen=True, slots=True)
class Bin:
    """Responses that were given about the same confidence."""

    low: float
    high: float
    rows: int
    mean: float  # confidence; NaN where there are none
    held: float  # share whose box held the target, sequences weighted alike; NaN where there are none


def reliability(table: Table, p: Real64, where: Labels) -> tuple[Bin, ...]:
    """What was the case where the confidence was 0 to 0.1, and so on, of the rows in `where`."""
    level = np.minimum((p * BINS).astype(int), BINS - 1)
    bins = []
    for index in range(BINS):
        some = where & (level == index)
        weight = table.weight[some]
        mean, held = (
            (float(np.average(p[some], weights=weight)), float(np.average(table.is_held[some], weights=weight)))
            if some.any()
            else (math.nan, math.nan)
        )
        bins.append(Bin(index / BINS, (index + 1) / BINS, int(some.sum()), mean, held))
    return tuple(bins)


def report(table: Table, out: TextIO) -> dict[str, Any]:
    """Print what docs/confidence.md shows; the same as a value for JSON."""
    chosen, p = table.fit(CHOSEN), table.left_out(CHOSEN)
    real, staged = ~table.is_staged, table.is_covered | (table.is_staged & table.is_held)
    rows = f"{len(p)} responses of {len(table.names)} sequences, {table.is_held.sum()} on the target"
    print(f"{rows}, {table.is_covered.sum()} with the target covered", file=out)
    print(f"fitted : BIAS = {chosen[0]:.2f}, LOG_PSR = {chosen[1]:.2f}", file=out)
    print(f"in use : BIAS = {BIAS:.2f}, LOG_PSR = {LOG_PSR:.2f}\n", file=out)

    print("area under the ROC, each sequence judged by the others\n", file=out)
    print("| features | all | frames as they are | covered against on target | log loss |", file=out)
    print("|---|---|---|---|---|", file=out)
    areas = {}
    others = [name for name in table.features if name not in CHOSEN]
    for names in (CHOSEN, *((name,) for name in others), *((*CHOSEN, name) for name in others)):
        guess = table.left_out(names)
        area = [table.roc(guess, where).auc for where in (None, real, staged)]
        loss = log_loss(guess, table.is_held, table.weight)
        areas[" + ".join(names)] = [*area, loss]
        cells = " | ".join(f"{value:.3f}" for value in (*area, loss))
        print(f"| {' + '.join(names)} | {cells} |", file=out)

    print("\n| sequence | frames as they are | covered against on target |\n|---|---|---|", file=out)
    by_sequence = {}
    for index, name in enumerate(table.names):
        here = table.sequence == index
        pair = [table.roc(p, here & where).auc for where in (real, staged)]
        by_sequence[name] = pair
        print(f"| {name} | " + " | ".join("-" if math.isnan(area) else f"{area:.2f}" for area in pair) + " |", file=out)

    print(
        "\n| confidence | responses | on target | of frames as they are | on target |\n|---|---|---|---|---|", file=out
    )
    bins = [reliability(table, p, where) for where in (np.ones(len(p), bool), real)]
    for every, plain in zip(*bins, strict=True):
        cells = f"{every.rows} | {every.held:.2f} | {plain.rows} | {plain.held:.2f}"
        print(f"| {every.low:.1f} - {every.high:.1f} | {cells} |", file=out)
    return {
        "rows": len(p),
        "coefficients": dict(zip(("bias", *CHOSEN), chosen.tolist(), strict=True)),
        "auc_all_real_covered_log_loss": areas,
        "auc_real_covered_by_sequence": by_sequence,
        "reliability": [{"low": b.low, "rows": b.rows, "mean": b.mean, "held": b.held} for b in bins[0]],
    }


def save_plot(path: Path, table: Table) -> None:
    """ROC and reliability, each sequence judged by the others.

    Raises
    ------
    OutputError
        If the file cannot be written. What `check_plottable` refuses is not to be given.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra; without --plot nobody needs it

    p = table.left_out(CHOSEN)
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    curves = {
        "all": table.roc(p),
        "covered against on target": table.roc(p, table.is_covered | (table.is_staged & table.is_held)),
    }
    for index, name in enumerate(table.names):
        if name in SHOWN:
            curves[name] = table.roc(p, (table.sequence == index) & ~table.is_staged)
    for name, curve in curves.items():
        if math.isfinite(curve.auc):
            left.plot(curve.false_rate, curve.true_rate, lw=2 if name == "all" else 1, label=f"{name}: {curve.auc:.2f}")
    left.plot([0, 1], [0, 1], color="0.6", lw=0.8, ls="--")
    left.set(xlabel="wrong boxes kept", ylabel="right boxes kept", title="ROC and the area under it")
    left.legend(frameon=False, loc="lower right")
    for name, where in (("all", np.ones(len(p), bool)), ("frames as they are", ~table.is_staged)):
        bins = [b for b in reliability(table, p, where) if b.rows]
        right.plot([b.mean for b in bins], [b.held for b in bins], marker="o", ms=4, label=name)
    right.plot([0, 1], [0, 1], color="0.6", lw=0.8, ls="--")
    right.set(xlabel="confidence", ylabel="share on the target", title="reliability", xlim=(0, 1), ylim=(0, 1))
    right.legend(frameon=False, loc="upper left")
    for panel in (left, right):
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    try:
        figure.savefig(path, dpi=80)
    except (OSError, ValueError) as error:
        raise OutputError(f"{path} cannot be written: {error}") from error


def main(argv: Rows[str] | None = None) -> int:
    """Run the command line and return the exit status: 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(prog="python -m mscf.evaluation.calibration", description=__doc__)
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder of NAME/img/ and NAME/groundtruth.txt")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: %(default)s)")
    parser.add_argument("--plot", type=Path, metavar="OUT.png", help="ROC and reliability")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the figures there too")
    arguments = parser.parse_args(argv)
    try:
        if arguments.plot is not None:
            check_plottable(arguments.plot)
        for path in (arguments.plot, arguments.json):
            if path is not None:
                check_writable(path)
        sequences = read_dataset(arguments.dataset).sequences
        with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
            table = Table.of(list(pool.map(collect, sequences)))
        figures = report(table, sys.stdout)
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
        if arguments.plot is not None:
            save_plot(arguments.plot, table)
    except MscfError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return EXIT_USAGE
    return 0


if __name__ == "__main__":
    sys.exit(main())
