"""`mscf-companion run` as a process of its own, in the air: fake autopilots and the frame socket, in real time."""

import math
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.types import Engage, Select
from sim.realtime import Flight, fake_autopilot
from sim.scenarios import AUTOPILOTS, SCENARIOS, Operator
from sim.server import End
from sim.stages import Stage, stage
from sim.trace import Moment

DEADLINE_S = 40.0  # of every wait: far beyond what a busy machine needs
END_S = 10.0  # in which systemd wants a service to have ended
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
BRAKE, HOLD = (1, 17, 0), (1, 4, 3)  # parameters of DO_SET_MODE
TARGET_MPS = 2.0  # it is still in sight of a vehicle that stood for a while

# a clock that jumps by a day as soon as a file is there
JUMPING_CLOCK = """
import os, time
_time, _time_ns, _sign = time.time, time.time_ns, {sign!r}
time.time = lambda: _time() + 86400 * os.path.exists(_sign)
time.time_ns = lambda: _time_ns() + 86400 * 10**9 * os.path.exists(_sign)
"""


class Wire:
    """The autopilot's end of the link, with all that the application sent."""

    def __init__(self, end: End) -> None:
        self.device = end.device
        self.is_hung_up = False  # once: the connection is dropped
        self._end = end
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._heard: list[Any] = []

    def read(self) -> bytes:
        if self.is_hung_up:
            self.is_hung_up = False
            self._end._drop()  # type: ignore[attr-defined]  # a TcpEnd; in the thread that uses it
        data = self._end.read()
        self._heard += self._parser.parse_buffer(data) or ()
        return data

    def write(self, data: bytes) -> None:
        self._end.write(data)

    def close(self) -> None:
        self._end.close()

    @property
    def mark(self) -> int:
        """How much was heard so far."""
        return len(self._heard)

    def since(self, mark: int, *kinds: str) -> list[Any]:
        return [message for message in self._heard[mark:] if message.get_type() in kinds]

    def setpoints(self, mark: int) -> list[tuple[float, ...]]:
        return [(m.vx, m.vy, m.vz, m.yaw_rate) for m in self.since(mark, SETPOINT)]

    def commands(self, mark: int, command: int) -> list[tuple[float, ...]]:
        sent = [m for m in self.since(mark, "COMMAND_LONG") if m.command == command]
        return [(m.param1, m.param2, m.param3) for m in sent]


class Sortie:
    """A flight, step by step: the operator selects and engages, the test does the rest."""

    def __init__(self, autopilot: str, link: str, folder: Path, name: str) -> None:
        scenario = replace(SCENARIOS[name], confirms=True)
        place = small(stage(scenario.stage, 7))
        place = slow(place) if name == "straight" else place
        self.autopilot = fake_autopilot(scenario, place, autopilot)
        self.flight = Flight(scenario, place, self.autopilot, AUTOPILOTS[autopilot], link, folder)
        self.wire = self.flight.realtime.end = Wire(self.flight.realtime.end)
        self._operator = Operator(scenario)
        self._log_path = folder / "application.log"

    def until(self, what: str, is_there: Callable[[Moment], bool], limit_s: float = DEADLINE_S) -> Moment:
        """Fly until something is the case."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            moment = self.flight.advance(self._operator)
            if moment is not None and is_there(moment):
                return moment
        pytest.fail(f"waited {limit_s:g} s for {what}; {self.flight.moments[-1]}\n{self.log[-2000:]}")

    def watch(self, duration_s: float) -> list[Moment]:
        """Fly on for a while; what was seen."""
        first = len(self.flight.moments)
        end_s = self.flight.time_s + duration_s
        self.until("time to pass", lambda moment: moment.time_s >= end_s)
        return self.flight.moments[first:]

    def choose(self) -> None:
        """Select the target until the box is on it: it is small by now, and the picture has moved on meanwhile."""
        for _ in range(8):
            self.select()
            if (self.watch(1.0)[-1].iou or 0.0) > 0.3:
                return
        pytest.fail(f"the target could not be selected; {self.flight.moments[-1]}")

    def until_it_follows_and_moves(self) -> None:
        # until its newest setpoint moves it as well: what comes next meets a vehicle that has been told to go on
        self.until(
            "a vehicle that follows and moves",
            lambda m: m.mode == "following" and m.speed_mps > 1.0 and math.hypot(*(m.setpoint_ned_mps or (0.0,))) > 1.0,
        )

    def until_it_stands(self) -> Moment:
        return self.until("a vehicle that stands", lambda moment: moment.speed_mps < 0.3)

    def select(self) -> None:
        """Choose the target anew: it has gone on while nobody looked."""
        box = self.flight.truth.box
        assert box is not None
        self.flight.commands.append(Select(box))
        self.until("the choice", lambda _: not self.flight.commands)
        self.until("the target", lambda moment: moment.mode == "tracking")

    def break_(self, **faults: bool) -> None:
        self.flight.faults = replace(self.flight.faults, **faults)

    def until_it_has_ended(self) -> int:
        """Fly on until the application, which was told to end, has done so; its exit status."""
        process = self.flight.process
        assert process is not None
        self.until("the application to end", lambda _: process.poll() is not None, END_S)
        return int(process.returncode)

    @property
    def log(self) -> str:
        return self._log_path.read_text()


def small(place: Stage) -> Stage:
    """A stage that costs little to render."""
    camera = replace(place.camera, size_hw=(240, 320), focal_px=place.camera.focal_px / 2)
    return replace(place, camera=camera)


def slow(place: Stage) -> Stage:
    """A stage whose target does not get far."""
    target = replace(place.target, motion=replace(place.target.motion, speeds=((0.0, TARGET_MPS),)))
    return replace(place, world=replace(place.world, target=target))


@pytest.fixture
def take_off() -> Iterator[Callable[[str, str], Sortie]]:
    """Starts the application and a flight; the folder's path is short, as those of sockets must be."""
    with tempfile.TemporaryDirectory() as folder:
        sorties: list[Sortie] = []

        def start(autopilot: str, link: str, name: str = "straight") -> Sortie:
            sortie = Sortie(autopilot, link, Path(folder), name)
            sorties.append(sortie)
            sortie.flight.start_application()
            sortie.flight.begin()
            return sortie

        yield start
        for sortie in sorties:
            process = sortie.flight.process
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
            sortie.flight.end()


def is_zero(setpoints: list[tuple[float, ...]]) -> bool:
    return not any(any(setpoint) for setpoint in setpoints)


def test_a_lost_camera_and_a_jump_of_the_clock_are_survived_and_sigterm_stops_the_vehicle(
    take_off: Callable[[str, str], Sortie], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign = tmp_path / "jump"
    (tmp_path / "sitecustomize.py").write_text(JUMPING_CLOCK.format(sign=str(sign)))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    sortie = take_off("ardupilot", "udp")
    sortie.until_it_follows_and_moves()

    sortie.break_(is_camera_dead=True)
    sortie.until("a hold without a camera", lambda moment: moment.mode == "holding")
    mark = sortie.wire.mark
    sortie.watch(1.0)
    assert len(sortie.wire.setpoints(mark)) > 5
    assert is_zero(sortie.wire.setpoints(mark))
    sortie.break_(is_camera_dead=False)
    sortie.until_it_follows_and_moves()

    sign.touch()
    moments = sortie.watch(3.0)
    assert {moment.mode for moment in moments} == {"following"}
    assert min(moment.speed_mps for moment in moments) > 0.5

    mark = sortie.wire.mark
    assert sortie.flight.process is not None
    sortie.flight.process.terminate()
    assert sortie.until_it_has_ended() == 0
    sent = sortie.wire.since(mark, SETPOINT, "COMMAND_LONG")
    assert [message.get_type() for message in sent[-4:]] == [SETPOINT] * 3 + ["COMMAND_LONG"]
    assert is_zero(sortie.wire.setpoints(mark)[-3:])
    assert sortie.wire.commands(mark, mavlink.MAV_CMD_DO_SET_MODE) == [BRAKE]
    sortie.until("the brake", lambda moment: moment.flight_mode == "BRAKE")
    sortie.until_it_stands()
    assert not (sortie.flight.config_path.parent / "control.sock").exists()

    # the clock did jump, and the log alone shows it
    assert len({line[:10] for line in sortie.log.splitlines()}) > 1


def test_a_cut_link_does_not_resume_by_itself_and_a_restarted_autopilot_is_asked_again(
    take_off: Callable[[str, str], Sortie],
) -> None:
    sortie = take_off("px4", "tcp")
    sortie.until_it_follows_and_moves()
    modes = list(dict.fromkeys(moment.mode for moment in sortie.flight.moments))
    assert modes.index("tracking") < modes.index("ready") < modes.index("following")
    ready = [moment for moment in sortie.flight.moments if moment.mode == "ready"]
    assert ready[0].flight_mode == "AUTO.LOITER"
    assert {moment.setpoint_ned_mps for moment in ready} == {(0.0, 0.0, 0.0)}

    sortie.break_(is_link_cut=True)
    sortie.until("the autopilot's own time-out", lambda moment: moment.flight_mode == "POSCTL")
    sortie.until("an end of following", lambda moment: moment.mode in {"tracking", "lost"})
    assert "Follow ended: autopilot silent" in sortie.log  # not only when the heartbeats have stayed out for longer
    sortie.until_it_stands()
    sortie.wire.is_hung_up = True  # and the connection breaks as well
    sortie.break_(is_link_cut=False)
    mark = sortie.wire.mark
    sortie.until("telemetry", lambda _: sortie.flight.status["height_m"] is not None)
    moments = sortie.watch(2.0)
    assert sortie.wire.setpoints(mark) == []
    assert {moment.flight_mode for moment in moments} == {"POSCTL"}
    sortie.select()
    sortie.flight.commands.append(Engage())
    refused = sortie.until("an answer", lambda moment: bool(moment.texts))
    assert "may have left OFFBOARD by failsafe" in refused.texts[0]

    with sortie.flight.realtime.lock:
        sortie.autopilot.reboot()
    mark = sortie.wire.mark
    asked_for = {mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    sortie.until(
        "requests for telemetry",
        lambda _: asked_for <= {int(number) for number, _, _ in sortie.wire.commands(mark, interval)},
    )
    sortie.until("telemetry", lambda _: sortie.flight.status["height_m"] is not None)

    assert sortie.flight.process is not None
    sortie.flight.process.terminate()
    assert sortie.until_it_has_ended() == 0
    assert sortie.wire.setpoints(mark) == []


def test_a_stopped_or_killed_application_never_moves_an_arducopter_again_by_itself(
    take_off: Callable[[str, str], Sortie],
) -> None:
    sortie = take_off("ardupilot", "serial")
    sortie.until_it_follows_and_moves()

    sortie.break_(is_app_stopped=True)
    stands = sortie.until_it_stands()  # by GUID_TIMEOUT
    assert stands.flight_mode == "GUIDED"
    mark = sortie.wire.mark
    sortie.break_(is_app_stopped=False)
    sortie.until("the brake", lambda moment: moment.flight_mode == "BRAKE")
    sortie.select()
    assert max(moment.speed_mps for moment in sortie.watch(2.0)) < 0.5
    assert is_zero(sortie.wire.setpoints(mark))
    assert "control loop stalled" in sortie.log

    with sortie.flight.realtime.lock:
        sortie.autopilot.select_mode("GUIDED")
    mark = sortie.wire.mark
    sortie.watch(1.5)
    assert sortie.wire.setpoints(mark) == []  # the mode alone is no order
    sortie.choose()
    sortie.flight.commands.append(Engage())
    sortie.until_it_follows_and_moves()

    assert sortie.flight.process is not None
    sortie.flight.process.kill()
    sortie.flight.process.wait()
    assert (sortie.flight.config_path.parent / "control.sock").is_socket()
    sortie.watch(0.2)  # what it has written before is read
    mark = sortie.wire.mark
    sortie.flight.start_application()  # at once, as systemd would; its socket is in the way
    assert sortie.flight.status["mode"] == "idle"
    stands = sortie.until_it_stands()
    assert stands.flight_mode == "GUIDED"
    assert {moment.mode for moment in sortie.watch(1.5)} == {"idle"}
    assert sortie.wire.setpoints(mark) == []
    assert sortie.wire.commands(mark, mavlink.MAV_CMD_DO_SET_MODE) == []
    sortie.flight.process.send_signal(signal.SIGTERM)
    assert sortie.until_it_has_ended() == 0


def test_a_stopped_application_that_goes_on_does_not_bring_px4_back_to_offboard(
    take_off: Callable[[str, str], Sortie],
) -> None:
    sortie = take_off("px4", "serial")
    sortie.until_it_follows_and_moves()

    sortie.break_(is_app_stopped=True)
    sortie.until("PX4's failsafe", lambda moment: moment.flight_mode == "POSCTL")
    sortie.until_it_stands()
    mark = sortie.wire.mark
    sortie.break_(is_app_stopped=False)
    moments = sortie.watch(4.0)
    assert "OFFBOARD" not in {moment.flight_mode for moment in moments}
    assert max(moment.speed_mps for moment in moments) < 0.5
    assert is_zero(sortie.wire.setpoints(mark))
    assert moments[-1].mode in {"tracking", "lost"}


def test_a_killed_application_leaves_px4_to_its_failsafe_and_comes_back_without_moving_it(
    take_off: Callable[[str, str], Sortie],
) -> None:
    sortie = take_off("px4", "udp")
    sortie.until_it_follows_and_moves()

    assert sortie.flight.process is not None
    sortie.flight.process.kill()
    sortie.flight.process.wait()
    sortie.until("PX4's failsafe", lambda moment: moment.flight_mode == "POSCTL")
    sortie.until_it_stands()
    mark = sortie.wire.mark
    sortie.flight.start_application()
    moments = sortie.watch(4.0)
    assert {moment.flight_mode for moment in moments} == {"POSCTL"}
    assert {moment.mode for moment in moments} == {"idle"}
    assert sortie.wire.setpoints(mark) == []
    assert sortie.wire.commands(mark, mavlink.MAV_CMD_DO_SET_MODE) == []
    sortie.select()
    sortie.flight.commands.append(Engage())
    refused = sortie.until("an answer", lambda moment: bool(moment.texts))
    assert "select Hold first" in refused.texts[0]  # who starts in the air cannot know of the gap


def test_a_target_that_hides_is_lost_held_for_found_again_and_followed(
    take_off: Callable[[str, str, str], Sortie],
) -> None:
    sortie = take_off("ardupilot", "tcp", "occlusion")
    sortie.until_it_follows_and_moves()
    sortie.until("a hold while it hides", lambda moment: moment.mode == "holding")
    held = sortie.flight.moments[-1]
    assert held.visible_share < 0.5
    mark = sortie.wire.mark
    sortie.until("it again", lambda moment: moment.mode == "following" and moment.visible_share > 0.9)
    assert is_zero(sortie.wire.setpoints(mark)[:3])
    moments = sortie.watch(5.0)
    assert moments[-1].mode == "following"
    assert (moments[-1].iou or 0.0) > 0.3
    assert moments[-1].speed_mps > 1.0
