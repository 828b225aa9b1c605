"""PX4's personality: every row that was measured on PX4 of April 2026 in the loop."""

import math

import pytest
from ground_station import VELOCITY_ONLY, GroundStation, velocity
from pymavlink.dialects.v20 import common as mavlink

from sim.autopilot import FakeAutopilot, Start
from sim.personality import ORIGIN_ALT_M
from sim.px4 import Px4

POSCTL, OFFBOARD = (3, 0), (6, 0)
HOLD, RTL = (4, 3), (4, 5)
OK, REJECTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
FORWARD = velocity(3, 1, -0.3, 10)
SEEDS = pytest.mark.parametrize("seed", [0, 1, 2])  # of the delays that were measured as a range


def flying(*, seed: int = 0, has_pilot: bool = True, **parameters: float) -> GroundStation:
    start = Start(pos_ned_m=(0.0, 0.0, -20.0), yaw_rad=0.7, has_pilot=has_pilot)
    return GroundStation(FakeAutopilot(Px4, start=start, seed=seed, parameters=parameters))


def offboard(
    setpoint: object = FORWARD, *, seed: int = 0, has_pilot: bool = True, **parameters: float
) -> GroundStation:
    """In OFFBOARD and following a setpoint since 10 s."""
    station = flying(seed=seed, has_pilot=has_pilot, **parameters)
    station.run(1.2, velocity())
    assert station.set_mode(*OFFBOARD) == [OK, OK]
    station.run(10.0, setpoint)
    assert station.autopilot.mode_name == "OFFBOARD"
    return station


def test_offboard_is_armed_and_active_in_the_heartbeat() -> None:
    station = offboard()
    heartbeat = station.of("HEARTBEAT")[-1]
    assert (heartbeat.autopilot, heartbeat.type) == (12, 2)
    assert ((heartbeat.custom_mode >> 16) & 255, (heartbeat.custom_mode >> 24) & 255) == OFFBOARD
    assert heartbeat.base_mode & 128
    assert heartbeat.system_status == mavlink.MAV_STATE_ACTIVE


def test_offboard_without_a_stream_is_accepted_first_and_then_rejected() -> None:
    station = flying()
    assert station.set_mode(*OFFBOARD) == [OK, REJECTED]
    station.run(2.0)
    assert station.autopilot.mode_name == "AUTO.LOITER"


@pytest.mark.parametrize("mode", [POSCTL, HOLD, RTL])
def test_every_set_mode_is_acknowledged_twice(mode: tuple[int, int]) -> None:
    station = flying()
    assert station.set_mode(*mode) == [OK, OK]
    station.run(1.1)
    assert station.of("HEARTBEAT")[-1].custom_mode == mode[0] << 16 | mode[1] << 24


def test_offboard_is_accepted_after_1_2_s_of_zero_setpoints() -> None:
    station = flying()
    station.run(0.8, velocity())
    assert station.set_mode(*OFFBOARD) == [OK, REJECTED]
    station.run(0.4, velocity())
    assert station.set_mode(*OFFBOARD) == [OK, OK]


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0])
def test_body_velocity_and_yaw_rate_are_followed(rate_hz: float) -> None:
    """Measured 2.5 forward after 10 s of a command of 3, 0.39 up of 0.3, 10 deg/s."""
    station = flying()
    station.run(1.2, velocity(), rate_hz=rate_hz)
    station.set_mode(*OFFBOARD)
    station.run(10.0, FORWARD, rate_hz=rate_hz)
    forward, _, down = station.body_mps
    assert forward == pytest.approx(2.5, abs=0.15)
    assert down == pytest.approx(-0.39, abs=0.02)
    assert station.yaw_rate_dps == pytest.approx(10.0, abs=0.2)


@pytest.mark.parametrize(
    ("frame", "direction_rad"), [(mavlink.MAV_FRAME_LOCAL_NED, 0.0), (mavlink.MAV_FRAME_BODY_NED, 0.7)]
)
def test_frame_says_whether_the_heading_turns_the_velocity(frame: int, direction_rad: float) -> None:
    north, east, _ = offboard(velocity(3, frame=frame)).autopilot.velocity_ned_mps
    assert math.atan2(east, north) == pytest.approx(direction_rad, abs=0.01)


@pytest.mark.parametrize("frame", [7, 9, 12])
def test_unsupported_frame_is_complained_of_and_counts_as_no_setpoint(frame: int) -> None:
    station = offboard()
    station.run(0.8, velocity(3, frame=frame))
    assert station.autopilot.mode_name == "OFFBOARD"
    station.run(0.8, velocity(3, frame=frame))
    assert station.autopilot.mode_name == "POSCTL"
    assert set(station.texts()) == {f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"}
    assert len(station.texts()) == 16


def test_velocity_is_followed_and_the_heading_held_if_the_yaw_rate_is_ignored() -> None:
    station = offboard(velocity(0, 3, yaw_rate_dps=30, frame=mavlink.MAV_FRAME_LOCAL_NED, mask=VELOCITY_ONLY))
    assert station.autopilot.velocity_ned_mps[1] == pytest.approx(2.5, abs=0.2)
    assert station.autopilot.pose.yaw_rad == pytest.approx(0.7)


def test_ignored_vz_counts_as_loss_in_the_body_frame() -> None:
    station = offboard()
    station.run(1.6, velocity(3, mask=0x5C7 | 32))
    assert station.autopilot.mode_name == "POSCTL"


def test_ignored_vz_stays_in_offboard_but_does_not_move_in_the_local_frame() -> None:
    station = offboard(velocity(3, frame=mavlink.MAV_FRAME_LOCAL_NED, mask=0x5C7 | 32))
    assert station.speed_mps < 0.01


@pytest.mark.parametrize(
    "bad",
    [velocity(math.nan, 1), velocity(3, mask=0x5C0), velocity(3, mask=0x407)],
    ids=["NaN", "position", "acceleration"],
)
def test_setpoint_that_is_no_finite_velocity_stops_the_vehicle(bad: object) -> None:
    station = offboard()
    station.run(5.0, bad)
    assert station.autopilot.mode_name == "OFFBOARD"
    assert station.speed_mps < 0.4


@SEEDS
def test_silence_keeps_the_last_velocity_for_1_0_to_1_4_s_and_flies_home_without_a_pilot(seed: int) -> None:
    station = offboard(seed=seed, has_pilot=False)
    last_s = station.autopilot.time_s - 0.1  # of the last setpoint
    station.run(3.0, until=lambda fc: fc.mode_name != "OFFBOARD")
    assert 1.0 < station.autopilot.time_s - last_s < 1.45
    assert station.body_mps[0] == pytest.approx(2.5, abs=0.15)
    assert station.autopilot.mode_name == "AUTO.RTL"
    station.run(30.0)
    assert max(-message.z for message in station.of("LOCAL_POSITION_NED")) == pytest.approx(30.0, abs=0.5)


@SEEDS
@pytest.mark.parametrize(
    ("parameters", "mode", "speed_mps"),
    [({"COM_OBL_RC_ACT": 5.0}, "AUTO.LOITER", 0.4), ({}, "POSCTL", 0.7)],
    ids=["COM_OBL_RC_ACT 5", "sticks present"],
)
def test_silence_holds(parameters: dict[str, float], mode: str, speed_mps: float, seed: int) -> None:
    station = offboard(seed=seed, **parameters)
    station.run(2.7 - 0.1)
    assert station.autopilot.mode_name == mode
    assert station.speed_mps == pytest.approx(speed_mps, abs=0.3)
    station.run(2.0)
    assert station.of("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_CRITICAL


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0.0, "AUTO.RTL"), (1.0, "AUTO.RTL"), (3.0, "AUTO.RTL"), (4.0, "AUTO.LAND"), (5.0, "AUTO.LOITER")],
)
def test_without_a_pilot_no_mode_by_stick_follows_the_silence(action: float, mode: str) -> None:
    station = offboard(has_pilot=False, COM_OBL_RC_ACT=action)
    station.run(1.6)
    assert station.autopilot.mode_name == mode


def test_hold_brakes_from_the_actual_velocity_not_from_the_commanded_one() -> None:
    station = offboard(velocity())
    station.run(0.4, velocity(12))
    station.set_mode(*HOLD)
    fastest_mps = station.speed_mps
    assert fastest_mps < 2.0
    for _ in range(30):
        station.run(0.1)
        fastest_mps = max(fastest_mps, station.speed_mps)
    assert fastest_mps < 3.0  # it still leans forward when Hold begins


def test_com_of_loss_t_sets_how_much_silence_is_allowed() -> None:
    station = offboard(COM_OF_LOSS_T=3.0)
    station.run(2.8)
    assert station.autopilot.mode_name == "OFFBOARD"
    station.run(0.8)
    assert station.autopilot.mode_name == "POSCTL"


@SEEDS
@pytest.mark.parametrize("action", [0.0, 3.0, 5.0])
def test_stream_that_resumes_after_the_failsafe_brings_offboard_back_by_itself(action: float, seed: int) -> None:
    station = offboard(seed=seed, COM_OBL_RC_ACT=action)
    station.run(3.0)
    assert station.autopilot.mode_name != "OFFBOARD"
    assert 0.3 <= station.run(2.0, FORWARD, until=lambda fc: fc.mode_name == "OFFBOARD") <= 1.0
    station.run(5.0, FORWARD)
    assert station.body_mps[0] > 2.0


@pytest.mark.parametrize("is_by_switch", [True, False], ids=["by RC switch", "by command"])
def test_commanded_mode_in_between_keeps_offboard_from_coming_back(*, is_by_switch: bool) -> None:
    station = offboard(COM_OBL_RC_ACT=5.0)
    station.run(3.0)
    assert station.autopilot.mode_name == "AUTO.LOITER"
    if is_by_switch:
        station.autopilot.select_mode("AUTO.LOITER")
    else:
        assert station.set_mode(*HOLD) == [OK, OK]
    station.run(5.0, FORWARD)
    assert station.autopilot.mode_name == "AUTO.LOITER"
    assert station.speed_mps < 0.4


def test_stream_that_still_runs_is_ignored_in_hold_and_obeyed_when_offboard_comes_back() -> None:
    station = offboard()
    station.set_mode(*HOLD)
    station.run(6.0, FORWARD)
    assert station.autopilot.setpoint is None
    assert station.speed_mps < 0.4
    assert station.texts() == []
    assert station.set_mode(*OFFBOARD) == [OK, OK]
    station.run(1.0, FORWARD)
    assert station.body_mps[0] > 1.5


@pytest.mark.parametrize(
    ("override", "mode"), [(1.0, "OFFBOARD"), (3.0, "POSCTL")], ids=["COM_RC_OVERRIDE 1", "COM_RC_OVERRIDE 3"]
)
@SEEDS
def test_deflected_sticks_take_over_within_0_4_s_only_if_allowed(override: float, mode: str, seed: int) -> None:
    station = offboard(COM_RC_OVERRIDE=override, seed=seed)
    station.autopilot.set_sticks(roll=1.0)
    station.run(0.42, FORWARD)
    assert station.autopilot.mode_name == mode
    station.autopilot.set_sticks()
    station.run(3.0, FORWARD)
    assert station.autopilot.mode_name == mode


@pytest.mark.parametrize("component", [0, 1])
def test_setpoint_for_everybody_or_the_autopilot_is_accepted(component: int) -> None:
    assert offboard(velocity(3, component=component)).speed_mps == pytest.approx(2.5, abs=0.2)


def test_setpoint_for_another_component_is_ignored_and_so_lost() -> None:
    station = offboard()
    station.run(1.6, velocity(3, component=25))
    assert station.autopilot.mode_name == "POSCTL"


def test_setpoint_for_another_system_is_ignored_and_so_lost() -> None:
    station = offboard()
    station.run(1.6, velocity(3, system=2))
    assert station.autopilot.mode_name == "POSCTL"


@pytest.mark.parametrize("rate_hz", [2.0, 4.0, 20.0])
def test_2_hz_and_more_enter_and_hold_offboard(rate_hz: float) -> None:
    station = flying()
    station.run(2.0, FORWARD, rate_hz=rate_hz)
    assert station.set_mode(*OFFBOARD) == [OK, OK]
    station.run(10.0, FORWARD, rate_hz=rate_hz, until=lambda fc: fc.mode_name != "OFFBOARD")
    assert station.autopilot.mode_name == "OFFBOARD"


def test_1_hz_is_on_the_edge() -> None:
    """It does not enter OFFBOARD; a little less than 1 Hz is lost now and then."""
    station = flying()
    station.run(5.0, FORWARD, rate_hz=1.0)
    assert station.set_mode(*OFFBOARD) == [OK, REJECTED]
    station = offboard()
    station.run(60.0, FORWARD, rate_hz=0.9, until=lambda fc: fc.mode_name != "OFFBOARD")
    assert station.autopilot.mode_name == "POSCTL"


@SEEDS
def test_start_makes_wait_for_4_to_6_s(seed: int) -> None:
    station = GroundStation(FakeAutopilot(Px4, start=Start(), seed=seed))
    station.run(3.9)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == [REJECTED]
    station.run(2.2)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == [OK]


def test_take_off_climbs_to_20_m_in_17_7_s_and_then_holds() -> None:
    """The altitude of PX4's command is above mean sea level."""
    station = GroundStation(FakeAutopilot(Px4, start=Start()))
    station.run(7.0)
    station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert station.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, ORIGIN_ALT_M + 20) == [OK]
    assert station.run(40.0, until=lambda fc: fc.pose.pos_ned_m[2] < -19.5) == pytest.approx(17.7, abs=0.5)
    station.run(5.0)
    assert station.autopilot.mode_name == "AUTO.LOITER"
    assert station.autopilot.pose.pos_ned_m[2] == pytest.approx(-20.0, abs=0.5)


def test_reboot_on_the_ground_forgets_that_offboard_was_wanted() -> None:
    station = GroundStation(FakeAutopilot(Px4, start=Start()))
    station.run(8.0, velocity())
    assert station.set_mode(*OFFBOARD) == [OK, OK]
    station.run(1.0, velocity())
    station.autopilot.reboot()
    station.run(10.0, velocity())
    assert station.autopilot.mode_name == "AUTO.LOITER"


def test_take_off_that_was_commanded_before_arming_begins_with_it() -> None:
    station = GroundStation(FakeAutopilot(Px4, start=Start()))
    station.run(7.0)
    assert station.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, ORIGIN_ALT_M + 20) == [OK]
    station.run(10.0)
    station.autopilot.arm()
    station.run(3.0)
    assert station.autopilot.is_landed  # the motors spin up
    station.run(3.0)
    assert not station.autopilot.is_landed


def test_loss_of_rc_does_not_break_off_a_landing() -> None:
    station = flying()
    station.command(mavlink.MAV_CMD_NAV_LAND)
    station.autopilot.lose_rc()
    station.run(2.0)
    assert station.autopilot.mode_name == "AUTO.LAND"


def test_loss_of_rc_flies_home_and_a_stream_does_not_bring_offboard_back() -> None:
    """From the documentation, not measured: NAV_RCL_ACT 2, COM_RC_LOSS_T 0.5."""
    station = offboard()
    station.autopilot.lose_rc()
    station.run(3.0, FORWARD)
    assert station.autopilot.mode_name == "AUTO.RTL"


def test_loss_of_gps_lands_and_a_stream_does_not_bring_offboard_back() -> None:
    """From the documentation, not measured."""
    station = offboard()
    station.autopilot.lose_gps()
    station.run(3.0, FORWARD)
    assert station.autopilot.mode_name == "AUTO.LAND"
    assert station.set_mode(*OFFBOARD) == [OK, REJECTED]


def test_landing_ends_on_the_ground_and_disarmed() -> None:
    station = flying()
    assert station.command(mavlink.MAV_CMD_NAV_LAND) == [OK]
    station.run(60.0, until=lambda fc: not fc.is_armed)
    assert station.autopilot.is_landed
    assert not station.autopilot.is_armed
