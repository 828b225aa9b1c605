"""The plots of a run: its figures over one time axis, with the application's modes behind them."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from mscf.arrays import Real64
from mscf.errors import OutputError
from sim.film import mode_color
from sim.scenarios import Act
from sim.trace import Moment, Trace

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


@dataclass(frozen=True, slots=True)
class _Line:
    """A figure over time; without a name, it needs no legend."""

    name: str
    values: Real64  # (N,), NaN where it is not known
    color: str
    width: float = 1.3
    style: str = "-"

    @property
    def is_known(self) -> bool:
        return bool(np.isfinite(self.values).any())


@dataclass(frozen=True, slots=True)
class _Panel:
    """A plot over time: its label, its lines, and how far its axis reaches at least."""

    label: str
    lines: tuple[_Line, ...]
    reach: tuple[float, float]  # so that it makes no mountain of a thousandth
    is_bounded: bool = True  # nothing lies below its reach

    @property
    def is_known(self) -> bool:
        return any(line.is_known for line in self.lines)


def plot_png(title: str, trace: Trace, acts: Sequence[Act] = (), *, has_truth: bool = True) -> bytes:
    """Plots of a run as a PNG file; what is None or not finite in a moment leaves a gap.

    Parameters
    ----------
    has_truth : whether it was flown in the simulator. Of a recorded flight, which has none, there are only the panels
        of which something is known, and its acts are not named: it may miss steps every second.

    Raises
    ------
    OutputError
        If Matplotlib is not installed.
    """
    check_plottable()
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    from matplotlib.patches import Patch  # noqa: PLC0415

    time_s = np.array([moment.time_s for moment in trace.moments])
    panels = _panels(trace, time_s, has_truth=has_truth)
    count = max(len(panels), 1)
    figure = Figure(figsize=(10, (6 + 19 * count) / 10), layout="constrained")
    all_axes: list[Axes] = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    spans = mode_spans(trace)
    for axes, panel in zip(all_axes, panels, strict=False):  # an empty one where there is no panel
        _draw(axes, time_s, panel)
    for axes in all_axes:
        for mode, start_s, end_s in spans:
            axes.axvspan(start_s, end_s, color=mode_hex(mode), alpha=0.22, lw=0)
        for act in acts:
            axes.axvline(act.time_s, color="0.2", lw=0.9, ls="--")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, fontsize=8, frameon=False, borderpad=0)
    for act in acts if has_truth else ():
        all_axes[0].annotate(
            act.name,
            (act.time_s, 1.0),
            xytext=(3, -4),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            va="top",
            rotation=90,
            fontsize=8,
        )
    if trace.moments:
        all_axes[-1].set_xlim(time_s[0], max(time_s[-1], time_s[0] + 1e-3))
    all_axes[-1].set(xlabel="time (s)")
    shown = dict.fromkeys(mode for mode, _, _ in spans)
    handles = [Patch(color=mode_hex(mode), alpha=0.5, label=mode or "unknown") for mode in shown]
    figure.suptitle(title, x=0.01, ha="left")
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, title="mode")
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _draw(axes: "Axes", time_s: Real64, panel: _Panel) -> None:
    if panel.reach[0] < 0:
        axes.axhline(0.0, color="0.5", lw=0.8)
    for line in panel.lines:
        if line.is_known:
            axes.plot(time_s, line.values, line.style, color=line.color, lw=line.width, ms=1.5, label=line.name)
    low, high = axes.get_ylim()
    low = panel.reach[0] if panel.is_bounded else min(low, panel.reach[0])
    axes.set(ylabel=panel.label, ylim=(low, max(high, panel.reach[1])))


def _panels(trace: Trace, time_s: Real64, *, has_truth: bool) -> tuple[_Panel, ...]:
    """Those of a run, from top to bottom."""

    def known(value_of: Callable[[Moment], float | None]) -> Real64:
        return np.array([math.nan if (v := value_of(moment)) is None else v for moment in trace.moments], float)

    def setpoint_mps(moment: Moment) -> float | None:
        return math.hypot(*moment.setpoint_ned_mps[:2]) if moment.setpoint_ned_mps is not None else None

    target_mps = np.hypot(
        rates(time_s, known(lambda m: m.target_ned_m[0])), rates(time_s, known(lambda m: m.target_ned_m[1]))
    )
    yaw_radps = rates(time_s, known(lambda m: m.pose.yaw_rad), turn=math.tau)
    height = _Panel(
        "height in the\nlocal frame (m)",
        (_Line("vehicle", known(lambda m: m.height_m), "k"),),
        (0.0, 1.0),
        is_bounded=False,
    )
    panels = (
        _Panel(
            "bearing\nerror (deg)",
            (_Line("", np.degrees(known(lambda m: m.bearing_error_rad)), "tab:blue"),),
            (-2.0, 2.0),
            is_bounded=False,
        ),
        _Panel(
            "range (m)",
            (
                _Line("true", known(lambda m: m.true_range_m), "k"),
                _Line("estimated", known(lambda m: m.range_m), "tab:orange"),
            ),
            (0.0, 1.0),
        ),
        *(() if has_truth else (height,)),
        _Panel(
            "horizontal\nspeed (m/s)",
            (
                _Line("target", target_mps, "tab:red", 1.1),
                _Line("setpoint", known(setpoint_mps), "tab:purple", 1.1),
                _Line("vehicle", known(lambda m: m.speed_mps), "k"),
            ),
            (0.0, 1.0),
        ),
        _Panel(
            "yaw rate\n(deg/s)",
            (
                _Line("setpoint", np.degrees(known(lambda m: m.yaw_rate_radps)), "tab:purple", 1.1),
                _Line("vehicle", np.degrees(yaw_radps), "k"),
            ),
            (-2.0, 2.0),
            is_bounded=False,
        ),
        _Panel(
            "confidence,\nthreat",
            (
                _Line("confidence", known(lambda m: m.confidence), "tab:green"),
                _Line("threat", known(lambda m: m.threat), "tab:red", 1.1),
                _Line("truly visible share", known(lambda m: m.visible_share), "0.35", 1.0, ":"),
            ),
            (0.0, 1.05),
        ),
        _Panel(
            "latency: age of the\nnewest frame (ms)",
            (_Line("", 1000 * known(lambda m: m.frame_age_s), "tab:blue", style="o"),),
            (0.0, 10.0),
        ),
    )
    return tuple(panel for panel in panels if has_truth or panel.is_known)


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
