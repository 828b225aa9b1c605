"""Command `mscf-companion report`: the page and the plots of a recorded flight, as of a run in the simulator.

Nobody knows the truth of a real flight: where the vehicle was is what the autopilot reported, the range is what
the application estimated, and nothing is judged.
"""

import argparse
import math
import shlex
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from companion.errors import UsageError
from companion.flight_record import VIDEO, Gap, RecordedStep, read_about, read_control
from companion.types import AutopilotText
from companion.vehicle_state import VehicleState
from mscf.arrays import Real64
from mscf.errors import OutputError
from mscf.whole_file import write_whole
from sim.figure import check_plottable, mode_hex, mode_spans, rates
from sim.report import FILM, PAGE, PLOTS, POSTER, VERDICT, Run, write_page
from sim.scenarios import Act
from sim.trace import Moment, Trace
from sim.world import Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNKNOWN = (math.nan, math.nan, math.nan)


def add_command(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add `report` to the commands of `mscf-companion`."""
    report = commands.add_parser(
        "report",
        help="make a page of a recorded flight",
        description="Make a page with plots and the film of a recorded flight.",
    )
    report.add_argument("folder", type=Path, metavar="DIR", help="the folder of the flight record")
    report.add_argument("--out", type=Path, metavar="DIR", help="for the page (default: beside the record)")
    report.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    words = ["--out", str(arguments.out)] if arguments.out is not None else []
    command = shlex.join(["mscf-companion", "report", str(arguments.folder), *words])
    out = arguments.folder if arguments.out is None else arguments.out
    write_report(arguments.folder, out, command)
    print(f"page      {out / PAGE}")
    return 0


def write_report(folder: Path, out: Path, command: str) -> None:
    """Write page, plots and trace of a record, and a copy of its film where `out` is another folder.

    Raises
    ------
    UsageError
        If the folder holds no record, or one without a step, or `out` the report of a run in the simulator.
    OutputError
        If a file cannot be written, or Matplotlib is not installed.
    """
    check_plottable()
    run = run_of(folder, command)
    if (out / VERDICT).exists():
        raise UsageError(f"{out} holds the report of a run in the simulator: give another folder with --out")
    write_whole(out / PLOTS, plot_png(run))
    try:
        if out.resolve() != folder.resolve():
            for name in (FILM, POSTER):  # of another flight, maybe
                (out / name).unlink(missing_ok=True)
            if (folder / VIDEO).is_file():
                shutil.copyfile(folder / VIDEO, out / FILM)
    except OSError as error:
        raise OutputError(f"{out / FILM} cannot be written: {error.strerror}; give another folder") from error
    write_page(run, out)


def run_of(folder: Path, command: str) -> Run:
    """A recorded flight as a run without a verdict.

    Raises
    ------
    UsageError
        If the folder holds no record, or one without a step.
    """
    about = read_about(folder)
    moments: list[Moment] = []
    acts: list[Act] = []
    vehicle, start_s, missing = VehicleState(), math.nan, 0
    for entry in read_control(folder):
        time_s = moments[-1].time_s if moments else 0.0
        if isinstance(entry, RecordedStep):
            start_s = start_s if moments else entry.inputs.now_s
            for event in entry.inputs.events:
                vehicle = vehicle.after(event)
            moments.append(moment_of(entry, vehicle, start_s))
        elif isinstance(entry, Gap):
            missing += entry.count
            acts.append(Act(time_s, f"{entry.count} steps not recorded", _nothing))
        else:
            acts.append(Act(time_s, "application ended", _nothing))
    if not moments:
        raise UsageError(f"{folder} holds no step of a flight: there is nothing to show")
    heartbeat = vehicle.heartbeat
    return Run(
        scenario=f"flight of {str(about.get('start_utc', 'an unknown time'))[:19].replace('T', ' ')}",
        description="a recorded flight",
        autopilot=heartbeat.autopilot.value if heartbeat is not None else "no autopilot heard",
        kind="recorded",
        command=command,
        seed=None,
        trace=Trace(tuple(moments)),
        verdicts=(),
        acts=tuple(acts),
        facts={"steps": len(moments), "steps_missing": missing}
        | {name: str(value) for name, value in about.items() if name != "record"},
    )


def _nothing(_desk: object) -> None:
    """What happened is over."""


def moment_of(step: RecordedStep, vehicle: VehicleState, start_s: float) -> Moment:
    """A step with what was known of the vehicle after it; NaN or None is what was not, or cannot be.

    Parameters
    ----------
    start_s : of the flight, on the clock of the record.
    """
    inputs, output, sample = step.inputs, step.output, step.inputs.track
    attitude, local, heartbeat = vehicle.attitude, vehicle.local, vehicle.heartbeat
    angles = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) if attitude is not None else _UNKNOWN
    setpoint, target = output.get("setpoint"), output.get("target")
    fix = target.get("fix") if target is not None else None
    said = (f"autopilot: {event.text}" for event in inputs.events if isinstance(event, AutopilotText))
    return Moment(
        time_s=inputs.now_s - start_s,
        mode=output["mode"]["name"].lower(),
        flight_mode=heartbeat.mode_name if heartbeat is not None else "",
        is_armed=heartbeat is not None and heartbeat.is_armed,
        pose=Pose(local.pos_ned_m if local is not None else _UNKNOWN, *angles),
        velocity_ned_mps=local.velocity_ned_mps if local is not None else _UNKNOWN,
        target_ned_m=_UNKNOWN,
        box=sample.box if sample is not None else None,
        truth=None,
        visible_share=math.nan,
        status=sample.status.name.lower() if sample is not None and sample.status is not None else "none",
        confidence=sample.confidence if sample is not None else math.nan,
        threat=sample.threat if sample is not None else math.nan,
        frame_age_s=inputs.now_s - sample.captured_s if sample is not None else None,
        setpoint_ned_mps=tuple(setpoint["velocity_ned_mps"]) if setpoint is not None else None,
        yaw_rate_radps=setpoint["yaw_rate_radps"] if setpoint is not None else None,
        range_m=fix["range_m"] if fix is not None else None,
        notes=tuple(output["notes"]),
        texts=(*step.texts, *said),
    )


# ------------------------------------------------------------------------------------------------ plots
@dataclass(frozen=True, slots=True)
class _Panel:
    """A plot over time: its label, its lines by name, and how far its axis reaches at least."""

    label: str
    lines: dict[str, Real64]  # (N,), NaN where it is not known
    reach: tuple[float, float]


def plot_png(run: Run) -> bytes:
    """Plots of a recorded flight as a PNG file: as many as something is known for.

    Raises
    ------
    OutputError
        If Matplotlib is not installed.
    """
    check_plottable()
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    from matplotlib.patches import Patch  # noqa: PLC0415

    time_s = np.array([moment.time_s for moment in run.trace.moments])
    panels = [panel for panel in _panels(run.trace) if any(np.isfinite(line).any() for line in panel.lines.values())]
    spans = mode_spans(run.trace)
    figure = Figure(figsize=(10, 1.0 + 1.9 * max(len(panels), 1)), layout="constrained")
    all_axes: Sequence[Axes] = list(figure.subplots(max(len(panels), 1), 1, sharex=True, squeeze=False)[:, 0])
    for panel, axes in zip(panels, all_axes, strict=False):
        for (name, values), color in zip(panel.lines.items(), ("k", "tab:purple", "tab:red"), strict=False):
            if np.isfinite(values).any():
                axes.plot(time_s, values, color=color, lw=1.2, label=name)
        low, high = axes.get_ylim()
        axes.set(ylabel=panel.label, ylim=(min(low, panel.reach[0]), max(high, panel.reach[1])))
        axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, fontsize=8, frameon=False, borderpad=0)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in all_axes:
        for mode, begin_s, end_s in spans:
            axes.axvspan(begin_s, end_s, color=mode_hex(mode), alpha=0.22, lw=0)
        for act in run.acts:
            axes.axvline(act.time_s, color="0.2", lw=0.9, ls="--")
    all_axes[-1].set(xlabel="time (s)", xlim=(time_s[0], max(time_s[-1], time_s[0] + 1e-3)))
    figure.suptitle(f"{run.scenario}, {run.autopilot}", x=0.01, ha="left")
    handles = [Patch(color=mode_hex(mode), alpha=0.5, label=mode) for mode in dict.fromkeys(s[0] for s in spans)]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, title="mode")
    file = BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _panels(trace: Trace) -> tuple[_Panel, ...]:
    moments = trace.moments
    time_s = np.array([moment.time_s for moment in moments])

    def known(value_of: Callable[[Moment], float | None]) -> Real64:
        return np.array([math.nan if (v := value_of(moment)) is None else v for moment in moments], float)

    def speed_mps(moment: Moment) -> float | None:
        return math.hypot(*moment.setpoint_ned_mps[:2]) if moment.setpoint_ned_mps is not None else None

    turning = np.degrees(rates(time_s, known(lambda m: m.pose.yaw_rad), turn=math.tau))
    told = np.degrees(known(lambda m: m.yaw_rate_radps))
    return (
        _Panel("range (m)", {"estimated": known(lambda m: m.range_m)}, (0.0, 1.0)),
        _Panel("height in the\nlocal frame (m)", {"vehicle": known(lambda m: m.height_m)}, (0.0, 1.0)),
        _Panel(
            "horizontal\nspeed (m/s)",
            {"vehicle": known(lambda m: m.speed_mps), "setpoint": known(speed_mps)},
            (0.0, 1.0),
        ),
        _Panel("yaw rate\n(deg/s)", {"vehicle": turning, "setpoint": told}, (-2.0, 2.0)),
        _Panel(
            "confidence,\nthreat",
            {"confidence": known(lambda m: m.confidence), "threat": known(lambda m: m.threat)},
            (0.0, 1.05),
        ),
        _Panel("latency: age of the\nnewest frame (ms)", {"age": 1000 * known(lambda m: m.frame_age_s)}, (0.0, 10.0)),
    )
