"""What every fake autopilot does: link, streams, commands, parameters, reboot; for both personalities."""

import math
import struct
from itertools import pairwise

import pytest
from ground_station import GroundStation, velocity
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sim.ardupilot import ArduCopter
from sim.autopilot import FakeAutopilot, Personality, Start
from sim.px4 import Px4
from sim.wind import Wind

BOTH = pytest.mark.parametrize("personality", [ArduCopter, Px4], ids=["ArduCopter", "PX4"])
IN_AIR = Start(pos_ned_m=(3.0, -4.0, -20.0), yaw_rad=0.7)
STREAMED = [  # message id, type, rate in Hz that a companion asks for
    (mavlink.MAVLINK_MSG_ID_ATTITUDE, "ATTITUDE", 50),
    (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, "LOCAL_POSITION_NED", 20),
    (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, "GLOBAL_POSITION_INT", 5),
    (mavlink.MAVLINK_MSG_ID_RC_CHANNELS, "RC_CHANNELS", 10),
    (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, "EXTENDED_SYS_STATE", 2),
    (mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, "DISTANCE_SENSOR", 10),
    (mavlink.MAVLINK_MSG_ID_SYS_STATUS, "SYS_STATUS", 1),
    (mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, "POSITION_TARGET_LOCAL_NED", 10),
]


def flying(personality: type[Personality], mode: str | None = None) -> GroundStation:
    start = Start(pos_ned_m=IN_AIR.pos_ned_m, yaw_rad=IN_AIR.yaw_rad, mode=mode)
    return GroundStation(FakeAutopilot(personality, start=start))


def asked(personality: type[Personality]) -> GroundStation:
    """Flying, with every message asked for."""
    station = flying(personality)
    for msg_id, _, rate_hz in STREAMED:
        assert station.ask_for(msg_id, rate_hz) == [mavlink.MAV_RESULT_ACCEPTED]
    return station


@BOTH
def test_heartbeat_comes_once_a_second(personality: type[Personality]) -> None:
    station = flying(personality)
    station.run(10.0)
    assert len(station.of("HEARTBEAT")) in {10, 11}
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in station.of("HEARTBEAT")} == {(1, 1)}


@BOTH
@pytest.mark.parametrize(("msg_id", "kind", "rate_hz"), STREAMED, ids=[kind for _, kind, _ in STREAMED])
def test_message_comes_at_the_rate_that_was_asked_for(
    personality: type[Personality], msg_id: int, kind: str, rate_hz: int
) -> None:
    station = flying(personality)
    assert station.ask_for(msg_id, rate_hz) == [mavlink.MAV_RESULT_ACCEPTED]
    station.run(5.0)
    assert len(station.of(kind)) == pytest.approx(5 * rate_hz, abs=1)
    assert station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id, -1) == [mavlink.MAV_RESULT_ACCEPTED]
    station.heard.clear()
    station.run(2.0)
    assert station.of(kind) == []


@BOTH
def test_mode_can_change_while_even_the_heartbeat_is_stopped(personality: type[Personality]) -> None:
    station = flying(personality)
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HEARTBEAT, -1)
    station.autopilot.select_mode(personality.LAND_MODE)
    station.run(2.0)
    assert station.of("HEARTBEAT") == []


@BOTH
def test_interval_0_brings_the_default_rate_back(personality: type[Personality]) -> None:
    plain, changed = flying(personality), flying(personality)
    changed.ask_for(mavlink.MAVLINK_MSG_ID_ATTITUDE, 17)
    changed.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 0)
    for station in (plain, changed):
        station.run(2.0)
    assert len(changed.of("ATTITUDE")) == len(plain.of("ATTITUDE")) > 0


@BOTH
@pytest.mark.parametrize("params", [(9999, 1e5), (30, math.nan), (math.nan, 1e5), (-1, 1e5)])
def test_interval_that_makes_no_sense_is_denied(personality: type[Personality], params: tuple[float, float]) -> None:
    station = flying(personality)
    assert station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *params) == [mavlink.MAV_RESULT_DENIED]


def test_data_streams_are_the_old_way_to_ask_ardupilot() -> None:
    station = flying(ArduCopter)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_POSITION, 10, 1))
    station.run(3.0)
    assert len(station.of("LOCAL_POSITION_NED")) == pytest.approx(30, abs=1)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 0, 0))
    station.run(0.1)
    station.heard.clear()
    station.run(2.0)
    assert {message.get_type() for _, message in station.heard} == {"HEARTBEAT"}


@BOTH
def test_telemetry_tells_the_truth(personality: type[Personality]) -> None:
    station = asked(personality)
    station.autopilot.set_sticks(roll=0.4, pitch=-0.8, yaw=0.3)
    station.run(2.0)
    station.autopilot.set_sticks()
    for msg_id, _, _ in STREAMED:
        station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, msg_id)
    pose, (north, east, down) = station.autopilot.pose, station.autopilot.velocity_ned_mps
    latest = {message.get_type(): message for _, message in station.heard}
    attitude = latest["ATTITUDE"]
    assert (attitude.roll, attitude.pitch, attitude.yaw) == pytest.approx((pose.roll_rad, pose.pitch_rad, pose.yaw_rad))
    assert attitude.yawspeed == pytest.approx(station.autopilot.yaw_rate_radps)
    local = latest["LOCAL_POSITION_NED"]
    assert (local.x, local.y, local.z) == pytest.approx(pose.pos_ned_m)
    assert (local.vx, local.vy, local.vz) == pytest.approx((north, east, down), abs=1e-6)
    place = latest["GLOBAL_POSITION_INT"]
    assert place.relative_alt == pytest.approx(-1000 * pose.pos_ned_m[2], abs=1)
    assert (place.vx, place.vy, place.vz) == pytest.approx((100 * north, 100 * east, 100 * down), abs=0.6)
    assert place.hdg == pytest.approx(math.degrees(pose.yaw_rad) % 360 * 100, abs=1)
    assert latest["DISTANCE_SENSOR"].current_distance == pytest.approx(-100 * pose.pos_ned_m[2], abs=1)
    assert latest["DISTANCE_SENSOR"].orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    assert latest["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    assert {message.time_boot_ms for message in (attitude, local, place)} == {122_000}


@BOTH
def test_attitude_rates_are_the_slopes_of_the_angles(personality: type[Personality]) -> None:
    station = asked(personality)
    station.autopilot.set_sticks(roll=1.0, pitch=-1.0, yaw=0.5)
    station.run(1.0)
    sent = station.of("ATTITUDE")[5:]
    for before, after in pairwise(sent):
        dt_s = (after.time_boot_ms - before.time_boot_ms) / 1000
        for angle, rate in (("roll", "rollspeed"), ("pitch", "pitchspeed"), ("yaw", "yawspeed")):
            slope = (getattr(after, angle) - getattr(before, angle)) / dt_s
            assert slope == pytest.approx(getattr(after, rate), abs=0.15)


@BOTH
def test_sticks_and_switches_are_shown_as_pulses(personality: type[Personality]) -> None:
    station = asked(personality)
    station.autopilot.set_sticks(roll=1.0, pitch=-1.0, throttle=0.5, yaw=-0.2)
    station.autopilot.set_rc_channel(7, 1900)
    station.run(0.3)
    shown = station.of("RC_CHANNELS")[-1]
    assert (shown.chan1_raw, shown.chan2_raw, shown.chan3_raw, shown.chan4_raw) == (2000, 1000, 1750, 1400)
    assert (shown.chan7_raw, shown.chan8_raw, shown.chancount) == (1900, 1000, 16)
    station.autopilot.lose_rc()
    station.run(0.3)
    assert station.of("RC_CHANNELS")[-1].chancount == 0
    station.autopilot.regain_rc()
    station.run(0.3)
    assert station.of("RC_CHANNELS")[-1].chan7_raw == 1900


@pytest.mark.parametrize(
    ("personality", "name", "kind", "value"),
    [
        (ArduCopter, "GUID_TIMEOUT", mavlink.MAV_PARAM_TYPE_REAL32, 3.0),
        (ArduCopter, "GUID_OPTIONS", mavlink.MAV_PARAM_TYPE_INT32, 0.0),
        (ArduCopter, "FS_OPTIONS", mavlink.MAV_PARAM_TYPE_INT32, 16.0),
        (ArduCopter, "WPNAV_SPEED", mavlink.MAV_PARAM_TYPE_REAL32, 1000.0),
        (Px4, "COM_OF_LOSS_T", mavlink.MAV_PARAM_TYPE_REAL32, 1.0),
        (Px4, "COM_OBL_RC_ACT", mavlink.MAV_PARAM_TYPE_INT32, 0.0),
        (Px4, "COM_RC_OVERRIDE", mavlink.MAV_PARAM_TYPE_INT32, 1.0),
    ],
)
def test_parameter_is_told_in_the_encoding_of_its_autopilot(
    personality: type[Personality], name: str, kind: int, value: float
) -> None:
    """PX4 puts the four bytes of an integer where the float is; ArduPilot sends its value as a float."""
    station = flying(personality)
    station.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    station.run(0.02)
    (told,) = station.of("PARAM_VALUE")
    assert (told.param_id, told.param_type, told.param_count) == (name, kind, len(personality.PARAMETERS))
    if personality is Px4 and kind == mavlink.MAV_PARAM_TYPE_INT32:
        assert struct.unpack("<i", struct.pack("<f", told.param_value)) == (int(value),)
    else:
        assert told.param_value == value
    station.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", told.param_index))
    station.run(0.02)
    assert station.of("PARAM_VALUE")[-1].param_id == name


@BOTH
def test_unknown_parameter_is_answered_with_silence(personality: type[Personality]) -> None:
    station = flying(personality)
    station.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    station.run(0.02)
    assert station.of("PARAM_VALUE") == []


@BOTH
def test_timesync_mirrors_the_question_and_adds_the_time_since_boot(personality: type[Personality]) -> None:
    station = flying(personality)
    station.run(1.0)
    station.send(mavlink.MAVLink_timesync_message(0, 123_456_789))
    station.send(mavlink.MAVLink_timesync_message(55, 99))  # an answer to somebody else
    station.run(0.02)
    assert [(m.tc1, m.ts1) for m in station.of("TIMESYNC")] == [(pytest.approx(121e9, abs=1e3), 123_456_789)]


@BOTH
def test_requested_message_follows_its_acknowledgement(personality: type[Personality]) -> None:
    station = flying(personality)
    asked_for = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, asked_for) == [mavlink.MAV_RESULT_ACCEPTED]
    assert [message.get_type() for _, message in station.heard] == ["COMMAND_ACK", "EXTENDED_SYS_STATE"]
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 12345) == [mavlink.MAV_RESULT_DENIED]


@BOTH
def test_unknown_command_is_unsupported_and_its_sender_is_told(personality: type[Personality]) -> None:
    station = flying(personality)
    assert station.command(mavlink.MAV_CMD_DO_PARACHUTE, 1) == [mavlink.MAV_RESULT_UNSUPPORTED]
    (ack,) = station.of("COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (1, 191)


@BOTH
def test_command_to_another_component_or_system_is_left_to_it(personality: type[Personality]) -> None:
    station = flying(personality)
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 0, component=100) == []
    station.send(mavlink.MAVLink_command_long_message(2, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, *[0.0] * 7))
    station.run(0.0)
    assert station.of("COMMAND_ACK") == []


@BOTH
def test_command_int_is_obeyed_too(personality: type[Personality]) -> None:
    station = flying(personality)
    command = mavlink.MAV_CMD_NAV_LAND
    station.send(mavlink.MAVLink_command_int_message(1, 1, 0, command, 0, 0, *[0.0] * 4, 0, 0, 0.0))
    station.run(0.1)
    assert [ack.result for ack in station.of("COMMAND_ACK")] == [mavlink.MAV_RESULT_ACCEPTED]
    assert station.autopilot.mode_name == personality.LAND_MODE


@BOTH
def test_disarming_in_the_air_is_refused_unless_forced(personality: type[Personality]) -> None:
    station = flying(personality)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == [personality.REFUSAL]
    assert station.autopilot.is_armed
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == [mavlink.MAV_RESULT_ACCEPTED]
    station.run(3.0)
    assert station.autopilot.is_landed  # it fell


@BOTH
def test_reboot_in_the_air_is_silent_and_forgets_the_intervals_and_the_time(personality: type[Personality]) -> None:
    station = asked(personality)
    station.run(2.0)
    mode, pose = station.autopilot.mode_name, station.autopilot.pose
    station.autopilot.reboot()
    rebooted_s = station.autopilot.time_s
    station.run(0.96)
    assert station.of("HEARTBEAT", rebooted_s) == []
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 0) == []
    station.run(3.0)
    assert station.of("HEARTBEAT", rebooted_s)
    assert station.of("DISTANCE_SENSOR", rebooted_s) == []
    boot_ms = [message.time_boot_ms for message in station.of("ATTITUDE", rebooted_s)]
    assert boot_ms == sorted(boot_ms)
    assert boot_ms[0] < 100
    assert (station.autopilot.mode_name, station.autopilot.is_armed, station.autopilot.pose) == (mode, True, pose)


@BOTH
def test_reboot_on_the_ground_goes_through_the_start_again(personality: type[Personality]) -> None:
    station = GroundStation(FakeAutopilot(personality, start=Start()))
    station.run(50.0)
    assert station.autopilot.arm()
    station.autopilot.reboot()
    assert not station.autopilot.is_armed
    station.run(3.0)
    assert not station.autopilot.arm()
    station.run(50.0)
    assert station.autopilot.arm()


@BOTH
def test_low_battery_is_told_and_leads_home(personality: type[Personality]) -> None:
    station = asked(personality)
    station.run(1.1)
    assert station.of("SYS_STATUS")[-1].battery_remaining > 50
    station.autopilot.battery_failsafe()
    station.run(2.0)
    assert station.autopilot.mode_name == personality.HOME_MODE
    assert station.of("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_CRITICAL
    assert station.of("SYS_STATUS")[-1].battery_remaining < 20
    assert station.texts() == ["Battery is low"]


@BOTH
def test_wind_moves_the_vehicle_only_by_its_gusts(personality: type[Personality]) -> None:
    def farthest_m(wind: Wind) -> float:
        fc = FakeAutopilot(personality, start=IN_AIR, wind=wind)
        ways_m = []
        for _ in range(600):
            fc.step(0.05)
            ways_m.append(math.dist(fc.pose.pos_ned_m, IN_AIR.pos_ned_m))
        return max(ways_m)

    assert farthest_m(Wind((6.0, 0.0))) < 1.0
    assert farthest_m(Wind((6.0, 0.0), gust_mps=2.0)) > 0.1


@BOTH
def test_same_calls_give_the_same_bytes(personality: type[Personality]) -> None:
    def said() -> bytes:
        station = asked(personality)
        packed = station.packed(velocity(2, 0, 0, 5))
        out = b""
        for index in range(300):
            if index % 3 == 0:
                station.autopilot.receive(packed)
            out += station.autopilot.step(1 / 60)
        return out

    assert said() == said()


@BOTH
def test_flight_hardly_depends_on_how_time_is_cut(personality: type[Personality]) -> None:
    stations = [asked(personality) for _ in range(2)]
    for station in stations:
        station.autopilot.set_sticks(pitch=-0.6, yaw=0.2)
    for _ in range(2000):
        stations[0].autopilot.step(0.002)
    for _ in range(4):
        stations[1].autopilot.step(1.0)
    fine, coarse = (station.autopilot.pose for station in stations)
    assert coarse.pos_ned_m == pytest.approx(fine.pos_ned_m, abs=0.15)
    assert coarse.yaw_rad == pytest.approx(fine.yaw_rad, abs=0.02)


@BOTH
def test_bytes_may_come_in_any_chunks_between_any_garbage(personality: type[Personality]) -> None:
    station = flying(personality)
    command = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 0, *[0.0] * 6)
    noisy = b"\x00\x01garbage" + station.packed(command) + b"\x55" + station.packed(command) + b"\x00\x00"
    for value in noisy:
        station.autopilot.receive(bytes([value]))
    station.run(0.02)
    assert len(station.of("COMMAND_ACK")) == 2


@BOTH
def test_buffer_stays_short_if_every_chunk_ends_in_the_middle_of_a_message(personality: type[Personality]) -> None:
    fc = flying(personality).autopilot
    stream = flying(personality).packed(velocity(1)) * 400
    for at in range(0, len(stream), 97):
        fc.receive(stream[at : at + 97])
        assert len(fc._link.buf) < 97


@BOTH
def test_absurd_setpoint_is_obeyed_within_the_limits_and_shown(personality: type[Personality]) -> None:
    station = asked(personality)
    absurd = velocity(3e38, -3e38, -3e38, 1e30)
    station.run(2.0, absurd)
    station.autopilot.select_mode("GUIDED" if personality is ArduCopter else "OFFBOARD")
    station.run(5.0, absurd)
    assert station.speed_mps < 12.5
    assert station.of("POSITION_TARGET_LOCAL_NED")[-1].vz == -1e6
    assert station.yaw_rate_dps == pytest.approx(200.0, abs=1.0)


@BOTH
def test_rate_that_was_too_high_for_the_step_leaves_no_backlog(personality: type[Personality]) -> None:
    station = flying(personality)
    station.ask_for(mavlink.MAVLINK_MSG_ID_ATTITUDE, 200)
    station.run(2.0)
    before = len(station.of("ATTITUDE"))
    for _ in range(250):
        station._listen(0.002)
    assert len(station.of("ATTITUDE")) - before <= 101


@BOTH
def test_wrong_names_are_refused_with_the_right_ones(personality: type[Personality]) -> None:
    with pytest.raises(ValueError, match="no mode 'GUIDE'"):
        FakeAutopilot(personality, start=Start(mode="GUIDE"))
    with pytest.raises(ValueError, match="no parameter 'SPEED'"):
        FakeAutopilot(personality, start=Start(), parameters={"SPEED": 1.0})
    fc = FakeAutopilot(personality, start=Start())
    with pytest.raises(ValueError, match="no mode 'GUIDE'"):
        fc.select_mode("GUIDE")
    with pytest.raises(ValueError, match="channel is 19"):
        fc.set_rc_channel(19, 1500)


@pytest.mark.parametrize("dt_s", [-0.01, math.nan, math.inf])
def test_impossible_step_is_refused(dt_s: float) -> None:
    with pytest.raises(ValueError, match="dt_s"):
        FakeAutopilot(Px4, start=IN_AIR).step(dt_s)


FLOATS = st.floats(width=32)
COMMANDS = st.sampled_from([21, 22, 176, 400, 511, 512, 2004]) | st.integers(0, 65535)
BYTE = st.integers(0, 255)
MESSAGES = st.one_of(
    st.builds(
        mavlink.MAVLink_set_position_target_local_ned_message,
        *(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2]), BYTE, BYTE, st.integers(0, 65535)),
        *[FLOATS] * 11,
    ),
    st.builds(mavlink.MAVLink_command_long_message, st.just(1), st.just(1), COMMANDS, BYTE, *[FLOATS] * 7),
    st.builds(
        mavlink.MAVLink_command_int_message,
        *(st.just(1), st.just(1), BYTE, COMMANDS, BYTE, BYTE),
        *[FLOATS] * 4,
        *[st.integers(-(2**31), 2**31 - 1)] * 2,
        FLOATS,
    ),
    st.builds(
        mavlink.MAVLink_param_request_read_message,
        *(st.just(1), st.just(1), st.binary(max_size=16), st.integers(-(2**15), 2**15 - 1)),
    ),
    st.builds(mavlink.MAVLink_request_data_stream_message, *[BYTE] * 3, st.integers(0, 65535), BYTE),
    st.builds(mavlink.MAVLink_timesync_message, *[st.integers(-(2**63), 2**63 - 1)] * 2),
)


@pytest.mark.parametrize(
    ("personality", "mode"), [(ArduCopter, "GUIDED"), (ArduCopter, "LOITER"), (Px4, "OFFBOARD"), (Px4, "AUTO.LOITER")]
)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_no_bytes_can_make_it_raise_or_grow(personality: type[Personality], mode: str, data: st.DataObject) -> None:
    """Any messages of any content, some bytes of them changed, in any chunks, between random bytes."""
    station = flying(personality, mode)
    fc = station.autopilot
    for part in data.draw(st.lists(MESSAGES | st.binary(max_size=300), max_size=12)):
        sent = bytearray(part if isinstance(part, bytes) else station.packed(part))
        for index, value in data.draw(st.lists(st.tuples(st.integers(0, 399), BYTE), max_size=2)):
            if sent:
                sent[index % len(sent)] = value
        cut = data.draw(st.integers(0, len(sent)))
        fc.receive(bytes(sent[:cut]))
        fc.step(0.05)
        fc.receive(bytes(sent[cut:]))
        assert len(fc._link.buf) <= 280  # one unfinished packet
    assert len(fc.step(0.2)) < 4000
    assert all(map(math.isfinite, (*fc.pose.pos_ned_m, *fc.velocity_ned_mps, fc.pose.yaw_rad, fc.yaw_rate_radps)))
