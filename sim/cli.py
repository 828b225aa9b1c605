"""Command `mscf-companion sim`: flies scenarios and reports on them."""

import argparse
import shlex
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from companion.config import Config, RecordConfig
from companion.errors import UsageError
from companion.flight_folders import NoRoomError, check_free, check_size
from companion.flight_record import FlightRecord
from companion.follower import FailedStep, Step, StepError
from companion.link import check_device
from mscf.recording import VideoFile
from sim.autopilot import Personality
from sim.external import ExternalAutopilot
from sim.eyes import RenderedEyes
from sim.film import Film
from sim.loop import OUR_CLOCK_S, Watcher
from sim.realtime import fly_external, fly_in_real_time
from sim.report import FILM, PAGE, Kind, Run, folder_name, prepare_folder, write_index, write_run
from sim.scenarios import AUTOPILOTS, DEMO, SCENARIOS, Scenario, Verdict, fly
from sim.server import KINDS
from sim.stages import stage
from sim.trace import Trace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence


EXIT_FAILED = 1
EXTERNAL_BAUD = 115200  # where it is on a serial port
STEPS_PER_S = 20  # moments a second, and frames of the video
LOOK_STEPS = 1000  # between two looks at how much room there is, in which a record grows by a few MB
VIRTUAL_START_US = 1_767_225_600_000_000  # 2026-01-01 UTC: flights in virtual time all begin then


@dataclass(frozen=True, slots=True)
class _Task:
    """One flight to be made; picklable."""

    scenario: str
    autopilot: str  # which fake one; an external one says itself what it is
    out: Path
    kind: Kind
    command: str
    seed: int
    link: str | None  # of a run in real time; None: virtual time
    external: str | None
    arms: bool
    duration_s: float | None
    frame_hw: tuple[int, int] | None
    has_video: bool
    has_record: bool


def add_command(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add `sim` to the commands of `mscf-companion`."""
    sim = commands.add_parser(
        "sim",
        help="fly in the simulator: world, camera and autopilot without hardware",
        description="Fly scenarios in a closed loop; write a video, plots, a verdict and a page of each. "
        "Exit status 1 where a check fails.",
    )
    sim.add_argument("scenario", nargs="*", metavar="SCENARIO", help=f"see --list, or all (default: {DEMO})")
    sim.add_argument("--list", action="store_true", help="list the scenarios")
    sim.add_argument(
        "--autopilot", choices=AUTOPILOTS, action="append", help="fake one; may be repeated (default: ardupilot)"
    )
    sim.add_argument("--out", type=Path, default=Path("out/sim"), metavar="DIR", help="default: %(default)s")
    sim.add_argument("--duration", type=float, metavar="S", help="in place of the scenario's")
    sim.add_argument(
        "--frames", type=_size_hw, metavar="WxH", help="size of the camera's frames (default: the scenario's, 640x480)"
    )
    sim.add_argument("--no-video", action="store_true", help="no film, for measuring: encoding takes its share")
    sim.add_argument("--no-record", action="store_true", help="for measuring: with --realtime, without a flight record")
    sim.add_argument("--seed", type=int, default=0, help="of the scenery, the gusts and the noise")
    sim.add_argument("--jobs", type=int, default=1, metavar="N", help="flights at a time (default: %(default)s)")
    sim.add_argument(
        "--realtime", action="store_true", help="in real time, with `mscf-companion run` as a process of its own"
    )
    sim.add_argument("--link", choices=KINDS, default="udp", help="of --realtime (default: %(default)s)")
    sim.add_argument("--external", metavar="LINK", help="a real autopilot's SITL in the fake one's place")
    sim.add_argument(
        "--arm",
        action="store_true",
        help="with --external: arm, take off, select flight modes and land by command; else somebody else does",
    )
    sim.set_defaults(run=_run)


def _size_hw(text: str) -> tuple[int, int]:
    """Rows and columns of "640x480".

    Raises
    ------
    argparse.ArgumentTypeError
        If it is nothing like that, or a size that no camera has.
    """
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 64 <= int(width) <= 3840 and 48 <= int(height) <= 2160):
        raise argparse.ArgumentTypeError(f"{text!r} must be WIDTHxHEIGHT, from 64x48 to 3840x2160, as in 1280x720")
    return int(height), int(width)


def _run(arguments: argparse.Namespace) -> int:
    if arguments.list:
        for scenario in SCENARIOS.values():
            print(f"{scenario.name:15} {scenario.description}")
        return 0
    names = _names(arguments)
    autopilots = list(dict.fromkeys(arguments.autopilot or ["ardupilot"]))
    kind: Kind = "external" if arguments.external else "real time" if arguments.realtime else "virtual time"
    tasks = [
        _Task(
            name,
            autopilot,
            arguments.out,
            kind,
            shlex.join(["mscf-companion", *sys.argv[1:]]),
            arguments.seed,
            arguments.link if arguments.realtime else None,
            arguments.external,
            arguments.arm,
            arguments.duration,
            arguments.frames,
            not arguments.no_video,
            not arguments.no_record,
        )
        for name in names
        for autopilot in autopilots
    ]
    runs = _flown(tasks, arguments.jobs)
    if len(runs) > 1:
        write_index(runs, arguments.out)
        print(f"all       {arguments.out / PAGE}")
    return 0 if all(run.is_passed for run in runs) else EXIT_FAILED


def _names(arguments: argparse.Namespace) -> list[str]:
    """The scenarios to be flown.

    Raises
    ------
    UsageError
        If there is one that does not exist or cannot be flown so, or two options contradict each other.
    """
    names = arguments.scenario or [DEMO]
    names = list(SCENARIOS) if names == ["all"] else list(dict.fromkeys(names))
    for name in names:
        if name not in SCENARIOS:
            raise UsageError(f"unknown scenario {name!r}: give one of {', '.join(SCENARIOS)}")
    if arguments.arm and not arguments.external:
        raise UsageError("--arm needs --external LINK: the fake autopilots start in the air")
    if arguments.jobs < 1 or (arguments.jobs > 1 and (arguments.realtime or arguments.external)):
        raise UsageError(f"--jobs {arguments.jobs} must be 1 in real time, and at least 1 otherwise")
    if arguments.duration is not None and not 5 <= arguments.duration <= 3600:
        raise UsageError(f"--duration {arguments.duration:g} must be 5..3600 seconds")
    if arguments.no_record and not arguments.realtime:
        raise UsageError("--no-record needs --realtime: in virtual time nothing is delayed by a record")
    if arguments.external:
        check_device(arguments.external)
        if arguments.autopilot:
            raise UsageError("--autopilot is for the fake ones: the one at --external says itself what it is")
        for name in names:
            if SCENARIOS[name].moves_sticks:
                raise UsageError(f"{name} moves the pilot's sticks: it cannot be flown with --external")
            if stage(SCENARIOS[name].stage, 7).has_gimbal:
                raise UsageError(f"{name} needs the fake autopilot's gimbal: it cannot be flown with --external")
    return names


def _flown(tasks: list[_Task], jobs: int) -> list[Run]:
    """Fly all, one after the other or some at a time, and say what came of each."""
    runs = []
    with ExitStack() as stack:
        if jobs > 1 and len(tasks) > 1:
            pool = stack.enter_context(ProcessPoolExecutor(jobs, mp_context=get_context("spawn")))
            flown: Any = pool.map(_fly, tasks)
        else:
            flown = map(_fly, tasks)
        for task, run in zip(tasks, flown, strict=True):
            runs.append(run)
            _print(task, run)
    return runs


def _print(task: _Task, run: Run) -> None:
    folder = task.out / run.folder_name
    print(f"{'PASSED' if run.is_passed else 'FAILED'}    {run.scenario}, {run.autopilot}, {run.kind}")
    for verdict in run.verdicts:
        if not verdict.is_passed:
            print(f"          {verdict.name}: {verdict.measured}, wanted {verdict.wanted}")
    if task.has_video:
        print(f"video     {folder / FILM}")
    print(f"page      {folder / PAGE}", flush=True)


def _fly(task: _Task) -> Run:
    """Fly one task and write its report."""
    cv2.setNumThreads(1)
    scenario = SCENARIOS[task.scenario]
    if task.duration_s is not None:
        scenario = replace(scenario, duration_s=task.duration_s)
    scenario = replace(scenario, frame_hw=task.frame_hw)
    with ExitStack() as stack:
        external = stack.enter_context(closing(_external(task))) if task.external is not None else None
        if external is not None:
            external.connect()
            task = replace(task, autopilot=_name(external.personality))
        folder = task.out / folder_name(task.scenario, task.autopilot, task.kind)
        prepare_folder(folder)
        watch = stack.enter_context(_filmed(task, scenario, folder)) if task.has_video else None
        trace, verdicts, facts = _made(task, scenario, external, watch, folder)
    run = Run(
        scenario=scenario.name,
        description=scenario.description,
        autopilot=task.autopilot,
        kind=task.kind,
        command=task.command,
        seed=task.seed,
        trace=trace,
        verdicts=verdicts,
        acts=tuple(act for act in scenario.acts if trace.between(act.time_s)),  # the others did not happen
        facts=facts,
    )
    write_run(run, folder)
    return run


@contextmanager
def _filmed(task: _Task, scenario: Scenario, folder: Path) -> "Iterator[Watcher]":
    """What makes the film of a flight."""
    place = scenario.place(task.seed)
    radius_m = scenario.config(place).limits.radius_m
    film = Film(place, scenario.name, task.autopilot, place.camera, scenario.wind, radius_m=radius_m)
    with VideoFile(folder / FILM, STEPS_PER_S) as video:
        yield lambda moment, image: video.write(film.frame(moment, image))


def _external(task: _Task) -> ExternalAutopilot:
    assert task.external is not None
    return ExternalAutopilot(task.external, EXTERNAL_BAUD, _say, is_ours=task.arms)


def _say(text: str) -> None:
    print("external ", text, flush=True)


def _name(kind: type[Personality]) -> str:
    return next(name for name, personality in AUTOPILOTS.items() if personality is kind)


def _made(
    task: _Task, scenario: Scenario, external: ExternalAutopilot | None, watch: Watcher | None, folder: Path
) -> tuple[Trace, tuple[Verdict, ...], dict[str, Any]]:
    """Trace, verdicts and further facts of a flight."""
    if external is not None:
        return fly_external(scenario, external, seed=task.seed, watcher=watch, say=_say, folder=folder)
    if task.link is not None:
        return fly_in_real_time(
            scenario,
            task.autopilot,
            task.link,
            seed=task.seed,
            watcher=watch,
            folder=folder,
            record=RecordConfig(enabled=task.has_record),
        )
    config = scenario.config(scenario.place(task.seed))
    with closing(BoundedRecord(folder, config)) as record:
        try:
            trace, verdicts = fly(
                scenario,
                task.autopilot,
                RenderedEyes,
                seed=task.seed,
                watcher=watch,
                recorder=record.add,
                farewell=record.add_farewell,
            )
        except StepError as error:
            record.add_failed(error.failed)
            raise
    return trace, verdicts, {"record_stopped": record.stopped} if record.stopped else {}


class BoundedRecord:
    """The flight record of a flight in virtual time, whose application has no recorder of its own.

    It ends where the disk or the record has reached its limit, says so, and lets the flight go on.

    Parameters
    ----------
    folder : of the flight; it is there.
    """

    def __init__(self, folder: Path, config: Config) -> None:
        self.stopped = ""  # why it has ended before the flight; empty: it has not
        self._folder, self._limits = folder, config.record
        self._record: FlightRecord | None = None
        self._steps = 0
        with self._stopping():
            check_free(folder, config.record)
            self._record = FlightRecord(folder, config, OUR_CLOCK_S, VIRTUAL_START_US)

    def add(self, step: Step) -> None:
        """Append a step."""
        self._steps += 1
        if self._steps % LOOK_STEPS == 0:
            self._write(self._look)
        self._write(lambda record: record.add(step))

    def add_failed(self, failed: FailedStep) -> None:
        """Append the step whose controller raised."""
        self._write(lambda record: record.add_failed(failed))

    def add_farewell(self, now_s: float, packets: "Sequence[bytes]") -> None:
        """Append the last words."""
        self._write(lambda record: record.add_farewell(now_s, packets))

    def close(self) -> None:
        """Finish."""
        if self._record is not None:
            with self._stopping():
                self._record.close()

    def _look(self, record: FlightRecord) -> None:
        check_size(self._folder, record.size_bytes, self._limits)
        check_free(self._folder, self._limits)

    def _write(self, write: "Callable[[FlightRecord], None]") -> None:
        if self._record is not None and not self.stopped:
            with self._stopping():
                write(self._record)

    @contextmanager
    def _stopping(self) -> "Iterator[None]":
        """What goes wrong in it ends the record, and is said once."""
        try:
            yield
        except OSError as error:
            if not self.stopped:
                place = "" if isinstance(error, NoRoomError) else f"{error.filename or self._folder}: "
                self.stopped = f"{place}{error.strerror or error}"
                print(f"mscf-companion: record stopped: {self.stopped}", file=sys.stderr)
