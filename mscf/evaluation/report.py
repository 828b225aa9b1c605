"""Results of runs as a table."""

from collections.abc import Sequence
from statistics import fmean
from typing import TextIO

from mscf.evaluation.protocol import Run


def print_table(runs: Sequence[Run], names: Sequence[str], protocol: str, out: TextIO) -> None:
    """Precision / AUC by sequence and tracker as Markdown: mean over runs, then over sequences."""
    sequences = sorted({run.sequence for run in runs})
    count = len({(run.sequence, run.start) for run in runs})
    print(
        f"precision at 20 px / AUC, protocol {protocol}, {count} runs a tracker over {len(sequences)} sequences\n",
        file=out,
    )
    print("| sequence | " + " | ".join(names) + " |", file=out)
    print("|---|" + "---|" * len(names), file=out)
    means: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for sequence in sequences:
        cells = []
        for name in names:
            scores = [run.score for run in runs if run.sequence == sequence and run.tracker == name]
            precision, auc = fmean(s.precision for s in scores), fmean(s.auc for s in scores)
            means[name].append((precision, auc))
            cells.append(f"{precision:.3f} / {auc:.3f}")
        print(f"| {sequence} | " + " | ".join(cells) + " |", file=out)
    cells = [f"**{fmean(p for p, _ in means[name]):.3f} / {fmean(a for _, a in means[name]):.3f}**" for name in names]
    print("| mean | " + " | ".join(cells) + " |", file=out)
    by_name = [[ms for run in runs if run.tracker == name for ms in run.update_ms] for name in names]
    print("| updates/s | " + " | ".join(f"{1e3 / fmean(ms):.0f}" if ms else "-" for ms in by_name) + " |", file=out)
