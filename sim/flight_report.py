"""Command `mscf-companion report`: the page and the plots of a recorded flight, as of a run in the simulator.

Nobody knows the truth of a real flight: where the vehicle was is what the autopilot reported, the range is what
the application estimated, and nothing is judged.
"""

import argparse
import math
import shlex
import shutil
import sys
from functools import reduce
from pathlib import Path
from typing import Any

from companion.errors import UsageError
from companion.flight_folders import about_of
from companion.flight_record import (
    ABOUT,
    VIDEO,
    Damage,
    Entry,
    Farewell,
    Gap,
    RecordedFailure,
    RecordedStep,
    decoded,
    misfit,
    read_control,
    time_of,
)
from companion.modes import Mode
from companion.types import AutopilotText
from companion.vehicle_state import VehicleState
from mscf.errors import OutputError
from sim.figure import check_plottable
from sim.report import FILM, PAGE, POSTER, VERDICT, Run, write_page
from sim.scenarios import Act
from sim.trace import Moment, Trace
from sim.world import Pose

_ENDED = "application ended"
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
    run = write_report(arguments.folder, out, command)
    if "damage" in run.facts:
        print(f"mscf-companion: {run.facts['damage']}", file=sys.stderr)
    print(f"page      {out / PAGE}")
    return 0


def write_report(folder: Path, out: Path, command: str) -> Run:
    """Write page, plots and trace of a record, and a copy of its film where `out` is another folder.

    Returns
    -------
    What was written of.

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
    return run


def run_of(folder: Path, command: str) -> Run:
    """A recorded flight as a run without a verdict; lines that are damaged are left out, and counted.

    Raises
    ------
    UsageError
        If the folder holds no record, or one without a step that can be read.
    """
    about = about_of(folder)
    moments: list[Moment] = []
    acts: list[Act] = []
    damages: list[Damage] = []
    last_words: tuple[tuple[float, str], ...] = ()
    vehicle, start_s, missing = VehicleState(), math.nan, 0
    for number, recorded in enumerate(read_control(folder), start=1):
        now_s = time_of(recorded)
        start_s = now_s if now_s is not None and math.isnan(start_s) else start_s
        if isinstance(recorded, RecordedStep):
            vehicle = reduce(VehicleState.after, recorded.inputs.events, vehicle)
        entry = _seen(recorded, vehicle, start_s, f"{folder}, line {number}")
        time_s = now_s - start_s if now_s is not None else moments[-1].time_s if moments else 0.0
        match entry:
            case Moment():
                moments.append(entry)
                continue
            case Damage():
                damages.append(entry)
                if len(damages) > 1:  # said once: half the lines may be so
                    continue
            case Farewell():
                last_words = tuple((time_s, text) for text in entry.texts)
            case Gap():
                missing += entry.count
        acts.append(Act(time_s, _name(entry), _nothing))
    if not moments:
        why = damages[0].text if damages else "; ".join(act.name for act in acts) or "it is empty"
        raise UsageError(f"{folder} holds no step of a flight, there is nothing to show: {why}")
    if not any(act.name == _ENDED for act in acts):
        acts.append(Act(moments[-1].time_s, "the record breaks off", _nothing))
    facts: dict[str, str | float | None] = {"steps": len(moments), "steps_missing": missing}
    if damages:
        facts["damage"] = f"lines left out: {len(damages)}, the first: {damages[0].text}"
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
        facts=facts | {name: str(value) for name, value in about.items() if name not in {"record", "damage", *facts}},
        last_words=last_words,
    )


def _seen(
    entry: Entry, vehicle: VehicleState, start_s: float, place: str
) -> Moment | RecordedFailure | Gap | Farewell | Damage:
    """What is shown of an entry: a step becomes a moment, or is damaged where its output is none of ours."""
    if not isinstance(entry, RecordedStep):
        return entry
    try:
        return moment_of(entry, vehicle, start_s)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        return Damage(f"{place} is damaged, or of another version: {type(error).__name__}: {error}")


def _name(entry: RecordedFailure | Gap | Farewell | Damage) -> str:
    """What happened there, in a few words."""
    match entry:
        case RecordedFailure():
            return f"the controller raised {entry.raised}"
        case Gap():
            return f"{entry.count} steps not recorded"
        case Farewell():
            return _ENDED
        case Damage():
            return "the record is damaged: see below"


def _nothing(_desk: object) -> None:
    """What happened is over."""


def moment_of(step: RecordedStep, vehicle: VehicleState, start_s: float) -> Moment:
    """A step with what was known of the vehicle after it; NaN or None is what was not, or cannot be.

    Parameters
    ----------
    start_s : of the flight, on the clock of the record.

    Raises
    ------
    KeyError, TypeError, ValueError, AttributeError
        If the output is not one of this version's.
    """
    inputs, output, sample = step.inputs, step.output, step.inputs.track
    attitude, local, heartbeat = vehicle.attitude, vehicle.local, vehicle.heartbeat
    angles = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) if attitude is not None else _UNKNOWN
    setpoint, target = output["setpoint"], output["target"]
    fix = target["fix"] if target is not None else None
    north_mps, east_mps, down_mps = map(_number, setpoint["velocity_ned_mps"]) if setpoint is not None else _UNKNOWN
    said = (f"autopilot: {event.text}" for event in inputs.events if isinstance(event, AutopilotText))
    return Moment(
        time_s=inputs.now_s - start_s,
        mode=Mode[output["mode"]["name"]].value,
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
        setpoint_ned_mps=(north_mps, east_mps, down_mps) if setpoint is not None else None,
        yaw_rate_radps=_number(setpoint["yaw_rate_radps"]) if setpoint is not None else None,
        range_m=_number(fix["range_m"]) if fix is not None else None,
        notes=tuple(map(str, output["notes"])),
        texts=(*step.texts, *said),
    )


def _number(value: Any) -> float:
    """A number of an output, which a record spells out where it is not finite."""
    number = decoded(value)
    if misfit(number, float, ""):
        raise TypeError(f"{str(number)[:40]!r} is no number")
    return float(number)
