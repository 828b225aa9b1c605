"""Precision and success plots, as OTB and the papers after it draw them."""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mscf.arrays import Real64
from mscf.evaluation.metrics import ERROR_THRESHOLDS_PX, OVERLAP_THRESHOLDS, PRECISION_PX
from mscf.evaluation.report.palette import Stroke
from mscf.evaluation.report.summary import Row, Summary

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

SHORT_NAME = 26  # letters of a tracker's name that leave room for a second one beside it
INK = "#1d2126"  # of text and axes; the page puts its own in place of it
PAPER = "#ffffff"


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot as the two files that papers take."""

    name: str  # precision, success, or success of an attribute
    title: str
    png: bytes
    svg: str


@dataclass(frozen=True, slots=True)
class _Kind:
    """What the two sorts of plots differ in."""

    x: Real64
    xlabel: str
    ylabel: str
    curve: Callable[[Row], Real64]
    metric: str  # shown in the legend, and what it is ranked by


_PRECISION = _Kind(
    ERROR_THRESHOLDS_PX,
    "location error threshold (px)",
    "precision",
    lambda row: row.precision_curve,
    "precision",
)
_SUCCESS = _Kind(OVERLAP_THRESHOLDS, "overlap threshold", "success rate", lambda row: row.success_curve, "auc")


def draw_plots(summary: Summary, protocol: str) -> tuple[Plot, ...]:
    """The precision plot, the success plot, and the success plot of each attribute, in this order.

    Empty where no sequence counts. The same summary gives the same bytes.

    Parameters
    ----------
    protocol : stands in the titles; may be empty. What `check_plottable` refuses is not to be given.
    """
    if not summary.counted:
        return ()
    of = f" of {protocol.upper()}" if protocol else ""
    plots = [
        _plot("precision", f"Precision plot{of}", summary.rows, _PRECISION),
        _plot("success", f"Success plot{of}", summary.rows, _SUCCESS),
    ]
    for name, rows in summary.attributes.items():
        title = f"Success plot{of}: {name} ({len(summary.having[name])})"
        plots.append(_plot(f"success {name}", title, rows, _SUCCESS))
    return tuple(plots)


def ranked(rows: Sequence[Row], metric: str) -> list[int]:
    """Indices of `rows` from the best mean to the worst; those without one last."""

    def key(index: int) -> tuple[bool, float]:
        mean = rows[index].means[metric].mean
        return math.isnan(mean), -mean

    return sorted(range(len(rows)), key=key)


def _plot(name: str, title: str, rows: Sequence[Row], kind: _Kind) -> Plot:
    import matplotlib as mpl  # noqa: PLC0415 - an extra; without it there are tables
    from matplotlib.figure import Figure  # noqa: PLC0415

    settings: dict[Any, Any] = {
        "svg.fonttype": "none",  # text stays text, which is small and can be searched
        "svg.hashsalt": "mscf",  # names inside the file are the same each time
        "text.parse_math": False,  # a name is no formula
        **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color"), INK),
    }
    with mpl.rc_context(settings):
        columns = 2 if all(len(row.tracker) <= SHORT_NAME for row in rows) else 1
        height_in = 3.7 + 0.19 * math.ceil(len(rows) / columns)
        figure = Figure(figsize=(5.2, height_in), layout="constrained", facecolor=PAPER)
        axes = figure.subplots()
        axes.set_facecolor(PAPER)
        lines: list[Line2D] = []
        for rank, index in enumerate(ranked(rows, kind.metric)):
            row, stroke = rows[index], Stroke.of(index)
            lines += axes.plot(
                kind.x,
                kind.curve(row),
                color=stroke.color,
                ls=(0, stroke.dash) if stroke.dash else "-",
                lw=1.8,
                marker=stroke.marker,
                markevery=0.12,  # of the figure's diagonal
                ms=4.5,
                zorder=3 - rank / 100,  # the best on top
                label=f"[{row.means[kind.metric].mean:.3f}] {row.tracker}",
            )
        if kind is _PRECISION:
            axes.axvline(PRECISION_PX, color=INK, alpha=0.5, lw=0.8, ls=":")
        axes.set(xlabel=kind.xlabel, ylabel=kind.ylabel, xlim=(kind.x[0], kind.x[-1]), ylim=(0, 1.005))
        axes.set_yticks(np.linspace(0, 1, 6))
        axes.set_title(title, fontsize=10.5, loc="left")
        axes.grid(color=INK, alpha=0.15, lw=0.7)
        axes.spines[["top", "right"]].set_visible(False)
        # beneath the curves, which leave no corner free where trackers are many or good
        figure.legend(
            handles=lines, loc="outside lower center", ncols=columns, fontsize=8.5, handlelength=3.6, frameon=False
        )
        png, svg = io.BytesIO(), io.StringIO()
        figure.savefig(png, format="png", dpi=150)
        figure.savefig(svg, format="svg", metadata={"Date": None})
    return Plot(name, title, png.getvalue(), svg.getvalue())
