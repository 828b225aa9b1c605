import contextlib
import math
import socket
from collections.abc import Callable, Iterator
from io import BytesIO

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.errors import LinkLostError
from sim import external
from sim.ardupilot import ArduCopter
from sim.autopilot import FakeAutopilot, Personality, Start
from sim.external import ExternalAutopilot
from sim.px4 import Px4
from sim.world import Pose

START = Start(pos_ned_m=(40.0, -25.0, -12.0), yaw_rad=2.0)
LIMIT_S = 0.2  # instead of 20 s or minutes, where a wait has to be in vain


def telemetry(personality: type[Personality], system_id: int = 1) -> bytes:
    """What an autopilot sends in two seconds, asked for its position."""
    autopilot = FakeAutopilot(personality, start=START, system_id=system_id)
    asker = mavlink.MAVLink(BytesIO(), 254, 190)
    for number in (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        message = mavlink.MAVLink_command_long_message(system_id, 1, command, 0, number, 1e5, 0, 0, 0, 0, 0)
        autopilot.receive(message.pack(asker))
    return autopilot.step(2.0)


def heartbeat(personality: type[Personality]) -> bytes:
    parser = mavlink.MAVLink(BytesIO())
    messages = parser.parse_buffer(telemetry(personality)) or ()
    return next(bytes(message.get_msgbuf()) for message in messages if message.get_type() == "HEARTBEAT")


class Served:
    """An external autopilot whose other side is a socket of the test."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        device = f"tcp:127.0.0.1:{self._listener.getsockname()[1]}"
        self.autopilot = ExternalAutopilot(device, 115200, self.said.append, is_ours=True)
        self.autopilot.step(0.0)
        self.port, _ = self._listener.accept()

    def close(self) -> None:
        self.autopilot.close()
        self.port.close()
        self._listener.close()


@pytest.fixture
def served() -> Iterator[Served]:
    both = Served()
    yield both
    both.close()


@pytest.fixture
def heard(served: Served) -> Callable[[bytes], ExternalAutopilot]:
    def hear(data: bytes) -> ExternalAutopilot:
        served.port.sendall(data)
        served.autopilot.connect()
        return served.autopilot

    return hear


@pytest.mark.parametrize(("kind", "mode"), [(ArduCopter, "LOITER"), (Px4, "AUTO.LOITER")])
def test_it_is_known_by_its_telemetry(
    heard: Callable[[bytes], ExternalAutopilot], kind: type[Personality], mode: str
) -> None:
    autopilot = heard(telemetry(kind))
    assert autopilot.personality is kind
    assert autopilot.mode_name == mode
    assert autopilot.is_armed
    assert autopilot.pose.pos_ned_m == pytest.approx(START.pos_ned_m, abs=0.05)
    assert autopilot.pose.yaw_rad == pytest.approx(START.yaw_rad, abs=0.01)


def test_the_stage_is_laid_out_around_it_and_its_height_is_its_own(
    heard: Callable[[bytes], ExternalAutopilot],
) -> None:
    autopilot = heard(telemetry(ArduCopter))
    wanted = Pose((-83.0, 1.85, -14.0), yaw_rad=0.5)
    autopilot.lay_out(wanted)
    assert autopilot.pose.pos_ned_m == pytest.approx((-83.0, 1.85, -12.0), abs=0.05)
    assert autopilot.pose.yaw_rad == pytest.approx(0.5, abs=0.01)


def test_its_velocity_is_turned_into_the_stage(served: Served) -> None:
    served.port.sendall(telemetry(ArduCopter))
    served.autopilot.connect()
    served.autopilot.lay_out(Pose((0.0, 0.0, -14.0), yaw_rad=START.yaw_rad + math.pi / 2))
    sender = mavlink.MAVLink(BytesIO(), 1, 1)
    # seen later: 3 m/s to its own north are 3 m/s to the stage's east
    moving = mavlink.MAVLink_local_position_ned_message(3000, 40.0, -25.0, -12.0, 3.0, 0.0, 0.5)
    served.port.sendall(moving.pack(sender))
    while served.autopilot.velocity_ned_mps[2] != 0.5:
        served.autopilot.step(0.0)
    assert served.autopilot.velocity_ned_mps == pytest.approx((0.0, 3.0, 0.5), abs=1e-6)


def test_a_second_vehicle_on_the_link_is_not_taken_for_it(heard: Callable[[bytes], ExternalAutopilot]) -> None:
    autopilot = heard(telemetry(ArduCopter) + telemetry(Px4, system_id=2))
    assert autopilot.personality is ArduCopter


def test_bytes_pass_unchanged_both_ways(served: Served) -> None:
    data = telemetry(Px4) + b"noise"
    served.port.sendall(data)
    passed = b""
    while len(passed) < len(data):
        passed += served.autopilot.step(0.0)
    assert passed == data
    served.autopilot.receive(b"setpoint")
    served.port.settimeout(10.0)
    came = b""
    while not came.endswith(b"setpoint"):  # after what a ground station says
        came += served.port.recv(4096)


def test_silence_is_said_with_what_was_waited_for(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(external, "HEARD_S", LIMIT_S)
    with pytest.raises(LinkLostError, match="heartbeat in vain"):
        served.autopilot.connect()


def test_an_autopilot_that_boots_gets_its_time_to_find_its_position(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(external, "READY_S", LIMIT_S)
    served.port.sendall(heartbeat(ArduCopter))
    with pytest.raises(LinkLostError, match="position in vain"):
        served.autopilot.connect()
    assert served.said == ["waiting for an autopilot's heartbeat", "waiting for its position"]
    served.port.sendall(telemetry(ArduCopter))
    served.autopilot.connect()


def test_a_link_that_breaks_is_said(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(external, "HEARD_S", LIMIT_S)
    served.port.close()
    with pytest.raises(LinkLostError, match=r"in vain: tcp:.* broke"):
        served.autopilot.connect()


def test_the_modes_of_one_that_somebody_else_flies_are_asked_for_in_words_once(
    heard: Callable[[bytes], ExternalAutopilot], served: Served
) -> None:
    autopilot = heard(telemetry(Px4))
    autopilot.is_ours = False
    served.port.settimeout(0)
    with contextlib.suppress(BlockingIOError):
        while served.port.recv(4096):
            pass
    for _ in range(3):
        assert not autopilot.select_mode("OFFBOARD")
    assert served.said[-1:] == ["select OFFBOARD now"]
    assert served.said.count("select OFFBOARD now") == 1
    with pytest.raises(BlockingIOError):
        served.port.recv(10)


def test_a_pilot_who_is_not_there_moves_no_sticks(served: Served) -> None:
    with pytest.raises(LinkLostError, match="--external"):
        served.autopilot.set_sticks(roll=1.0)
