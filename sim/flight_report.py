"""Command `mscf-companion report`: the page and the plots of a recorded flight, as of a run in the simulator.

Nobody knows the truth of a real flight: where the vehicle was is what the autopilot reported, the range is what
the application estimated, and nothing is judged.
"""

import argparse
import math
import shlex
import shutil
from pathlib import Path
from typing import Any

from companion.errors import UsageError
from companion.flight_record import ABOUT, VIDEO, Gap, RecordedStep, read_about, read_control
from companion.types import AutopilotText
from companion.vehicle_state import VehicleState
from mscf.errors import OutputError
from sim.figure import check_plottable
from sim.report import FILM, PAGE, POSTER, VERDICT, Run, write_page
from sim.scenarios import Act
from sim.trace import Moment, Trace
from sim.world import Pose

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
    is_elsewhere = out.resolve() != folder.resolve()
    has_own = (out / ABOUT).exists() or ((out / FILM).exists() and not (out / PAGE).exists())
    if is_elsewhere and has_own:
        raise UsageError(f"{out} holds another flight, or a film of yours: give another folder with --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        if is_elsewhere:
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
    vehicle, start_s, missing, is_whole = VehicleState(), math.nan, 0, False
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
            is_whole = True
            acts.append(Act(time_s, "application ended", _nothing))
    if not is_whole and moments:
        acts.append(Act(moments[-1].time_s, "the record breaks off", _nothing))
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
