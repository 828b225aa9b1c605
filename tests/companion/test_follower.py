"""The application without its edges: bytes, samples and orders in, bytes out."""

from io import BytesIO
from itertools import pairwise
from typing import Any

import pytest
from cockpit import AHEAD, FOLLOW, SIZE_HW
from pymavlink.dialects.v20 import common as mavlink

from companion.codec import rates_hz
from companion.config import parse
from companion.follower import Follower, Step
from companion.modes import Mode
from companion.types import Autopilot, Disengage, Engage, Select, Severity, Text, TrackSample
from mscf import TrackStatus

COPTER, PX4 = 3, 12
GUIDED, LOITER, OFFBOARD = 4, 5, 6 << 16
VALUES = {
    "GUID_TIMEOUT": 3.0,
    "GUID_OPTIONS": 0.0,
    "FS_OPTIONS": 20.0,
}


class Link:
    """A follower, and a vehicle that flies level at 14 m with a target ahead; 20 steps a second."""

    def __init__(self, config: str = FOLLOW, autopilot: int = COPTER, mode: int = GUIDED) -> None:
        self.follower = Follower(parse(config))
        self.k = 0
        self.autopilot, self.mode = autopilot, mode
        self.booted_k = -1000  # the step in which it was switched on
        self.is_there = True
        self.attitude_every = 1  # steps
        self.missing = ""  # a kind of message that does not come
        self.values: dict[str, float] = {}
        self.ordered: list[Any] = []  # messages of a ground station, for the next step
        self.is_tracked = True
        self.steps: list[Step] = []
        self.heard: list[tuple[float, Any]] = []  # time of ours and message
        self._out = mavlink.MAVLink(BytesIO(), srcSystem=1, srcComponent=1)
        self._ground = mavlink.MAVLink(BytesIO(), srcSystem=255, srcComponent=190)
        self._in = mavlink.MAVLink(BytesIO())
        self._asked: list[str] = []
        self._selection = 0

    @property
    def now_s(self) -> float:
        return 50.0 + self.k / 20

    def step(self, *commands: Any, is_healthy: bool = True) -> Step:
        self.k += 1
        status = TrackStatus.TRACKING if self._selection else None
        is_seen = bool(self._selection) and self.is_tracked
        track = TrackSample(
            self.k, self.now_s - 0.02, self.now_s, SIZE_HW, self._selection, status, is_seen, AHEAD, 0.9 * is_seen
        )
        ordered = b"".join(bytes(message.pack(self._ground)) for message in self.ordered)
        self.ordered.clear()
        step = self.follower.step(self.now_s, self._said() + ordered, track, commands, is_healthy=is_healthy)
        self._selection = step.control.selection.number
        self._hear(step.data)
        self.steps.append(step)
        return step

    def run(self, duration_s: float) -> list[Any]:
        """What was sent in that time."""
        at = len(self.heard)
        for _ in range(round(20 * duration_s)):
            self.step()
        return [message for _, message in self.heard[at:]]

    def engage(self) -> "Link":
        self.step()
        self.step(Select(AHEAD))
        self.run(0.5)
        self.step(Engage())
        assert self.steps[-1].control.mode is Mode.FOLLOWING
        return self

    def of(self, kind: str, component: int = 191) -> list[tuple[float, Any]]:
        return [(t, m) for t, m in self.heard if m.get_type() == kind and m.get_srcComponent() == component]

    def asked_rates(self) -> list[float]:
        """When the attitude was asked for."""
        return [t for t, m in self.of("COMMAND_LONG") if m.command == 511 and m.param1 == 30]

    def _hear(self, data: bytes) -> None:
        for message in self._in.parse_buffer(data) or ():
            self.heard.append((self.now_s, message))
            if message.get_type() == "PARAM_REQUEST_READ":
                self._asked.append(message.param_id)

    def _said(self) -> bytes:
        if not self.is_there:
            return b""
        boot_ms = 50 * (self.k - self.booted_k)
        messages = [mavlink.MAVLink_extended_sys_state_message(0, 2)]
        if self.k % 20 == 1:
            messages.append(mavlink.MAVLink_heartbeat_message(2, self.autopilot, 0x81, self.mode, 4, 3))
        if self.k % self.attitude_every == 0:
            messages += [mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0)] * 3  # as 50 Hz and more
        messages.append(mavlink.MAVLink_rc_channels_message(boot_ms, 4, *[1500] * 4, *[0xFFFF] * 14, 255))
        messages.append(mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, -14, 0, 0, 0))
        messages.append(mavlink.MAVLink_global_position_int_message(boot_ms, 0, 0, 0, 14000, 0, 0, 0, 0))
        for name in self._asked:
            if name in self.values:
                messages.append(mavlink.MAVLink_param_value_message(name.encode(), self.values[name], 9, 3, 0))
        self._asked.clear()
        return b"".join(bytes(message.pack(self._out)) for message in messages if message.get_type() != self.missing)


def test_a_heartbeat_leaves_at_once_and_then_every_second_whatever_happens() -> None:
    link = Link().engage()
    link.run(3.0)
    link.is_there = False
    link.run(5.0)
    times_s = [time_s for time_s, _ in link.of("HEARTBEAT")]
    assert times_s[0] == pytest.approx(50.05)
    assert all(b - a == pytest.approx(1.0, abs=0.051) for a, b in pairwise(times_s))


def test_the_heartbeat_says_standby_active_or_in_trouble() -> None:
    link = Link()
    link.run(1.0)
    link.engage()
    link.run(1.2)
    for _ in range(25):
        link.step(is_healthy=False)
    states = [message.system_status for _, message in link.of("HEARTBEAT")]
    assert states == sorted(states)
    assert set(states) == {3, 4, 5}


def test_the_camera_has_a_heartbeat_beside_ours() -> None:
    link = Link().engage()
    link.run(3.0)
    assert [t for t, _ in link.of("HEARTBEAT", 100)] == [t for t, _ in link.of("HEARTBEAT", 191)]
    assert {(m.type, m.autopilot) for _, m in link.of("HEARTBEAT", 100)} == {(30, 8)}
    assert {(m.type, m.autopilot) for _, m in link.of("HEARTBEAT", 191)} == {(18, 8)}


def test_the_cameras_heartbeat_says_standby_tracking_or_in_trouble() -> None:
    link = Link()
    link.run(2.0)
    link.step(Select(AHEAD))  # tracked, not engaged: ours stays on standby
    link.run(1.2)
    assert [m.system_status for _, m in link.of("HEARTBEAT", 100)] == [3, 3, 3, 4]
    assert [m.system_status for _, m in link.of("HEARTBEAT", 191)] == [3, 3, 3, 3]
    link.is_tracked = False
    link.run(2.0)
    assert link.of("HEARTBEAT", 100)[-1][1].system_status == 3
    for _ in range(25):
        link.step(is_healthy=False)
    assert link.of("HEARTBEAT", 100)[-1][1].system_status == 5


def test_without_a_camera_component_nothing_is_said_or_heard_as_one() -> None:
    link = Link(FOLLOW + "[ground]\ncamera_component=0\n")
    link.run(2.0)
    link.ordered = [mavlink.MAVLink_command_long_message(1, 100, 512, 0, 259, *[0.0] * 6)]
    link.run(1.0)
    assert {m.get_srcComponent() for _, m in link.heard} == {191}


def test_a_rectangle_from_the_ground_is_selected_and_acknowledged_when_it_is_tracked() -> None:
    link = Link()
    link.step()
    link.ordered = [mavlink.MAVLink_command_long_message(1, 100, 2005, 0, 0.25, 0.5, 0.375, 0.75, 0, 0, 0)]
    box = link.step().control.selection.box
    assert box is not None
    assert (box.x, box.y, box.w, box.h) == (160, 240, 80, 120)
    assert not link.of("COMMAND_ACK", 100)
    link.step()
    ((time_s, ack),) = link.of("COMMAND_ACK", 100)
    assert time_s == link.now_s
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (2005, 0, 255, 190)


def test_what_the_local_operator_selects_in_the_same_step_counts_more_than_a_click() -> None:
    link = Link()
    link.step()
    link.ordered = [mavlink.MAVLink_command_long_message(1, 100, 2005, 0, 0.25, 0.5, 0.375, 0.75, 0, 0, 0)]
    assert link.step(Select(AHEAD)).control.selection.box == AHEAD
    assert [m.result for _, m in link.of("COMMAND_ACK", 100)] == [4]


def test_telemetry_is_asked_for_with_the_first_heartbeat_and_not_again_while_it_comes() -> None:
    link = Link()
    link.is_there = False
    assert [(m.get_type(), m.get_srcComponent()) for m in link.run(2.0)] == [("HEARTBEAT", 191), ("HEARTBEAT", 100)] * 2
    link.is_there = True
    link.run(30.0)
    asked = [m for _, m in link.of("COMMAND_LONG")]
    assert [int(m.param1) for m in asked] == [*rates_hz(Autopilot.ARDUPILOT)]
    assert {m.command for m in asked} == {511}


@pytest.mark.parametrize("kind", ["RC_CHANNELS", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE"])
def test_what_does_not_come_at_all_is_asked_for_again(kind: str) -> None:
    link = Link()
    link.missing = kind
    link.run(21.0)
    assert [b - a for a, b in pairwise(link.asked_rates())] == pytest.approx([5.0] * 4, abs=0.11)
    assert not link.of("REQUEST_DATA_STREAM")


def test_a_rate_that_stays_low_is_asked_for_again_in_both_ways() -> None:
    link = Link()
    link.attitude_every = 5
    link.run(21.0)
    times_s = link.asked_rates()
    assert [b - a for a, b in pairwise(times_s)] == pytest.approx([5.0] * 4, abs=0.11)
    assert len(link.of("REQUEST_DATA_STREAM")) == 3  # not at the first time
    link.attitude_every = 1
    link.run(11.0)
    before = len(link.asked_rates())
    link.run(10.0)
    assert len(link.asked_rates()) == before


def test_after_a_reboot_everything_is_asked_for_again_and_nothing_is_followed() -> None:
    link = Link().engage()
    link.values = VALUES
    link.run(4.0)
    link.booted_k = link.k
    messages = link.run(2.0)
    assert len([m for m in messages if m.get_type() == "COMMAND_LONG" and m.command == 511]) == len(
        rates_hz(Autopilot.ARDUPILOT)
    )
    assert {m.param_id for m in messages if m.get_type() == "PARAM_REQUEST_READ"} == set(VALUES)
    assert not [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def test_parameters_are_asked_for_a_few_times_and_no_more() -> None:
    link = Link()
    link.run(30.0)
    times_s = [t for t, m in link.of("PARAM_REQUEST_READ") if m.param_id == "GUID_TIMEOUT"]
    assert [b - a for a, b in pairwise(times_s)] == pytest.approx([2.0] * 4, abs=0.051)


def test_what_the_parameters_mean_is_said_once_a_line_a_second() -> None:
    link = Link()
    link.values = VALUES
    link.run(10.0)
    lines = [step.texts for step in link.steps if step.texts]
    assert [len(texts) for texts in lines] == [1, 1]
    assert lines[0][0].text.startswith("GUID_TIMEOUT = 3")
    assert lines[1][0].text.startswith("FS_OPTIONS = 20")
    assert len([m for _, m in link.of("PARAM_REQUEST_READ")]) == 3


def test_the_configured_target_is_selected_with_the_first_frame() -> None:
    box = Link(FOLLOW + '[select]\nat_start="box"\nbox=[10, 20, 30, 40]\n').step().control.selection.box
    assert box is not None
    assert (box.x, box.y, box.w, box.h) == (10, 20, 30, 40)
    centre = Link(FOLLOW + '[select]\nat_start="centre"\n').step().control.selection.box
    assert centre is not None
    assert centre.center_xy == (320, 240)
    assert Link().step().control.selection.number == 0


def test_the_configured_target_is_selected_once() -> None:
    link = Link(FOLLOW + '[select]\nat_start="centre"\n')
    link.run(2.0)
    assert link.steps[-1].control.selection.number == 1


def test_before_the_first_frame_nothing_is_selected() -> None:
    follower = Follower(parse(FOLLOW + '[select]\nat_start="centre"\n'))
    assert follower.step(1.0, b"", None).control.selection.number == 0
    assert not follower.is_connected(1.0)
    assert follower.heartbeat is None


def test_setpoints_leave_in_every_step_while_engaged_and_never_before() -> None:
    link = Link().engage()
    link.run(2.0)
    times_s = [t for t, _ in link.of("SET_POSITION_TARGET_LOCAL_NED")]
    engaged_s = next(t for t, m in link.of("STATUSTEXT") if m.text.startswith("Following"))
    assert times_s[0] == engaged_s
    assert len(times_s) == 41
    boot_ms = [m.time_boot_ms for _, m in link.of("SET_POSITION_TARGET_LOCAL_NED")]
    assert boot_ms == sorted(set(boot_ms))


def test_a_request_for_a_mode_leaves_before_the_setpoint_of_its_step() -> None:
    """After a gap a stream alone would bring PX4 back to OFFBOARD."""
    link = Link().engage()
    at = len(link.heard)
    link.step(Disengage())
    kinds = [m.get_type() for _, m in link.heard[at:]]
    assert kinds.index("COMMAND_LONG") < kinds.index("SET_POSITION_TARGET_LOCAL_NED")


def test_farewell_stands_and_asks_to_hold() -> None:
    link = Link().engage()
    messages = mavlink.MAVLink(BytesIO()).parse_buffer(b"".join(link.follower.farewell(link.now_s))) or []
    setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert [(m.vx, m.vy, m.vz, m.yaw_rate) for m in setpoints] == [(0.0, 0.0, 0.0, 0.0)] * 3
    (request,) = [m for m in messages if m.get_type() == "COMMAND_LONG"]
    assert (request.command, request.param2) == (176, 17)
    assert "shutting down" in next(m.text for m in messages if m.get_type() == "STATUSTEXT")
    assert link.follower.farewell(link.now_s) == ()


def test_farewell_says_nothing_where_the_vehicle_is_not_ours() -> None:
    link = Link()
    link.step(Select(AHEAD))
    link.run(1.0)
    assert link.steps[-1].control.mode is Mode.TRACKING
    assert link.follower.farewell(link.now_s) == ()


def test_what_the_autopilot_says_is_handed_on_for_the_log() -> None:
    link = Link()
    link.step()
    sender = mavlink.MAVLink(BytesIO(), srcSystem=1, srcComponent=1)
    data = bytes(mavlink.MAVLink_statustext_message(2, b"Battery is low", 0, 0).pack(sender))
    (said,) = link.follower.step(link.now_s + 0.05, data, None).autopilot_texts
    assert (said.severity, said.text) == (2, "Battery is low")
    assert link.follower.is_connected(link.now_s)
    assert link.follower.heartbeat is not None


def test_what_an_edge_has_to_say_leaves_as_a_status_text_and_changes_nothing_else() -> None:
    link, said = Link().engage(), "Record stopped: disk full"
    link.run(2.0)
    link.k += 1
    notice = Text(Severity.WARNING, said)
    step = link.follower.step(link.now_s, b"", None, notices=(notice,))
    link._hear(step.data)
    assert step.texts == (notice,)
    assert [(m.severity, m.text) for _, m in link.of("STATUSTEXT")][-1] == (4, said)
    assert step.control.mode is Mode.FOLLOWING
    assert step.control.setpoint is not None
