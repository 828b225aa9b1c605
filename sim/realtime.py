"""A scenario in real time, with the application as a process of its own: `run` against both ends of the simulator.

The operator speaks to it as one on the vehicle does, through the control socket; fate pulls the camera out, cuts the
link, and stops or kills the process with signals.
"""

import json
import math
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from companion.config import Config, RecordConfig, text_of
from companion.errors import UsageError
from companion.types import Deselect, Disengage, Engage, OperatorCommand, Select
from mscf import Box
from sim.autopilot import FakeAutopilot, Personality, Start
from sim.camera import Truth, observe
from sim.external import VIEW_DELAY_S, ExternalAutopilot
from sim.loop import Faults, Watcher, gimbal_of, world_time_s
from sim.report import LOG, RECORDS
from sim.scenarios import AUTOPILOTS, WAIT_S, Operator, Scenario, Verdict
from sim.server import CameraServer, RealTime, Shot, open_end
from sim.stages import Stage
from sim.trace import Moment, Trace
from sim.usage import Usage

POLL_S = 0.05  # between two questions to the application
ANSWER_S = 0.5
BOOT_S = 15.0  # for the application to open its control socket
USAGE_S = 5.0  # between two readings of what it takes of the machine
END_S = 10.0  # for it to end


class ControlLine:
    """A connection to a running application's control socket; what it does not answer in time is None."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket: socket.socket | None = None
        self._received = b""

    def ask(self, request: dict[str, Any]) -> dict[str, Any] | None:
        """Send a request and wait for its answer."""
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                self._socket.settimeout(ANSWER_S)
                self._socket.connect(str(self._path))
                self._received = b""
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            while b"\n" not in self._received:
                data = self._socket.recv(65536)
                if not data:
                    raise ConnectionResetError
                self._received += data
        except OSError:
            self.close()
            return None
        line, self._received = self._received.split(b"\n", 1)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """Close it; the next request connects again."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def config_text(config: Config, *, source: str, device: str, control: Path) -> str:
    """The configuration as a file for the application, with the simulator's ends in it."""
    ends = replace(
        config,
        camera=replace(config.camera, source=source),
        link=replace(config.link, device=device),
        control=replace(config.control, socket=str(control)),
    )
    return text_of(ends)


class Flight:
    """One scenario in real time; a `Desk` for its operator.

    Parameters
    ----------
    place : the scenario's stage; a test may have given it a smaller camera.
    autopilot : the fake one, or a real one on a link.
    link : udp, tcp or serial, between it and the application.
    folder : where the application's configuration, log and sockets are.
    records : where its flight records go; None: into a folder of that one.
    record : what it keeps in them; None: as the scenario's configuration says.
    extra_latency_ms : by which the picture is older than its stamp says.
    """

    def __init__(
        self,
        scenario: Scenario,
        place: Stage,
        autopilot: FakeAutopilot | ExternalAutopilot,
        personality: type[Personality],
        link: str,
        folder: Path,
        *,
        records: Path | None = None,
        record: RecordConfig | None = None,
        extra_latency_ms: float = 0.0,
    ) -> None:
        self.scenario = scenario
        self.stage = place
        self.personality = personality
        self.autopilot = autopilot
        self.commands: list[OperatorCommand] = []
        self.status: dict[str, Any] = {}
        self.moments: list[Moment] = []
        self.process: subprocess.Popen[bytes] | None = None
        self.realtime = RealTime(
            self.stage,
            self.autopilot,
            open_end(link),
            CameraServer(folder / "frames.sock"),
            world_s_of=lambda time_s: world_time_s(time_s, WAIT_S),
            gain=scenario.gain,
        )
        self._faults = Faults()
        self.usage = Usage()
        self.timing: dict[str, float] = {}  # the application's own, as it said at the end
        self._asked_s = self._used_s = -math.inf
        self._folder = folder
        self._shots: deque[Shot] = deque(maxlen=90)
        self._line = ControlLine(folder / "control.sock")
        config = scenario.config(self.stage)
        latency_ms = config.camera.latency_ms + extra_latency_ms
        records = (folder / RECORDS if records is None else records).resolve()
        text = config_text(
            replace(
                config,
                camera=replace(config.camera, latency_ms=latency_ms),
                record=replace(record or config.record, folder=str(records)),
            ),
            source=self.realtime.camera.source,
            device=self.realtime.end.device,
            control=folder / "control.sock",
        )
        self.config_path = folder / "config.toml"
        self.config_path.write_text(text)

    # ----------------------------------------------------------------------------------- as a desk
    @property
    def time_s(self) -> float:
        """Since the start."""
        return self.realtime.time_s

    @property
    def mode(self) -> str:
        """Of the application, as it said last."""
        return str(self.status.get("mode", "idle"))

    @property
    def truth(self) -> Truth:
        """Truth of a frame taken now."""
        return observe(self.stage.world, self.stage.carried_camera, self.autopilot.camera_pose, self.realtime.world_s)

    @property
    def faults(self) -> Faults:
        """What is broken now."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        plug = self.realtime.camera.is_plugged
        plug.clear() if faults.is_camera_dead else plug.set()
        self.realtime.is_frozen = faults.is_camera_frozen
        self.realtime.is_link_cut = faults.is_link_cut
        if self.process is not None and faults.is_app_stopped != self._faults.is_app_stopped:
            self.process.send_signal(signal.SIGSTOP if faults.is_app_stopped else signal.SIGCONT)
        self._faults = faults

    # ----------------------------------------------------------------------------------- the application
    @property
    def command(self) -> list[str]:
        """What starts the application."""
        return [str(Path(sys.executable).with_name("mscf-companion")), "run", "-c", str(self.config_path)]

    def start_application(self) -> None:
        """Start it, and wait until it answers."""
        with (self._folder / LOG).open("ab") as log:
            self.process = subprocess.Popen(self.command, stderr=log, stdin=subprocess.DEVNULL)  # noqa: S603 - ours
        self.wait_for_application()

    def wait_for_application(self) -> None:
        """Wait until it answers on its control socket.

        Raises
        ------
        UsageError
            If it ends instead, or does not answer within 15 s.
        """
        limit_s = time.monotonic() + BOOT_S
        while (answer := self._line.ask({"do": "status"})) is None:
            has_ended = self.process is not None and self.process.poll() is not None
            if has_ended or time.monotonic() > limit_s:
                said = (self._folder / LOG).read_text(errors="replace").splitlines()
                raise UsageError(f"the application does not start: {said[-1] if said else 'it says nothing'}")
            time.sleep(POLL_S)
        self.status = answer

    def end_application(self) -> int | None:
        """Ask it to end, and return its exit status; one that does not end in time is killed."""
        if self.process is None:
            return None
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        try:
            return self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    # ----------------------------------------------------------------------------------- the flight
    def fly(self, *, watcher: Watcher | None = None) -> tuple[Trace, tuple[Verdict, ...]]:
        """Fly the scenario from now on, and judge it; the application must be there or come."""
        operator = Operator(self.scenario)
        self.begin()
        while self.time_s < self.scenario.duration_s:
            self.advance(operator, watcher)
        self.timing = (self._line.ask({"do": "timing"}) or {}).get("timing", {})
        trace = Trace(tuple(self.moments))
        return trace, tuple(check.judge(trace) for check in self.scenario.checks)

    def begin(self) -> None:
        """Let time run."""
        self.realtime.start()

    def advance(self, operator: Operator, watcher: Watcher | None = None) -> Moment | None:
        """Take the next frame; every 50 ms let the operator act and the application answer, else return None."""
        shot = self.realtime.shoot()
        self._shots.append(shot)
        if self.time_s - self._asked_s < POLL_S:
            return None
        self._asked_s = self.time_s
        if self.process is not None and self.time_s - self._used_s >= USAGE_S:
            self._used_s = self.time_s
            self.usage.read(self.process.pid, self.time_s)
        with self.realtime.lock:
            operator.act(self)
        moment = self._moment(shot, self._speak())
        self.moments.append(moment)
        if watcher is not None:
            watcher(moment, shot.image)
        return moment

    def end(self) -> None:
        """Close both ends of the application."""
        self._line.close()
        self.realtime.stop()

    def _speak(self) -> tuple[str, ...]:
        """Give the operator's orders, and take the status; what the application said since."""
        texts: list[str] = []
        if self._faults.is_app_stopped:
            return ()
        for command in self.commands:
            texts += self._take(self._line.ask(request_of(command)))
        self.commands.clear()
        return (*texts, *self._take(self._line.ask({"do": "status"})))

    def _take(self, answer: dict[str, Any] | None) -> list[str]:
        if answer is None or "error" in answer:
            return [] if answer is None else [answer["error"]]
        self.status = answer
        return [str(text) for text in answer["texts"]]

    def _moment(self, shot: Shot, texts: tuple[str, ...]) -> Moment:
        status, now_s = self.status, self.time_s
        age_ms = status.get("frame_age_ms")
        seen = shot
        if age_ms is not None:  # the frame that the application had seen, by its time of capture
            captured_s = time.monotonic() - age_ms / 1000
            seen = min(self._shots, key=lambda taken: abs(taken.captured_s - captured_s))
        box, setpoint = status.get("box"), status.get("setpoint_ned_mps")
        with self.realtime.lock:
            autopilot = self.autopilot
            return Moment(
                now_s,
                self.mode,
                autopilot.mode_name,
                autopilot.is_armed,
                autopilot.pose,
                autopilot.velocity_ned_mps,
                self.stage.target.motion.pose(self.realtime.world_s).pos_ned_m,
                Box(*box) if box is not None else None,
                seen.truth.box,
                seen.truth.visible_share,
                str(status.get("target", "none")),
                float(status.get("confidence", 0.0)),
                float(status.get("threat", 0.0)),
                age_ms / 1000 if age_ms is not None else None,
                (setpoint[0], setpoint[1], setpoint[2]) if setpoint is not None else None,
                status.get("yaw_rate_radps"),
                status.get("range_m"),
                tuple(status.get("notes", ())),
                texts,
            )


def request_of(command: OperatorCommand) -> dict[str, Any]:
    """The control socket's request for an order."""
    match command:
        case Select(box=None):
            return {"do": "select"}
        case Select(box=box) if box is not None:
            return {"do": "select", "box": [box.x, box.y, box.w, box.h]}
        case Deselect():
            return {"do": "deselect"}
        case Disengage():
            return {"do": "disengage"}
        case Engage():
            return {"do": "engage"}
    raise AssertionError(command)


def fake_autopilot(scenario: Scenario, place: Stage, autopilot: str, seed: int = 0) -> FakeAutopilot:
    """The fake autopilot of a scenario, in the air at the stage's start."""
    return FakeAutopilot(
        AUTOPILOTS[autopilot],
        start=Start(
            pos_ned_m=place.start.pos_ned_m,
            yaw_rad=place.start.yaw_rad,
            mode="GUIDED" if autopilot == "ardupilot" else None,
        ),
        seed=seed,
        wind=scenario.wind,
        gimbal=gimbal_of(place),
    )


def fly_in_real_time(
    scenario: Scenario,
    autopilot: str,
    link: str,
    *,
    seed: int = 0,
    watcher: Watcher | None = None,
    folder: Path,
    record: RecordConfig | None = None,
) -> tuple[Trace, tuple[Verdict, ...], dict[str, Any]]:
    """Start the application, fly, end it; also what it said last of its own timing.

    Parameters
    ----------
    folder : for the application's configuration, log and flight record; the sockets live elsewhere, as their paths must
        be short.
    record : what the application keeps; None: as the scenario's configuration says.
    """
    place = scenario.place(seed)
    fake = fake_autopilot(scenario, place, autopilot, seed)
    with tempfile.TemporaryDirectory() as temporary:
        personality, records = AUTOPILOTS[autopilot], folder / RECORDS
        flight = Flight(scenario, place, fake, personality, link, Path(temporary), records=records, record=record)
        try:
            return _flown(flight, watcher)
        finally:
            _keep(Path(temporary), folder)


def fly_external(
    scenario: Scenario,
    autopilot: ExternalAutopilot,
    *,
    seed: int = 0,
    watcher: Watcher | None = None,
    say: Callable[[str], None],
    folder: Path,
) -> tuple[Trace, tuple[Verdict, ...], dict[str, Any]]:
    """As `fly_in_real_time`, with a real autopilot in the fake one's place.

    Parameters
    ----------
    autopilot : connected; where it is ours it takes off and lands by command, else somebody else flies it.
    say : is told when the flight begins.

    Raises
    ------
    LinkLostError
        If the autopilot does not take off.
    """
    place = scenario.place(seed)
    height_m = -place.start.pos_ned_m[2]
    try:
        if autopilot.is_ours:
            autopilot.take_off(height_m)
        else:
            autopilot.wait_airborne(height_m)
        autopilot.lay_out(place.start)
        say(f"flying {scenario.name}")
        with tempfile.TemporaryDirectory() as temporary:
            flight = Flight(
                scenario,
                place,
                autopilot,
                autopilot.personality,
                "udp",
                Path(temporary),
                records=folder / RECORDS,
                extra_latency_ms=VIEW_DELAY_S * 1000,
            )
            try:
                return _flown(flight, watcher)
            finally:
                _keep(Path(temporary), folder)
    finally:
        if autopilot.is_ours and autopilot.is_armed:  # whatever went wrong: what was sent up comes down
            autopilot.land()


def _flown(flight: Flight, watcher: Watcher | None) -> tuple[Trace, tuple[Verdict, ...], dict[str, Any]]:
    try:
        flight.start_application()
        trace, verdicts = flight.fly(watcher=watcher)
    finally:
        exit_status = flight.end_application()  # while its link is still there: its last words are for the autopilot
        flight.end()
    counts = ("frames_dropped", "record_steps_dropped", "record_frames_dropped")
    facts = {**flight.timing, **{name: flight.status.get(name) for name in counts}, **flight.usage.figures()}
    return trace, verdicts, {**facts, "exit_status": exit_status}


def _keep(temporary: Path, folder: Path) -> None:
    """Keep what a person may want to read."""
    for name in ("config.toml", LOG):
        if (temporary / name).is_file():
            shutil.copyfile(temporary / name, folder / name)
