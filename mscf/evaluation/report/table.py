"""Results as tables: Markdown and terminal for people, CSV and JSON for programs."""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TextIO

from mscf.evaluation.record import Record
from mscf.evaluation.report.summary import METRICS, Row, Summary, places, summarize
from mscf.evaluation.statistics import Interval

MARKS = ("", "¹", "²", "³")  # beside the best three of a column
HOW = (
    "Means over the runs of a sequence, then over sequences; in brackets the bootstrap 95 % interval over sequences. "
    "¹ ² ³: the best three, which says nothing of whether they really differ."
)
CSV_HEAD = ("sequence", "tracker", "attributes", "counted", "runs", "updates", "lost", "raised", *METRICS, "update_ms")


def print_table(records: Sequence[Record], order: Sequence[str], out: TextIO) -> None:
    """Print the overall table of the trackers in `order`, as Markdown."""
    summary = summarize(records, order)
    print("\n".join([*overall(summary), "", *remarks(summary)]), file=out)


def markdown(summary: Summary, title: str, skipped: Sequence[tuple[str, str]]) -> str:
    """All tables: overall, by attribute, by sequence, what was raised, what was skipped."""
    lines = [f"# {title}", "", *overall(summary), "", HOW, "", *remarks(summary)]
    if summary.attributes:
        lines += ["", "## AUC by attribute", "", *_by_attribute(summary)]
    lines += ["", "## Precision / AUC by sequence", "", *_by_sequence(summary)]
    raised = [(row.tracker, fault, runs) for row in summary.rows for fault, runs in row.faults.items()]
    if raised:
        lines += ["", "## Raised", "", *_grid(("tracker", "what", "runs"), [[n, f, str(r)] for n, f, r in raised])]
    if skipped:
        lines += ["", "## Skipped", "", *_grid(("sequence", "why"), skipped)]
    return "\n".join(lines).rstrip() + "\n"


def overall(summary: Summary) -> list[str]:
    """The overall table, one line of Markdown each."""
    columns = [
        [marked(interval_text(mean), place) for mean, place in zip(means, _places(means), strict=True)]
        for means in ([row.means[name] for row in summary.rows] for name in METRICS)
    ]
    speeds = places([row.updates_per_s for row in summary.rows])
    columns.append([marked(rate_text(row), place) for row, place in zip(summary.rows, speeds, strict=True)])
    columns.append([share_text(row.lost, row.updates) for row in summary.rows])
    columns.append([str(sum(row.faults.values())) for row in summary.rows])
    head = ("tracker", *METRICS.values(), "updates/s", "lost", "runs that raised")
    names = [row.tracker for row in summary.rows]
    return _grid(head, list(zip(names, *columns, strict=True)))


def remarks(summary: Summary) -> list[str]:
    """What a reader must know to read the means, a sentence a line."""
    runs = sum(row.runs for row in summary.rows)
    lines = [
        f"{counted(len(summary.counted), 'sequence')}, {counted(runs, 'run')} of {len(summary.trackers)} trackers."
    ]
    rest = [name for name in summary.sequences if name not in summary.counted]
    if rest:
        lines.append(f"Not counted, as not every tracker has run them from the same starts: {', '.join(rest)}.")
    if summary.missing:
        lines.append(f"Without any result: {', '.join(summary.missing)}.")
    return lines


def interval_text(interval: Interval) -> str:
    """Mean and interval; of one sequence the mean alone, of none "-"."""
    if math.isnan(interval.mean):
        return "-"
    return f"{interval.mean:.3f} {spread_text(interval)}".rstrip()


def spread_text(interval: Interval) -> str:
    """Interval in brackets; empty where there is none."""
    return "" if math.isnan(interval.low) else f"[{interval.low:.3f}, {interval.high:.3f}]"


def rate_text(row: Row) -> str:
    """Updates a second."""
    return "-" if math.isnan(row.updates_per_s) else f"{row.updates_per_s:.{0 if row.updates_per_s >= 10 else 1}f}"


def share_text(part: int, total: int) -> str:
    """Of all updates, in per cent."""
    return f"{100 * part / total:.1f} %" if total else "-"


def marked(text: str, place: int) -> str:
    """A figure with the mark of its place."""
    return f"{text} {MARKS[place]}".rstrip()


def sequences_csv(summary: Summary) -> str:
    """One row a sequence and tracker: means over the runs, `update_ms` over all updates; empty where not known."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_HEAD)
    for sequence, row in summary.cells.items():
        for tracker in summary.trackers:
            if tracker not in row:
                continue
            cell = row[tracker]
            scores = [getattr(cell.score, name) for name in METRICS]
            update_ms = math.fsum(cell.update_ms) / len(cell.update_ms) if cell.update_ms else math.nan
            counts = (len(cell.starts), cell.updates, cell.lost, len(cell.faults))
            words = (sequence, tracker, " ".join(sorted(cell.attributes)), int(sequence in summary.counted))
            writer.writerow(
                ["" if _finite(value) is None else value for value in (*words, *counts, *scores, update_ms)]
            )
    return file.getvalue()


def results_json(summary: Summary, circumstances: Mapping[str, Any], skipped: Sequence[tuple[str, str]]) -> str:
    """Everything of the page as one value; what is not known is null."""
    content = {
        "evaluation": circumstances or None,
        "sequences": list(summary.counted),
        "not_counted": [name for name in summary.sequences if name not in summary.counted],
        "skipped": [{"sequence": name, "why": why} for name, why in skipped],
        "trackers": [_row_value(row) for row in summary.rows],
        "attributes": {
            name: {"sequences": list(summary.having[name]), "trackers": [_row_value(row) for row in rows]}
            for name, rows in summary.attributes.items()
        },
        "by_sequence": {
            sequence: {name: {**asdict(cell.score), "lost": cell.lost} for name, cell in row.items()}
            for sequence, row in summary.cells.items()
        },
    }
    return json.dumps(_finite(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _row_value(row: Row) -> dict[str, Any]:
    return {
        "tracker": row.tracker,
        **{name: asdict(row.means[name]) for name in METRICS},
        "updates_per_s": row.updates_per_s,
        "runs": row.runs,
        "updates": row.updates,
        "lost": row.lost,
        "faults": dict(row.faults),
        "precision_curve": row.precision_curve.tolist(),
        "success_curve": row.success_curve.tolist(),
    }


def _by_attribute(summary: Summary) -> list[str]:
    lines = []
    for name, rows in summary.attributes.items():
        means = [row.means["auc"] for row in rows]
        cells = [marked(interval_text(mean), place) for mean, place in zip(means, _places(means), strict=True)]
        lines.append((name, str(len(summary.having[name])), *cells))
    return _grid(("attribute", "sequences", *summary.trackers), lines)


def _by_sequence(summary: Summary) -> list[str]:
    lines = []
    for sequence, row in summary.cells.items():
        scores = [row[name].score if name in row else None for name in summary.trackers]
        ranks = places([math.nan if score is None else score.auc for score in scores])
        cells = [
            "-" if score is None or math.isnan(score.auc) else marked(f"{score.precision:.3f} / {score.auc:.3f}", rank)
            for score, rank in zip(scores, ranks, strict=True)
        ]
        lines.append((sequence, *cells))
    return _grid(("sequence", *summary.trackers), lines)


def _places(means: Sequence[Interval]) -> tuple[int, ...]:
    return places([mean.mean for mean in means])


def _grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Markdown that is also aligned for those who read it as text."""
    cells = [[text.replace("|", "\\|").replace("\n", " ") for text in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [f"| {' | '.join(text.ljust(w) for text, w in zip(row, widths, strict=True))} |" for row in cells]
    return [lines[0], f"|{'|'.join('-' * (w + 2) for w in widths)}|", *lines[1:]]


def counted(number: int, noun: str) -> str:
    """A number of things."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _finite(value: Any) -> Any:
    """A value with None for each float that is not finite."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
