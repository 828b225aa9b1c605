"""The gimbal protocol against an independent instance of pymavlink, which plays the manager and everybody else."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.config import GimbalConfig, parse
from companion.follower import Follower
from companion.gimbal import GimbalHistory
from companion.gimbal_protocol import (
    ASK_EVERY_S,
    EARTH_YAW,
    FROZEN_AFTER,
    HORIZON,
    MAX_SAME_S,
    VEHICLE_YAW,
    GimbalProtocol,
)
from companion.time_sync import BootClock
from companion.types import (
    Attitude,
    Autopilot,
    Claim,
    GimbalAim,
    GimbalAttitude,
    GimbalControl,
    GimbalManager,
    GimbalOrder,
    Holder,
    LinkEvent,
)
from companion.wire import Wire
from sim.eyes import TrueEyes
from sim.gimbal import Gimbal
from sim.scenarios import AUTOPILOTS, SCENARIOS, Act, fly
from sim.scenarios import Desk as Hands
from sim.stages import Stage

VEHICLE = 7  # its system id; neither 1 nor 255, which might be defaults
OURS = 191
DEVICE = 2
CAN_LOCK = mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
ENDLESS = mavlink.GIMBAL_MANAGER_CAP_FLAGS_SUPPORTS_INFINITE_YAW
IN_EARTH = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
IN_VEHICLE = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
NOTHING = GimbalOrder(None, None)


class Desk:
    """A protocol at one end of a wire, and whoever is wanted at the other."""

    def __init__(self, config: GimbalConfig | None = None) -> None:
        self.wire = Wire(VEHICLE)
        config = config if config is not None else GimbalConfig(axes="pitch_yaw")
        self.clock = BootClock()
        self.protocol = GimbalProtocol(self.wire.sender(OURS), config, self.clock)
        self._parser = mavlink.MAVLink(None)

    def hear(self, *messages: Any, system: int = VEHICLE, component: int = 1, now_s: float = 50.0) -> list[LinkEvent]:
        other = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        data = b"".join(bytes(message.pack(other)) for message in messages)
        return [*self.protocol.receive(self.wire.receive(data), now_s)]

    def told(self) -> list[Any]:
        """What we have sent since the last call."""
        return self._parser.parse_buffer(b"".join(self.wire.drain())) or []

    def send(
        self, order: GimbalOrder, *, autopilot: Autopilot | None = Autopilot.ARDUPILOT, now_s: float = 50.0
    ) -> list[Any]:
        self.protocol.send(order, autopilot, now_s)
        return self.told()


def information(
    device: int = DEVICE,
    flags: int = CAN_LOCK,
    pitch: tuple[float, float] = (-1.5, 0.5),
    yaw: tuple[float, float] = (-1, 2),
) -> Any:
    return mavlink.MAVLink_gimbal_manager_information_message(5000, flags, device, -0.5, 0.5, *pitch, *yaw)


def status(primary: tuple[int, int], device: int = DEVICE, flags: int = 0) -> Any:
    return mavlink.MAVLink_gimbal_manager_status_message(5000, flags, device, *primary, 0, 0)


def attitude(
    q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
    flags: int = IN_EARTH,
    device: int = DEVICE,
    boot_ms: int = 5000,
    rates_radps: tuple[float, float, float] = (math.nan, math.nan, math.nan),
) -> Any:
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, boot_ms, flags, q, *rates_radps, 0, gimbal_device_id=device
    )


def about(axis: int, angle_rad: float) -> tuple[float, ...]:
    """Quaternion of a turn about one axis: 0 forward, 1 right, 2 down."""
    return (math.cos(angle_rad / 2), *(math.sin(angle_rad / 2) * (k == axis) for k in range(3)))


def introduced(config: GimbalConfig | None = None, **kinds: Any) -> Desk:
    desk = Desk(config)
    desk.hear(information(**kinds))
    return desk


# ------------------------------------------------------------------------------------- messages -> events
@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (information(), GimbalManager((-1.5, 0.5), (-1.0, 2.0), can_lock_yaw=True)),
        (information(flags=0), GimbalManager((-1.5, 0.5), (-1.0, 2.0), can_lock_yaw=False)),
        (information(flags=ENDLESS), GimbalManager((-1.5, 0.5), None, can_lock_yaw=False)),
        (information(yaw=(-math.pi, math.pi)), GimbalManager((-1.5, 0.5), None, can_lock_yaw=True)),
        # a manager that says nothing of its ends, or nonsense
        (
            information(pitch=(0.0, 0.0), yaw=(math.nan, 1.0)),
            GimbalManager((-math.pi / 2, math.pi / 2), None, can_lock_yaw=True),
        ),
    ],
)
def test_the_manager_says_what_the_gimbal_can_do(message: Any, expected: GimbalManager) -> None:
    (event,) = Desk().hear(message)
    assert event == expected


@pytest.mark.parametrize(
    ("primary", "flags", "holder"),
    [
        ((0, 0), 0, Holder.NOBODY),
        ((VEHICLE, OURS), 0, Holder.US),
        ((VEHICLE, 190), 0, Holder.OTHER),  # another component of our own system
        ((255, OURS), 0, Holder.OTHER),
        ((255, 190), 0, Holder.OTHER),
        ((VEHICLE, OURS), mavlink.GIMBAL_MANAGER_FLAGS_RC_EXCLUSIVE, Holder.OTHER),  # the pilot's alone
        ((VEHICLE, OURS), mavlink.GIMBAL_MANAGER_FLAGS_RC_MIXED, Holder.US),
    ],
)
def test_the_manager_says_who_has_control(primary: tuple[int, int], flags: int, holder: Holder) -> None:
    assert introduced().hear(status(primary, flags=flags), now_s=60.0) == [GimbalControl(60.0, holder)]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle_rad", [-1.2, -0.3, 0.4, 1.5])
def test_a_turn_about_an_axis_is_an_angle_of_that_axis(axis: int, angle_rad: float) -> None:
    (event,) = introduced().hear(attitude(about(axis, angle_rad)))
    assert isinstance(event, GimbalAttitude)
    angles_rad = (event.roll_rad, event.pitch_rad, event.yaw_rad)
    assert angles_rad == pytest.approx([angle_rad * (k == axis) for k in range(3)], abs=1e-6)


@pytest.mark.parametrize(
    ("flags", "is_on_earth"),
    [
        (IN_EARTH, True),
        (IN_EARTH | LOCKED, True),
        (IN_VEHICLE, False),
        (IN_VEHICLE | LOCKED, False),  # as ArduPilot while it is locked
        (LOCKED, True),
        (0, False),
    ],
)
def test_the_flags_say_what_the_yaw_counts_from(flags: int, is_on_earth: bool) -> None:  # noqa: FBT001 - a table
    (event,) = introduced().hear(attitude(flags=flags))
    assert isinstance(event, GimbalAttitude)
    assert event.is_yaw_on_earth is is_on_earth


def test_an_attitude_is_as_old_as_its_time_since_boot_says() -> None:
    desk = introduced()
    desk.hear(attitude(boot_ms=5000), now_s=50.0)
    (late,) = desk.hear(attitude(boot_ms=5100), now_s=50.3)
    assert isinstance(late, GimbalAttitude)
    assert late.time_s == pytest.approx(50.1, abs=1e-3)


@pytest.mark.parametrize(("component", "device", "time_s"), [(1, DEVICE, 50.1), (154, 154, 50.3)])
def test_a_managers_attitude_is_of_the_autopilots_clock_and_a_devices_of_its_own(
    component: int, device: int, time_s: float
) -> None:
    desk = introduced(device=device)
    desk.clock.ours_s(5.0, 50.0)  # of another message, which was not late
    (late,) = desk.hear(attitude(device=device, boot_ms=5100), component=component, now_s=50.3)
    assert isinstance(late, GimbalAttitude)
    assert late.time_s == pytest.approx(time_s, abs=1e-3)


TO_THE_LEFT, TO_THE_RIGHT = about(2, -0.3), about(2, 0.3)


@pytest.mark.parametrize(("component", "device"), [(1, DEVICE), (154, 154)])
@pytest.mark.parametrize("boot_ms", [0, 5000])
def test_attitudes_whose_stamp_stands_still_are_of_the_time_at_which_they_are_read(
    component: int, device: int, boot_ms: int
) -> None:
    desk = introduced(device=device)
    desk.clock.ours_s(400.0, 49.9)  # the autopilot's own messages have another time
    turning = [attitude(about(2, 0.01 * k), device=device, boot_ms=boot_ms) for k in range(40)]
    told = [desk.hear(said, component=component, now_s=50.0 + 0.05 * k) for k, said in enumerate(turning)]
    known = [event.time_s for events in told[FROZEN_AFTER:] for event in events if isinstance(event, GimbalAttitude)]
    assert known == pytest.approx([50.0 + 0.05 * k for k in range(FROZEN_AFTER, 40)])


def is_known(history: GimbalHistory, now_s: float) -> bool:
    return history.at(now_s, Attitude(now_s, 0.0, 0.0, 0.0, 0.0)) is not None


@pytest.mark.parametrize(("component", "device"), [(1, DEVICE), (154, 154)])
@pytest.mark.parametrize("hung_ms", [5960, 0])
def test_telemetry_that_hangs_after_its_stamp_has_advanced_is_never_again_of_now(
    component: int, device: int, hung_ms: int
) -> None:
    desk, history, known = introduced(device=device), GimbalHistory(), []
    desk.clock.ours_s(5.0, 50.0)
    for k in range(25 * 60):
        now_s = 50.0 + 0.04 * k
        said = attitude(about(2, 0.01 * min(k, 25)), device=device, boot_ms=5000 + 40 * k if k < 25 else hung_ms)
        for event in desk.hear(said, component=component, now_s=now_s):
            assert isinstance(event, GimbalAttitude)
            history.add(event)
        known.append(is_known(history, now_s))
    assert all(known[:25])
    assert not any(known[28:])  # 0.1 s later


@pytest.mark.parametrize(("component", "device"), [(1, DEVICE), (154, 154)])
def test_a_clock_that_was_there_is_not_done_without_and_counts_again_when_it_goes_on(
    component: int, device: int
) -> None:
    desk = introduced(device=device)
    desk.clock.ours_s(5.0, 50.0)
    found = []
    for k, (boot_ms, now_s) in enumerate(
        [(5000, 50.0), (5040, 50.04), (0, 50.08), (5040, 50.12), (0, 55.0), (15000, 60.0)]
    ):
        said = attitude(about(2, 0.01 * k), device=device, boot_ms=boot_ms)
        found += desk.hear(said, component=component, now_s=now_s)
    times_s = [event.time_s for event in found if isinstance(event, GimbalAttitude)]
    assert times_s == pytest.approx([50.0, 50.04, 50.04, 60.0], abs=2e-3)


@pytest.mark.parametrize(
    "changed",
    [
        {"q": TO_THE_RIGHT},
        {"flags": IN_EARTH | LOCKED},
        {"rates_radps": (0.0, 0.01, 0.0)},
    ],
)
@pytest.mark.parametrize("boot_ms", [0, 5000])
def test_without_a_clock_what_is_repeated_to_the_bit_is_no_measurement_until_it_changes(
    boot_ms: int, changed: dict[str, Any]
) -> None:
    desk, same = introduced(), attitude(TO_THE_LEFT, boot_ms=boot_ms)
    for k in range(25 * 10):
        events = desk.hear(same, now_s=50.0 + 0.04 * k)
        if k > FROZEN_AFTER:
            assert not events
    (event,) = desk.hear(attitude(**{"q": TO_THE_LEFT, "boot_ms": boot_ms} | changed), now_s=60.0)
    assert isinstance(event, GimbalAttitude)
    assert event.time_s == 60.0


def test_without_a_clock_a_repetition_counts_for_a_fifth_of_a_second() -> None:
    desk = introduced()
    for age_s, count in ((0.0, 1), (MAX_SAME_S - 0.01, 1), (MAX_SAME_S + 0.01, 0), (60.0, 0)):
        assert len(desk.hear(attitude(boot_ms=0), now_s=50.0 + age_s)) == count


def test_of_two_that_tell_of_one_gimbal_the_one_that_hangs_is_not_hidden_by_the_other() -> None:
    desk = introduced()
    desk.clock.ours_s(5.0, 50.0)
    for k in range(2):
        assert len(desk.hear(attitude(boot_ms=5000 + 40 * k), now_s=50.0 + 0.04 * k)) == 1
    for k in range(2, 100):
        now_s = 50.0 + 0.04 * k
        assert desk.hear(attitude(boot_ms=5040), now_s=now_s) == []
        assert len(desk.hear(attitude(about(2, 0.01 * k), boot_ms=0), component=154, now_s=now_s)) == 1


class HangingGimbal(Gimbal):
    """Trembles as every one does that measures; once it hangs it says the same for ever, whatever it does.

    stamp_ms : the `time_boot_ms` of one without a clock; None: it has one.
    """

    def __init__(self, place: Stage, stamp_ms: int | None) -> None:
        super().__init__(place.camera.mount_pitch_rad, place.start.yaw_rad)
        self.is_hung = False
        self._stamp_ms = stamp_ms
        self._last: Any = None
        self._tremble_rad = 1e-4

    def attitude(self, boot_ms: int, *, is_px4: bool) -> Any:
        if self.is_hung:
            return self._last
        self._tremble_rad *= -1
        self.pitch_rad += self._tremble_rad
        self._last = super().attitude(boot_ms if self._stamp_ms is None else self._stamp_ms, is_px4=is_px4)
        return self._last


HANGS_S = 9.0


def _hang(hands: Hands) -> None:
    gimbal = hands.autopilot.gimbal
    assert isinstance(gimbal, HangingGimbal)
    gimbal.is_hung = True


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("stamp_ms", [None, 0, 5000])
def test_a_vehicle_whose_gimbals_telemetry_hangs_holds_within_a_second_and_moves_no_more(
    autopilot: str, stamp_ms: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.loop.gimbal_of", lambda place: HangingGimbal(place, stamp_ms))
    acts = (Act(HANGS_S, "the gimbal's telemetry hangs", _hang),)
    passing = replace(SCENARIOS["gimbal"], follow="follow", engage_s=4.0, acts=acts, duration_s=20.0)
    trace, _ = fly(passing, autopilot, TrueEyes)
    moving = trace.between(HANGS_S - 0.5, HANGS_S)
    assert {moment.mode for moment in moving} == {"following"}
    assert math.hypot(*(moving[-1].setpoint_ned_mps or ())) > 1.0
    after = trace.between(HANGS_S + 1.0)
    assert {(moment.mode, moment.setpoint_ned_mps, moment.yaw_rate_radps) for moment in after} == {
        ("holding", (0.0, 0.0, 0.0), 0.0)
    }


def test_a_stamp_of_nothing_needs_no_second_to_be_known_for_one() -> None:
    (event,) = introduced().hear(attitude(boot_ms=0), now_s=50.0)
    assert isinstance(event, GimbalAttitude)
    assert event.time_s == 50.0


def test_of_attitudes_without_a_stamp_that_are_read_together_the_last_one_counts() -> None:
    desk = introduced()
    both = attitude(TO_THE_LEFT, boot_ms=0), attitude(TO_THE_RIGHT, boot_ms=0)
    (event,) = desk.hear(*both, now_s=50.0)
    assert isinstance(event, GimbalAttitude)
    assert event.yaw_rad == pytest.approx(0.3)


def test_an_attitude_that_comes_twice_is_no_newer_than_the_first() -> None:
    desk = introduced()
    desk.hear(attitude(boot_ms=5000), now_s=50.0)
    (again,) = desk.hear(attitude(boot_ms=5000), now_s=50.9)  # by another way
    assert isinstance(again, GimbalAttitude)
    assert again.time_s == pytest.approx(50.0, abs=1e-3)


@pytest.mark.parametrize(("component", "device"), [(1, DEVICE), (154, 154)])
def test_a_stamp_that_begins_to_advance_counts_again(component: int, device: int) -> None:
    desk = introduced(device=device)
    desk.clock.ours_s(5.0, 50.0)
    for k in range(20):
        desk.hear(attitude(device=device, boot_ms=6000), component=component, now_s=51.0 + 0.05 * k)
    desk.hear(attitude(device=device, boot_ms=7000), component=component, now_s=52.0)
    (late,) = desk.hear(attitude(device=device, boot_ms=7050), component=component, now_s=52.2)
    assert isinstance(late, GimbalAttitude)
    assert late.time_s == pytest.approx(52.05, abs=1e-3)


def test_a_stamp_that_stands_still_says_nothing_of_the_autopilots_clock() -> None:
    desk = introduced()
    before_s = desk.clock.ours_s(400.0, 50.0)
    for k in range(20):
        desk.hear(attitude(boot_ms=0), now_s=50.0 + 0.05 * k)
    assert desk.clock.ours_s(401.0, 51.2) == pytest.approx(before_s + 1.0, abs=1e-3)


@pytest.mark.parametrize(
    "message",
    [
        attitude((math.nan, 0.0, 0.0, 0.0)),
        attitude((0.0, 0.0, 0.0, 0.0)),
        attitude((math.inf, 0.0, 0.0, 0.0)),
        attitude(device=DEVICE + 1),
        status((0, 0), device=DEVICE + 1),
    ],
)
def test_nonsense_and_other_gimbals_are_no_event(message: Any) -> None:
    assert introduced().hear(message) == []


def test_a_gimbal_with_a_component_of_its_own_tells_by_that_which_it_is() -> None:
    desk = introduced(device=154)
    assert len(desk.hear(attitude(device=0), component=154)) == 1
    assert desk.hear(attitude(device=0), component=155) == []


def test_another_vehicles_gimbal_and_one_that_no_manager_has_named_are_not_heard() -> None:
    assert Desk().hear(attitude(), status((0, 0))) == []
    desk = introduced()
    assert desk.hear(information(), attitude(), status((0, 0)), system=VEHICLE + 1) == []
    assert desk.hear(information(), status((0, 0)), component=100) == []  # one manager, the first


def test_the_configured_gimbal_is_the_one_that_counts() -> None:
    desk = Desk(GimbalConfig(axes="pitch_yaw", device_id=3))
    assert desk.hear(information(device=2)) == []
    assert len(desk.hear(information(device=3), attitude(device=3))) == 2


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 255), min_size=40, max_size=40), st.sampled_from([280, 281, 285]))
def test_no_message_makes_it_raise(payload: list[int], number: int) -> None:
    desk = introduced()
    kind = mavlink.mavlink_map[number]
    message = mavlink.MAVLink(None).decode(bytearray(_framed(kind, bytes(payload))))
    desk.protocol.receive([message], 50.0)


def _framed(kind: Any, payload: bytes) -> bytes:
    """A MAVLink 2 frame of any payload, from the vehicle's autopilot."""
    payload = payload[: kind.unpacker.size]
    number = kind.id
    body = bytes([len(payload), 0, 0, 0, VEHICLE, 1, number & 255, number >> 8 & 255, 0]) + payload
    crc = mavlink.x25crc(body)
    crc.accumulate(bytes([kind.crc_extra]))
    return bytes([0xFD]) + body + crc.crc.to_bytes(2, "little")


# ------------------------------------------------------------------------------------- orders -> messages
EARTH = GimbalAim(-0.5, 1.2, is_yaw_on_earth=True)
NOSE = GimbalAim(-0.5, 0.3, is_yaw_on_earth=False)


@pytest.mark.parametrize(("aim", "flags"), [(EARTH, HORIZON | EARTH_YAW), (NOSE, HORIZON | VEHICLE_YAW)])
def test_ardupilot_is_told_angles_and_no_rates(aim: GimbalAim, flags: int) -> None:
    (message,) = (m for m in introduced().send(GimbalOrder(None, aim)) if m.get_type().startswith("GIMBAL"))
    assert message.get_type() == "GIMBAL_MANAGER_SET_PITCHYAW"
    assert (message.target_system, message.target_component, message.gimbal_device_id) == (VEHICLE, 1, 0)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (VEHICLE, OURS)
    assert (message.pitch, message.yaw) == pytest.approx((aim.pitch_rad, aim.yaw_rad))
    assert math.isnan(message.pitch_rate)
    assert math.isnan(message.yaw_rate)
    assert message.flags == flags


@pytest.mark.parametrize(("aim", "flags"), [(EARTH, HORIZON | EARTH_YAW), (NOSE, HORIZON | VEHICLE_YAW)])
def test_px4_is_told_an_attitude_which_is_all_that_it_reads(aim: GimbalAim, flags: int) -> None:
    sent = introduced().send(GimbalOrder(None, aim), autopilot=Autopilot.PX4)
    (message,) = (m for m in sent if m.get_type().startswith("GIMBAL"))
    assert message.get_type() == "GIMBAL_MANAGER_SET_ATTITUDE"
    w, x, y, z = message.q
    forward = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    flat = math.cos(aim.pitch_rad)
    wanted = (flat * math.cos(aim.yaw_rad), flat * math.sin(aim.yaw_rad), -math.sin(aim.pitch_rad))
    np.testing.assert_allclose(forward, wanted, atol=1e-6)
    assert 2 * (y * z + w * x) == pytest.approx(0.0, abs=1e-6)  # no roll
    assert all(math.isnan(getattr(message, f"angular_velocity_{axis}")) for axis in "xyz")
    assert message.flags == flags


@pytest.mark.parametrize(("claim", "wanted"), [(Claim.TAKE, (VEHICLE, OURS)), (Claim.RELEASE, (-3, -3))])
def test_control_is_asked_for_and_given_up_without_touching_the_secondary(
    claim: Claim, wanted: tuple[int, int]
) -> None:
    sent = introduced(GimbalConfig(axes="pitch", device_id=DEVICE)).send(GimbalOrder(claim, None))
    (command,) = (m for m in sent if m.command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE)
    assert (command.param1, command.param2) == wanted
    assert (command.param3, command.param4) == (-1, -1)
    assert command.param7 == DEVICE
    assert (command.target_system, command.target_component) == (VEHICLE, 1)


def test_at_the_end_control_is_given_up_where_we_have_it() -> None:
    desk = introduced()
    for primary, count in (((0, 0), 0), ((255, 190), 0), ((VEHICLE, OURS), 1)):
        desk.hear(status(primary))
        desk.protocol.release()
        assert [m.param1 for m in desk.told()] == [-3.0] * count


def asked(desk: Desk, now_s: float) -> list[int]:
    """Messages that are asked for."""
    return [round(m.param1) for m in desk.send(NOTHING, now_s=now_s)]


def test_what_does_not_come_is_asked_for_again_and_what_comes_is_not() -> None:
    desk = Desk()
    assert asked(desk, 50.0) == [280, 281, 285]
    assert asked(desk, 50.1) == []
    assert asked(desk, 50.0 + ASK_EVERY_S) == [280, 281, 285]
    desk.hear(information())
    for k in range(60):
        desk.hear(attitude(boot_ms=5000 + 33 * k))
    assert asked(desk, 50.0 + 2 * ASK_EVERY_S) == [281]
    for _ in range(10):
        desk.hear(status((0, 0)))
    assert asked(desk, 50.0 + 3 * ASK_EVERY_S) == [285]


def test_nothing_is_sent_before_an_autopilot_is_there_nor_aimed_before_a_manager_is() -> None:
    assert introduced().send(GimbalOrder(Claim.TAKE, EARTH), autopilot=None) == []
    assert not any(m.get_type().startswith("GIMBAL") for m in Desk().send(GimbalOrder(None, EARTH)))


def test_without_a_gimbal_in_the_configuration_it_is_deaf_and_silent() -> None:
    desk = Desk(GimbalConfig())
    assert desk.hear(information(), status((VEHICLE, OURS)), attitude()) == []
    assert desk.send(GimbalOrder(Claim.TAKE, EARTH)) == []
    desk.protocol.release()
    assert desk.told() == []


def test_the_application_gives_the_gimbal_up_when_it_ends() -> None:
    follower = Follower(parse('[camera]\nfocal_px=500\n[gimbal]\naxes="pitch_yaw"\n'))
    other = mavlink.MAVLink(None, srcSystem=VEHICLE, srcComponent=1)
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)
    data = b"".join(bytes(m.pack(other)) for m in (heartbeat, information(), status((VEHICLE, OURS))))
    follower.step(50.0, data, None)
    messages = mavlink.MAVLink(None).parse_buffer(b"".join(follower.farewell(50.1))) or []
    assert [m.param1 for m in messages if m.get_type() == "COMMAND_LONG"] == [-3.0]


def test_a_manager_that_is_not_the_autopilot_says_nothing_of_the_autopilots_clock() -> None:
    desk = Desk()
    desk.hear(information(), component=154)
    before_s = desk.clock.ours_s(5.0, 50.0)
    (event,) = desk.hear(attitude(boot_ms=900_000), component=154, now_s=50.0)
    assert isinstance(event, GimbalAttitude)
    assert event.time_s == 50.0
    assert desk.clock.ours_s(5.0, 50.0) == before_s
    assert not desk.clock.has_gone_back(5.0)


def test_an_attitude_from_before_the_autopilot_began_anew_leaves_its_clock_and_means_nothing() -> None:
    desk = Desk()
    desk.hear(information())
    desk.clock.ours_s(100.0, 50.0)
    assert desk.hear(attitude(boot_ms=5000), now_s=50.1) == []
    assert desk.clock.has_gone_back(5.0)  # which the codec has still to see


def test_of_several_gimbals_the_first_one_steers() -> None:
    desk = Desk()
    desk.hear(information(1), information(2))
    assert len(desk.hear(attitude(device=1))) == 1
    assert desk.hear(attitude(device=2)) == []
