"""The plots of a run: its figures over one time axis, with the application's modes behind them."""

import itertools
import math
from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from mscf.arrays import Real64
from mscf.errors import OutputError
from sim.film import mode_color
from sim.scenarios import Act
from sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SMOOTHING_S = 0.3  # over which places are differenced into speeds: differences of neighbours are noise


def check_plottable() -> None:
    """Fail now rather than after a long run.

    Raises
    ------
    OutputError
        If Matplotlib is not installed.
    """
    try:
        import matplotlib as mpl  # noqa: F401, PLC0415 - an extra
    except ImportError as error:
        raise OutputError("a plot needs Matplotlib: pip install matplotlib, or '.[plots]' in the clone") from error


def mode_hex(mode: str) -> str:
    """Colour of a mode, as in the film."""
    blue, green, red = mode_color(mode)
    return f"#{red:02x}{green:02x}{blue:02x}"


def mode_spans(trace: Trace) -> tuple[tuple[str, float, float], ...]:
    """Mode, begin and end in s of every stay in a mode; each ends where the next begins."""
    starts = [
        (mode, next(group).time_s) for mode, group in itertools.groupby(trace.moments, key=lambda moment: moment.mode)
    ]
    ends = [start_s for _, start_s in starts[1:]] + [moment.time_s for moment in trace.moments[-1:]]
    return tuple((mode, start_s, end_s) for (mode, start_s), end_s in zip(starts, ends, strict=True))


def plot_png(title: str, trace: Trace, acts: Sequence[Act] = ()) -> bytes:
    """Plots of a run as a PNG file; what is None or not finite in a moment leaves a gap.

    Raises
    ------
    OutputError
        If Matplotlib is not installed.
    """
    check_plottable()
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    from matplotlib.patches import Patch  # noqa: PLC0415

    figure = Figure(figsize=(10, 12), layout="constrained")
    panels = figure.subplots(6, 1, sharex=True)
    _draw(panels, trace)
    spans = mode_spans(trace)
    for panel in panels:
        for mode, start_s, end_s in spans:
            panel.axvspan(start_s, end_s, color=mode_hex(mode), alpha=0.22, lw=0)
        for act in acts:
            panel.axvline(act.time_s, color="0.2", lw=0.9, ls="--")
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, fontsize=8, frameon=False, borderpad=0)
    for act in acts:
        place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        panels[0].annotate(act.name, (act.time_s, 1.0), xytext=(3, -4), va="top", rotation=90, fontsize=8, **place)
    if trace.moments:
        panels[-1].set_xlim(trace.moments[0].time_s, max(trace.moments[-1].time_s, trace.moments[0].time_s + 1e-3))
    panels[-1].set(xlabel="time (s)")
    shown = dict.fromkeys(mode for mode, _, _ in spans)
    handles = [Patch(color=mode_hex(mode), alpha=0.5, label=mode or "unknown") for mode in shown]
    figure.suptitle(title, x=0.01, ha="left")
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, title="mode")
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _draw(panels: "Sequence[Axes]", trace: Trace) -> None:
    moments = trace.moments
    time_s = np.array([m.time_s for m in moments])
    bearing, ranges, speeds, yaw_rate, confidence, age = panels
    bearing.axhline(0.0, color="0.5", lw=0.8)
    bearing.plot(time_s, np.degrees([m.bearing_error_rad for m in moments]), color="tab:blue", lw=1.3)
    bearing.set(ylabel="bearing\nerror (deg)", ylim=_at_least(bearing.get_ylim(), 2.0))

    ranges.plot(time_s, [m.true_range_m for m in moments], color="k", lw=1.3, label="true")
    ranges.plot(time_s, _known([m.range_m for m in moments]), color="tab:orange", lw=1.3, label="estimated")
    ranges.set(ylabel="range (m)", ylim=(0, None))

    target_ne_m = np.array([m.target_ned_m[:2] for m in moments]).reshape(-1, 2)
    target_mps = np.hypot(*(rates(time_s, column) for column in target_ne_m.T))
    setpoints = [math.hypot(*m.setpoint_ned_mps[:2]) if m.setpoint_ned_mps else None for m in moments]
    speeds.plot(time_s, target_mps, color="tab:red", lw=1.1, label="target")
    speeds.plot(time_s, _known(setpoints), color="tab:purple", lw=1.1, label="setpoint")
    speeds.plot(time_s, [m.speed_mps for m in moments], color="k", lw=1.3, label="vehicle")
    speeds.set(ylabel="horizontal\nspeed (m/s)", ylim=(0, None))

    yaw_radps = rates(time_s, np.array([m.pose.yaw_rad for m in moments], float), turn=math.tau)
    yaw_rate.axhline(0.0, color="0.5", lw=0.8)
    set_radps = np.degrees(_known([m.yaw_rate_radps for m in moments]))
    yaw_rate.plot(time_s, set_radps, color="tab:purple", lw=1.1, label="setpoint")
    yaw_rate.plot(time_s, np.degrees(yaw_radps), color="k", lw=1.3, label="vehicle")
    yaw_rate.set(ylabel="yaw rate\n(deg/s)", ylim=_at_least(yaw_rate.get_ylim(), 2.0))

    confidence.plot(time_s, [m.confidence for m in moments], color="tab:green", lw=1.3, label="confidence")
    confidence.plot(time_s, [m.threat for m in moments], color="tab:red", lw=1.1, label="threat")
    seen = [m.visible_share for m in moments]
    confidence.plot(time_s, seen, color="0.35", lw=1.0, ls=":", label="truly visible share")
    confidence.set(ylabel="confidence,\nthreat", ylim=(0, 1.05))

    age.plot(time_s, 1000 * _known([m.frame_age_s for m in moments]), "o", color="tab:blue", ms=1.5)
    age.set(ylabel="latency: age of the\nnewest frame (ms)", ylim=(0, None))


def rates(time_s: Real64, values: Real64, *, turn: float | None = None) -> Real64:
    """Change per second of `values` (N,), over `SMOOTHING_S` around each time; NaN where one is not known.

    Parameters
    ----------
    turn : after which values are the same again, as angles are.
    """
    early = np.searchsorted(time_s, time_s - SMOOTHING_S / 2 - 1e-9)
    late = np.maximum(np.searchsorted(time_s, time_s + SMOOTHING_S / 2 + 1e-9) - 1, 0)
    change = values[late] - values[early]
    if turn is not None:
        change = np.remainder(change + turn / 2, turn) - turn / 2
    span_s = time_s[late] - time_s[early]
    return np.asarray(np.divide(change, span_s, out=np.full(len(change), math.nan), where=span_s > 0))


def _known(values: Sequence[float | None]) -> Real64:
    return np.array([math.nan if value is None else value for value in values], float)


def _at_least(limits: tuple[float, float], wide: float) -> tuple[float, float]:
    """Limits of an axis that do not make a mountain of a thousandth."""
    return min(limits[0], -wide), max(limits[1], wide)
