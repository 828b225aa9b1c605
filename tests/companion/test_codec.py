"""The codec against an independent instance of pymavlink, which plays the autopilot and everybody else."""

import math
import random
import struct
from io import BytesIO
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.codec import MavlinkCodec, rates_hz
from companion.config import LimitsConfig
from companion.safety import Place, SafeSetpoint, limit, stop
from companion.types import (
    Attitude,
    Autopilot,
    AutopilotText,
    Battery,
    Direction,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LinkEvent,
    LocalState,
    ModeAnswer,
    Parameter,
    RangeReading,
    RcChannels,
    Rebooted,
    Setpoint,
    SetpointInForce,
    Severity,
    Text,
)
from companion.wire import Wire

COPTER, PX4, NOBODY = 3, 12, 8
VEHICLE = 7  # its system id; neither 1 nor 255, which might be defaults
GUIDED, OFFBOARD = 4, 6 << 16


def heartbeat(autopilot: int = COPTER, mode: int = GUIDED, base: int = 0x81, status: int = 4, kind: int = 2) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, base, mode, status, 3)


def attitude(boot_ms: int = 5000, yaw_rad: float = 0.5) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms, 0.1, -0.2, yaw_rad, 0.0, 0.0, 0.25)


def rc_channels(*pwm_us: int) -> Any:
    return mavlink.MAVLink_rc_channels_message(5000, len(pwm_us), *(*pwm_us, *[65535] * 18)[:18], 200)


def range_of(orientation: int, distance_cm: int) -> Any:
    return mavlink.MAVLink_distance_sensor_message(5000, 20, 4000, distance_cm, 0, 0, orientation, 255)


def sys_status(remaining_pct: int) -> Any:
    return mavlink.MAVLink_sys_status_message(0, 0, 0, 300, 15_000, 1500, remaining_pct, 0, 0, 0, 0, 0, 0)


def in_force(*velocity_ned_mps: float) -> Any:
    return mavlink.MAVLink_position_target_local_ned_message(
        5000, 1, 1479, *[0.0] * 3, *velocity_ned_mps, *[0.0] * 4, 0.0
    )


def mode_answer(result: int) -> Any:
    return mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, result)


class Sender:
    """A component on the link."""

    def __init__(self, system: int = VEHICLE, component: int = 1) -> None:
        self._link = mavlink.MAVLink(BytesIO(), srcSystem=system, srcComponent=component)

    def __call__(self, *messages: Any) -> bytes:
        return b"".join(bytes(message.pack(self._link)) for message in messages)


def parsed(data: bytes) -> list[Any]:
    return mavlink.MAVLink(BytesIO()).parse_buffer(data) or []


class Ours(MavlinkCodec):
    """A codec with a wire of its own: bytes in, bytes out."""

    def __init__(self, system_id: int = 0, **options: Any) -> None:
        self.wire = Wire(system_id or 1)
        super().__init__(self.wire, system_id, **options)

    def hear(self, data: bytes, now_s: float) -> list[LinkEvent]:
        return self.receive(self.wire.receive(data), now_s)

    def drain(self) -> bytes:
        return b"".join(self.wire.drain())


def paired(autopilot: int = COPTER, **options: Any) -> tuple[Ours, Sender]:
    """A codec that knows its autopilot."""
    codec, sender = Ours(**options), Sender()
    codec.hear(sender(heartbeat(autopilot)), 100.0)
    return codec, sender


def moving(north: float, east: float, down: float, yaw_rate_radps: float) -> SafeSetpoint:
    """A setpoint that the limiter lets pass, after as many steps as it takes."""
    safe = stop()
    for _ in range(100):
        wish = Setpoint((north, east, down), yaw_rate_radps)
        safe = limit(wish, safe, Place(20.0, (0.0, 0.0)), LimitsConfig(), 0.2)
    return safe


# ----------------------------------------------------------------------------------------- bytes to events
BEAT = Heartbeat(100.0, Autopilot.ARDUPILOT, is_multicopter=True, mode=FlightMode.EXTERNAL, mode_name="GUIDED",
                 is_armed=True, has_failsafe=False)  # fmt: skip
EVENTS: list[tuple[Any, list[LinkEvent]]] = [
    (heartbeat(), [BEAT]),
    (
        heartbeat(mode=6, base=1, status=5, kind=1),
        [Heartbeat(100.0, Autopilot.ARDUPILOT, False, FlightMode.RTL, "RTL", False, True)],  # noqa: FBT003
    ),
    (heartbeat(status=6), [Heartbeat(100.0, Autopilot.ARDUPILOT, True, FlightMode.EXTERNAL, "GUIDED", True, True)]),  # noqa: FBT003
    (mavlink.MAVLink_attitude_message(5000, 0.5, -0.25, 2.0, 9, 9, 0.125), [Attitude(100.0, 0.5, -0.25, 2.0, 0.125)]),
    (mavlink.MAVLink_attitude_message(5000, math.nan, 0, 0, 0, 0, 0), []),
    (mavlink.MAVLink_attitude_message(5000, 0, 0, 0, 0, 0, math.inf), []),
    (
        mavlink.MAVLink_local_position_ned_message(5000, 1, 2, -3, 4, 5, -6),
        [LocalState(100.0, (1, 2, -3), (4, 5, -6))],
    ),
    (mavlink.MAVLink_local_position_ned_message(5000, 1, 2, -3, 4, math.nan, -6), []),
    (
        mavlink.MAVLink_global_position_int_message(5000, 471_000_000, -82_500_000, 480_000, -12_500, 0, 0, 0, 0),
        [HeightReading(100.0, -12.5), GlobalPosition(100.0, 47.1, -8.25, 480.0)],
    ),
    (
        mavlink.MAVLink_global_position_int_message(5000, 0, 0, 480_000, -12_500, 0, 0, 0, 0),
        [HeightReading(100.0, -12.5)],
    ),
    (mavlink.MAVLink_extended_sys_state_message(0, 2), [LandedReading(100.0, Landed.IN_AIR)]),
    (mavlink.MAVLink_extended_sys_state_message(0, 1), [LandedReading(100.0, Landed.ON_GROUND)]),
    (mavlink.MAVLink_extended_sys_state_message(0, 77), [LandedReading(100.0, Landed.UNKNOWN)]),
    (range_of(0, 1234), [RangeReading(100.0, Direction.FORWARD, 12.34)]),
    (range_of(25, 1234), [RangeReading(100.0, Direction.DOWN, 12.34)]),
    (range_of(2, 1234), []),  # to the side
    (range_of(0, 20), []),  # at its own limits it sees nothing
    (range_of(0, 4000), []),
    (rc_channels(1500, 1400, 65535), [RcChannels(100.0, (1500, 1400, 0))]),
    (rc_channels(), [RcChannels(100.0, ())]),
    (sys_status(62), [Battery(62)]),
    (sys_status(-1), []),
    (in_force(1.5, -0.5, 0.0), [SetpointInForce(100.0, (1.5, -0.5, 0.0))]),
    (in_force(0.0, math.nan, 0.0), []),
    (mode_answer(0), [ModeAnswer(is_accepted=True)]),
    (mode_answer(1), [ModeAnswer(is_accepted=False)]),
    (mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0), []),
    (mavlink.MAVLink_statustext_message(4, b"GPS glitch", 0, 0), [AutopilotText(4, "GPS glitch")]),
    (mavlink.MAVLink_param_value_message(b"GUID_TIMEOUT", 3.0, 9, 1, 0), [Parameter("GUID_TIMEOUT", 3.0)]),
    (mavlink.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, 6, 1, 0), [Parameter("FS_OPTIONS", 16.0)]),
    (mavlink.MAVLink_param_value_message(b"BAD", math.nan, 9, 1, 0), []),
    (mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0), []),
]
IDS = [f"{k}-{message.get_type()}" for k, (message, _) in enumerate(EVENTS)]


@pytest.mark.parametrize(("message", "events"), EVENTS, ids=IDS)
def test_a_message_becomes_its_event(message: Any, events: list[LinkEvent]) -> None:
    codec, sender = paired()
    assert codec.hear(sender(message), 100.0) == pytest.approx(events)


@pytest.mark.parametrize(("message", "events"), EVENTS, ids=IDS)
def test_a_message_byte_by_byte_amid_garbage_becomes_the_same_event(message: Any, events: list[LinkEvent]) -> None:
    codec, sender = paired()
    data = b"\x00\x55garbage" + sender(message) + b"\x00more"
    heard = [event for byte in data for event in codec.hear(bytes([byte]), 100.0)]
    assert heard == pytest.approx(events)


@pytest.mark.parametrize("value", [0, 1, 3, 5, -1, 2**24 + 1, -(2**31)])
def test_whole_parameters_of_px4_are_read_byte_by_byte(value: int) -> None:
    codec, sender = paired(PX4)
    (carried,) = struct.unpack("<f", struct.pack("<i", value))
    message = mavlink.MAVLink_param_value_message(b"COM_RC_OVERRIDE", carried, mavlink.MAV_PARAM_TYPE_INT32, 1, 0)
    assert codec.hear(sender(message), 100.0) == [Parameter("COM_RC_OVERRIDE", value)]


def test_real_parameters_of_px4_are_read_as_they_are() -> None:
    codec, sender = paired(PX4)
    message = mavlink.MAVLink_param_value_message(b"COM_OF_LOSS_T", 1.5, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)
    assert codec.hear(sender(message), 100.0) == [Parameter("COM_OF_LOSS_T", 1.5)]


# --------------------------------------------------------------------------------------- who is listened to
def test_nothing_is_believed_before_an_autopilots_heartbeat() -> None:
    codec, sender = Ours(), Sender()
    assert codec.hear(sender(attitude(), mavlink.MAVLink_extended_sys_state_message(0, 2)), 100.0) == []
    assert codec.autopilot is None


@pytest.mark.parametrize("autopilot", [NOBODY, 0, 4])
def test_a_ground_station_a_camera_or_another_kind_is_no_autopilot(autopilot: int) -> None:
    codec = Ours()
    assert codec.hear(Sender(255, 190)(heartbeat(autopilot, kind=6)), 100.0) == []
    assert codec.hear(Sender(VEHICLE, 1)(heartbeat(autopilot)), 100.0) == []
    assert codec.autopilot is None


def test_an_autopilot_is_known_by_its_heartbeat_not_by_its_component() -> None:
    codec, sender = Ours(), Sender(VEHICLE, 42)
    assert len(codec.hear(sender(heartbeat(PX4, OFFBOARD)), 100.0)) == 1
    codec.send_mode_request(FlightMode.HOLD)
    (message,) = parsed(codec.drain())
    assert (message.target_system, message.target_component) == (VEHICLE, 42)


def test_a_ground_stations_heartbeat_keeps_no_vehicle_alive() -> None:
    codec, _ = paired()
    station = Sender(255, 190)
    assert codec.hear(station(heartbeat(NOBODY, kind=6), heartbeat(COPTER)), 101.0) == []


def test_the_first_of_two_vehicles_is_ours_for_good() -> None:
    codec, first = paired()
    second = Sender(VEHICLE + 1)
    data = second(heartbeat(PX4, OFFBOARD), attitude(), rc_channels(2000), mode_answer(0))
    assert codec.hear(data, 101.0) == []
    assert codec.autopilot is Autopilot.ARDUPILOT
    assert len(codec.hear(first(heartbeat(), attitude()), 101.0)) == 2
    codec.send_setpoint(stop(), 101.0)
    assert parsed(codec.drain())[0].target_system == VEHICLE


def test_a_configured_vehicle_is_waited_for() -> None:
    codec = Ours(system_id=9)
    assert codec.hear(Sender(VEHICLE)(heartbeat(), attitude()), 100.0) == []
    assert len(codec.hear(Sender(9)(heartbeat(), attitude()), 100.0)) == 2


def test_a_second_autopilot_in_the_same_vehicle_is_not_listened_to() -> None:
    codec, _ = paired()
    assert codec.hear(Sender(VEHICLE, 2)(heartbeat(mode=5), attitude()), 100.0) == []


# ------------------------------------------------------------------------------------------------- its clock
def test_times_are_those_of_the_boot_clock_whatever_the_delay_of_each_message() -> None:
    """Delays of up to 0.2 s with a shortest one of 10 ms, which counts as none."""
    codec, sender = paired()
    delays_s = random.Random(3)  # noqa: S311
    for k in range(500):
        taken_s = 0.02 * k
        delay_s = 0.01 if k % 50 == 0 else delays_s.uniform(0.01, 0.2)
        (event,) = codec.hear(sender(attitude(5000 + round(1000 * taken_s))), 100.0 + taken_s + delay_s)
        assert isinstance(event, Attitude)
        assert event.time_s == pytest.approx(100.01 + taken_s, abs=0.0011 if k else 1e-9)


def test_a_delay_that_grows_does_not_move_the_clock() -> None:
    codec, sender = paired()
    codec.hear(sender(attitude(5000)), 100.0)
    (event,) = codec.hear(sender(attitude(6000)), 101.3)
    assert isinstance(event, Attitude)
    assert event.time_s == pytest.approx(101.0, abs=1e-3)


def test_no_event_is_from_the_future() -> None:
    codec, sender = paired()
    for boot_ms, arrival_s in ((5000, 100.0), (5500, 100.1), (5600, 100.9), (5500, 100.95)):
        (event,) = codec.hear(sender(attitude(boot_ms)), arrival_s)
        assert isinstance(event, Attitude)
        assert event.time_s <= arrival_s


def test_a_clock_that_goes_back_is_a_reboot_and_begins_anew() -> None:
    codec, sender = paired()
    codec.hear(sender(attitude(500_000)), 100.0)
    rebooted, event = codec.hear(sender(attitude(1_000)), 110.0)
    assert rebooted == Rebooted(110.0)
    assert isinstance(event, Attitude)
    assert event.time_s == 110.0


def test_messages_out_of_order_are_no_reboot() -> None:
    codec, sender = paired()
    events = codec.hear(sender(attitude(9_900), attitude(9_000), attitude(9_950)), 100.0)
    assert not any(isinstance(event, Rebooted) for event in events)


def test_our_own_echo_means_nothing() -> None:
    codec, _ = paired()
    codec.send_heartbeat(is_active=True, is_healthy=True)
    codec.send_setpoint(stop(), 100.0)
    codec.send_mode_request(FlightMode.HOLD)
    codec.send_text(Text(Severity.INFO, "echo"))
    assert codec.hear(codec.drain(), 100.0) == []
    assert codec.drain() == b""


# ----------------------------------------------------------------------------------------- events to bytes
@pytest.mark.parametrize("autopilot", [COPTER, PX4])
def test_a_setpoint_says_velocity_and_yaw_rate_and_nothing_else(autopilot: int) -> None:
    codec, _ = paired(autopilot)
    codec.send_setpoint(moving(1.5, -0.5, 0.25, 0.5), 12.3456)
    (message,) = parsed(codec.drain())
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.get_srcSystem(), message.get_srcComponent()) == (VEHICLE, 191)
    assert (message.target_system, message.target_component) == (VEHICLE, 1)
    assert (message.type_mask, message.coordinate_frame, message.time_boot_ms) == (0x5C7, 1, 12345)
    assert (message.vx, message.vy, message.vz, message.yaw_rate) == pytest.approx((1.5, -0.5, 0.25, 0.5))
    assert [getattr(message, name) for name in ("x", "y", "z", "afx", "afy", "afz", "yaw")] == [0.0] * 7


@pytest.mark.parametrize(
    ("yaw_deg", "forward", "right"), [(0, 1, 2), (90, 2, -1), (180, -1, -2), (-90, -2, 1), (45, 2.1213, 0.7071)]
)
def test_in_the_body_frame_a_velocity_is_turned_by_the_heading(yaw_deg: float, forward: float, right: float) -> None:
    codec, sender = paired(setpoint_frame="body_ned")
    codec.hear(sender(attitude(yaw_rad=math.radians(yaw_deg))), 100.0)
    codec.send_setpoint(moving(1.0, 2.0, 0.5, 0.25), 100.0)
    (message,) = parsed(codec.drain())
    assert message.coordinate_frame == 8
    assert (message.vx, message.vy, message.vz, message.yaw_rate) == pytest.approx(
        (forward, right, 0.5, 0.25), abs=1e-4
    )


def test_no_setpoint_is_sent_to_nobody_nor_in_the_body_frame_without_a_heading() -> None:
    alone, blind = Ours(), paired(setpoint_frame="body_ned")[0]
    for codec in (alone, blind):
        codec.drain()
        codec.send_setpoint(stop(), 100.0)
        assert codec.drain() == b""


@pytest.mark.parametrize(
    ("autopilot", "mode", "numbers"),
    [
        (COPTER, FlightMode.HOLD, (1, 17, 0)),
        (COPTER, FlightMode.PILOT, (1, 5, 0)),
        (COPTER, FlightMode.RTL, (1, 6, 0)),
        (COPTER, FlightMode.LAND, (1, 9, 0)),
        (PX4, FlightMode.HOLD, (1, 4, 3)),
        (PX4, FlightMode.PILOT, (1, 3, 0)),
        (PX4, FlightMode.RTL, (1, 4, 5)),
        (PX4, FlightMode.LAND, (1, 4, 6)),
    ],
)
def test_a_mode_is_asked_for_by_do_set_mode(autopilot: int, mode: FlightMode, numbers: tuple[int, ...]) -> None:
    codec, _ = paired(autopilot)
    codec.send_mode_request(mode)
    (message,) = parsed(codec.drain())
    assert (message.get_type(), message.command, message.confirmation) == ("COMMAND_LONG", 176, 0)
    assert (message.target_system, message.target_component) == (VEHICLE, 1)
    assert (message.param1, message.param2, message.param3) == numbers


@pytest.mark.parametrize("mode", [FlightMode.EXTERNAL, FlightMode.OTHER])
def test_the_mode_in_which_we_are_obeyed_cannot_be_asked_for(mode: FlightMode) -> None:
    codec, _ = paired()
    with pytest.raises(ValueError, match=mode.name):
        codec.send_mode_request(mode)


def test_every_wanted_message_is_asked_for_at_its_interval() -> None:
    codec, _ = paired()
    codec.send_rate_requests()
    asked = {int(message.param1): message.param2 for message in parsed(codec.drain())}
    assert asked == pytest.approx({number: 1e6 / hz for number, hz in rates_hz(codec.autopilot).items()})
    assert (asked[30], asked[32], asked[65]) == (20_000, 50_000, 100_000)


@pytest.mark.parametrize(
    ("is_active", "is_healthy", "status"), [(False, True, 3), (True, True, 4), (True, False, 5), (False, False, 5)]
)
def test_our_heartbeat_is_that_of_an_onboard_computer_and_honest(
    is_active: bool,  # noqa: FBT001
    is_healthy: bool,  # noqa: FBT001
    status: int,
) -> None:
    codec, _ = paired()
    codec.send_heartbeat(is_active=is_active, is_healthy=is_healthy)
    (message,) = parsed(codec.drain())
    assert (message.type, message.autopilot, message.system_status) == (18, 8, status)


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 100, 101, 150])
def test_a_text_arrives_whole_and_its_last_chunk_is_known_by_its_end(length: int) -> None:
    codec, _ = paired()
    text = ("0123456789" * 15)[:length]
    codec.send_text(Text(Severity.ERROR, text))
    chunks = parsed(codec.drain())
    assert "".join(chunk.text for chunk in chunks) == text
    assert [chunk.chunk_seq for chunk in chunks] == [*range(len(chunks))]
    assert {chunk.severity for chunk in chunks} == {3}
    assert {chunk.id > 0 for chunk in chunks} == {length > 50}
    assert len(chunks) == 1 or len(chunks[-1].text) < 50


def test_two_long_texts_do_not_share_an_id_and_odd_characters_do_no_harm() -> None:
    codec, _ = paired()
    for _ in range(2):
        codec.send_text(Text(Severity.INFO, "Ü" * 60))
    chunks = parsed(codec.drain())
    assert len({chunk.id for chunk in chunks}) == 2
    assert chunks[0].text == "?" * 50


def test_sequence_numbers_count_all_that_is_sent() -> None:
    codec, _ = paired()
    codec.drain()
    for k in range(300):
        codec.send_setpoint(stop(), float(k))
    numbers = [message.get_seq() for message in parsed(codec.drain())]
    assert all((b - a) % 256 == 1 for a, b in pairwise(numbers))


def test_nothing_but_heartbeat_and_texts_leaves_before_an_autopilot_is_there() -> None:
    codec = Ours()
    codec.send_mode_request(FlightMode.HOLD)
    codec.send_rate_requests()
    codec.send_stream_request()
    codec.send_parameter_request("GUID_TIMEOUT")
    assert codec.drain() == b""


# ------------------------------------------------------------------------------------------------ garbage
def _framed(number: int, payload: bytes) -> bytes:
    """A frame with a right checksum around any payload."""
    header = bytes([len(payload), 0, 0, 0, VEHICLE, 1]) + number.to_bytes(3, "little")
    kind = mavlink.mavlink_map.get(number)
    checksum = mavlink.x25crc(bytearray(header + payload + bytes([kind.crc_extra if kind else 0])))
    return b"\xfd" + header + payload + struct.pack("<H", checksum.crc)


PIECES = st.one_of(
    st.binary(max_size=60),
    st.sampled_from([Sender()(message) for message, _ in EVENTS]),
    st.sampled_from([Sender()(message)[:9] for message, _ in EVENTS]),
    st.builds(
        _framed,
        st.sampled_from([0, 22, 30, 32, 33, 65, 76, 77, 132, 245, 253, 12920]),
        st.binary(max_size=255),
    ),
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(PIECES, max_size=12))
def test_no_bytes_make_it_raise_and_its_buffer_does_not_grow(pieces: list[bytes]) -> None:
    codec, sender = paired()
    for k, piece in enumerate(pieces):
        for event in codec.hear(piece, 100.0 + k / 20):
            values = (getattr(event, name) for name in event.__slots__)
            assert all(math.isfinite(value) for value in values if isinstance(value, float))
        assert len(codec._mav.buf) < 300
    flush = b"\x00" * 300  # whatever was begun ends here
    codec.hear(flush, 200.0)
    assert len(codec.hear(sender(heartbeat()), 201.0)) == 1


def test_a_link_that_never_pauses_does_not_fill_the_memory() -> None:
    """Every read ends in the middle of a message, so that the parser never finds its buffer empty."""
    codec, sender = paired()
    frames = [sender(attitude(5000 + k)) for k in range(2000)]
    codec.hear(frames[0][:20], 100.0)
    for before, after in pairwise(frames):
        assert len(codec.hear(before[20:] + after[:20], 100.0)) == 1
    assert len(codec._mav.buf) < 300


def test_of_a_backlog_the_newest_is_read() -> None:
    codec, sender = paired()
    stream = sender(*[attitude(5000 + k, yaw_rad=k / 1e4) for k in range(5000)])
    events = codec.hear(stream, 100.0)
    assert len(events) < 2000
    assert isinstance(events[-1], Attitude)
    assert events[-1].yaw_rad == pytest.approx(0.4999)


# ----------------------------------------------------------------------------------------------- time, asked
def asked(codec: Ours, now_s: float) -> int:
    """The `ts1` of our question."""
    codec.drain()
    codec.send_time_request(now_s)
    (message,) = parsed(codec.drain())
    assert (message.get_type(), message.tc1) == ("TIMESYNC", 0)
    return int(message.ts1)


def test_whoever_asks_is_told_our_time_in_ns_with_the_question_mirrored() -> None:
    codec = Ours()
    assert codec.hear(Sender(255, 190)(mavlink.MAVLink_timesync_message(0, 777)), 12.5) == []
    (message,) = parsed(codec.drain())
    assert (message.get_type(), message.tc1, message.ts1) == ("TIMESYNC", 12_500_000_000, 777)
    assert message.get_srcComponent() == 191


def test_a_flood_of_questions_is_answered_four_times_a_read() -> None:
    codec, _ = paired()
    questions = Sender(255, 190)(*[mavlink.MAVLink_timesync_message(0, k) for k in range(1, 100)])
    for _ in range(2):
        codec.hear(questions, 12.5)
        assert [message.ts1 for message in parsed(codec.drain())] == [1, 2, 3, 4]


def test_nobody_is_asked_before_an_autopilot_is_there() -> None:
    codec = Ours()
    codec.send_time_request(12.5)
    assert codec.drain() == b""


@pytest.mark.parametrize(
    ("system", "component", "is_believed"), [(VEHICLE, 1, True), (VEHICLE, 42, False), (9, 1, False), (255, 190, False)]
)
def test_only_the_autopilots_answers_move_its_clock(system: int, component: int, is_believed: bool) -> None:  # noqa: FBT001
    """The fastest message is 8 ms old and our questions take as long: the autopilot is asked five times."""
    codec, sender = paired()
    other = Sender(system, component)
    for k in range(5):
        now_s = 100.0 + k
        codec.hear(sender(attitude(4992 + 1000 * k)), now_s)
        answer = mavlink.MAVLink_timesync_message(5_008_000_000 + k * 10**9, asked(codec, now_s))
        assert codec.hear(other(answer), now_s + 0.05) == []
    (event,) = codec.hear(sender(attitude(9992)), 105.0)
    assert isinstance(event, Attitude)
    assert event.time_s == pytest.approx(104.992 if is_believed else 105.0, abs=1e-4)


@pytest.mark.parametrize(
    ("place_m", "speed_mps", "is_taken"),
    [
        (999_999.0, 199.0, True),
        (1e6, 0.0, False),
        (-3.4e38, 0.0, False),
        (0.0, 200.0, False),
        (0.0, 1e20, False),
        (math.inf, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_a_position_or_velocity_that_no_vehicle_has_is_no_state(
    place_m: float, speed_mps: float, *, is_taken: bool
) -> None:
    codec, sender = paired()
    for axis in range(3):
        place, speed = [0.0] * 3, [0.0] * 3
        place[axis], speed[axis] = place_m, speed_mps
        message = mavlink.MAVLink_local_position_ned_message(5000 + axis, *place, *speed)
        assert bool(codec.hear(sender(message), 100.0)) is is_taken
