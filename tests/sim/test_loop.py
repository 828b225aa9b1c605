"""The closed loop with true eyes: flight code between a simulated vehicle and a simulated camera, in virtual time."""

import math
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from itertools import groupby, pairwise

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.config import parse
from companion.follower import Follower
from companion.modes import Mode
from companion.types import Disengage, Engage, Select
from sim.ardupilot import ArduCopter
from sim.autopilot import Personality
from sim.eyes import TrueEyes
from sim.loop import OUR_CLOCK_S, Faults, Loop
from sim.px4 import Px4
from sim.stages import stage
from sim.trace import Moment
from sim.world import Pose

BOTH = pytest.mark.parametrize("kind", [ArduCopter, Px4])
DELAYS_S = (0.0, 0.1, 0.2, 0.3)
STANDING_S = 1e6  # the target sets off after the test
EXTERNAL = {ArduCopter: "GUIDED", Px4: "OFFBOARD"}
PILOT = {ArduCopter: "LOITER", Px4: "POSCTL"}
HOLD = {ArduCopter: "BRAKE", Px4: "AUTO.LOITER"}
HOME = {ArduCopter: "RTL", Px4: "AUTO.RTL"}
LAND = {ArduCopter: "LAND", Px4: "AUTO.LAND"}


def looped(
    kind: type[Personality],
    settings: str = '[follow]\nmode="follow"\n',
    *,
    place: str = "straight",
    off_nose_deg: float = 0.0,
    delay_s: float = 0.035,
    wait_s: float = STANDING_S,
    start: Pose | None = None,
    **parameters: float,
) -> Loop:
    """A loop whose delay is half the camera's, known, and half the tracker's."""
    ground = stage(place, 7)
    start = start or replace(ground.start, yaw_rad=ground.start.yaw_rad - math.radians(off_nose_deg))
    ground = replace(ground, start=start)
    config = parse(
        f"[camera]\nwidth_px=640\nheight_px=480\nfocal_px={ground.camera.focal_px}\nlatency_ms={500 * delay_s}\n"
        f"mount_pitch_deg={math.degrees(ground.camera.mount_pitch_rad)}\n" + settings
    )
    return Loop(
        ground,
        kind,
        config,
        TrueEyes(ground),
        wait_s=wait_s,
        delay_s=delay_s,
        mode="GUIDED" if kind is ArduCopter else None,
        parameters=parameters,
    )


class Operator:
    """Selects the target, engages, is the pilot who selects OFFBOARD where that is asked for, and then does nothing."""

    def __init__(self) -> None:
        self._pressed_s = 0.0
        self._has_selected = False
        self.is_done = False

    def __call__(self, loop: Loop) -> None:
        mode = loop.moments[-1].mode if loop.moments else Mode.IDLE.value
        self.is_done = self.is_done or mode == Mode.FOLLOWING.value
        since_s = loop.time_s - self._pressed_s
        if self.is_done or loop.time_s < 0.5:
            return
        if not self._has_selected:
            self._has_selected = True
            loop.commands.append(Select(loop.truth.box))
        elif mode == Mode.READY.value and loop.autopilot.mode_name != "OFFBOARD":
            if since_s > 1.2:
                loop.autopilot.select_mode("OFFBOARD")
        elif mode in {Mode.TRACKING.value, Mode.READY.value} and since_s > 1.1:
            self._pressed_s = loop.time_s
            loop.commands.append(Engage())


def engaged(loop: Loop, for_s: float = 0.0) -> float:
    """Run until it follows, and on for a time; when it began to."""
    operator = Operator()
    latest_s = loop.time_s + 30.0
    while not operator.is_done:
        assert loop.time_s < latest_s, loop.moments[-1]
        loop.run(loop.time_s + 0.05, operator)
    began_s = loop.time_s
    loop.run(began_s + for_s)
    return began_s


def after(loop: Loop, time_s: float) -> list[Moment]:
    return [moment for moment in loop.moments if moment.time_s >= time_s]


def is_streamed(moments: list[Moment]) -> bool:
    return any(moment.setpoint_ned_mps is not None for moment in moments)


def sign_changes(values: list[float], least: float) -> int:
    """How often a value goes from beyond `least` on one side to beyond it on the other."""
    signs = [value > 0 for value in values if abs(value) > least]
    return sum(a != b for a, b in pairwise(signs))


# ---------------------------------------------------------------------------------------------- convergence
@BOTH
@pytest.mark.parametrize(("delay_s", "side"), [*zip(DELAYS_S, (1, -1, -1, 1), strict=True)])
def test_the_nose_turns_to_a_target_aside_and_rests(kind: type[Personality], delay_s: float, side: int) -> None:
    loop = looped(kind, off_nose_deg=side * 24, delay_s=delay_s, settings="")
    began_s = engaged(loop, 10.0)
    errors_deg = [math.degrees(moment.bearing_error_rad) for moment in after(loop, began_s)]
    assert side * errors_deg[0] > 20
    assert max(-side * error for error in errors_deg) < 2.0  # of overshoot
    assert all(abs(error) < 2.0 for error in errors_deg[100:])  # the dead zone, within 5 s
    assert sign_changes(errors_deg[100:], 0.5) == 0
    rates_dps = [math.degrees(moment.yaw_rate_radps or 0.0) for moment in after(loop, began_s + 8.0)]
    assert max(map(abs, rates_dps)) < 1.5
    assert all(moment.speed_mps < 0.1 for moment in after(loop, began_s))


@BOTH
@pytest.mark.parametrize(("delay_s", "range_m"), [*zip(DELAYS_S, (30.0, 18.0, 18.0, 30.0), strict=True)])
def test_a_range_is_taken_up_and_held(kind: type[Personality], delay_s: float, range_m: float) -> None:
    loop = looped(kind, f'[follow]\nmode="follow"\nrange_m={range_m}\n', delay_s=delay_s)
    began_s = engaged(loop, 18.0)
    ranges_m = [moment.true_range_m for moment in after(loop, began_s)]
    settled = after(loop, began_s + 13.0)
    assert abs(ranges_m[0] - range_m) > 4
    # the foot of the box is the car's rear, half a length before its middle, and the dead zone five per cent
    assert all(-0.05 * range_m < moment.true_range_m - range_m < 2.1 + 0.05 * range_m for moment in settled)
    assert min(ranges_m) > min(range_m, ranges_m[0]) - 0.05 * range_m  # no overshoot
    assert max(ranges_m) < max(range_m, ranges_m[0]) + 2.1 + 0.05 * range_m
    assert max(moment.speed_mps for moment in settled) < 0.5
    assert sign_changes([moment.velocity_ned_mps[0] for moment in settled], 0.25) <= 1


@BOTH
@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_overhead_comes_to_hover_above_the_target(kind: type[Personality], delay_s: float) -> None:
    loop = looped(kind, '[follow]\nmode="overhead"\n', place="overhead", delay_s=delay_s)
    north_m, east_m, down_m = loop.stage.start.pos_ned_m
    aside = replace(loop.stage, start=replace(loop.stage.start, pos_ned_m=(north_m + 6, east_m - 5, down_m)))
    loop = Loop(
        aside,
        kind,
        loop._config,
        TrueEyes(aside),
        wait_s=STANDING_S,
        delay_s=delay_s,
        mode="GUIDED" if kind is ArduCopter else None,
    )
    began_s = engaged(loop, 14.0)
    settled = after(loop, began_s + 10.0)
    assert max(moment.true_range_m for moment in settled) < 2.0
    assert max(moment.speed_mps for moment in settled) < 0.3
    assert all(abs(moment.pose.yaw_rad - settled[0].pose.yaw_rad) < 0.01 for moment in settled)


@BOTH
def test_a_target_that_drives_is_followed_at_its_speed(kind: type[Personality]) -> None:
    loop = looped(kind, '[follow]\nmode="follow"\n[limits]\nspeed_mps=8\n', wait_s=8.0)
    engaged(loop)
    loop.run(30.0)
    for moment in after(loop, 22.0):
        assert moment.mode in {Mode.FOLLOWING.value, Mode.COASTING.value}  # a lamp post comes by
        assert moment.speed_mps == pytest.approx(4.5, abs=1.5)
        assert abs(moment.bearing_error_rad) < math.radians(5)
        assert 15 < moment.true_range_m < 35


# ------------------------------------------------------------------------------------------------ the camera
@BOTH
@pytest.mark.parametrize("gap_s", [0.4, 2.0])
@pytest.mark.parametrize("fault", ["is_camera_dead", "is_camera_frozen"])
def test_frames_that_are_dropped_or_frozen_for_a_while_are_recovered_from(
    kind: type[Personality], gap_s: float, fault: str
) -> None:
    loop = looped(kind, wait_s=8.0)
    began_s = engaged(loop)
    loop.run(max(began_s, 8.0) + 4.0)
    before_s = loop.time_s
    loop.faults = replace(Faults(), **{fault: True})
    loop.run(before_s + gap_s)
    loop.faults = Faults()
    loop.run(before_s + gap_s + 6.0)
    assert all(abs(moment.bearing_error_rad) < math.radians(25) for moment in after(loop, before_s))
    for moment in after(loop, loop.time_s - 2.0):
        assert moment.mode in {Mode.FOLLOWING.value, Mode.COASTING.value}  # a lamp post comes by
        assert abs(moment.bearing_error_rad) < math.radians(5)
        assert moment.speed_mps > 2.0


@BOTH
def test_a_camera_that_stays_dead_ends_in_hold(kind: type[Personality]) -> None:
    loop = looped(kind)
    dead_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_camera_dead=True)
    loop.run(dead_s + 15.0)
    held = [moment for moment in after(loop, dead_s + 1.0) if moment.setpoint_ned_mps is not None]
    assert {(moment.setpoint_ned_mps, moment.yaw_rate_radps) for moment in held} == {((0.0, 0.0, 0.0), 0.0)}
    assert loop.autopilot.mode_name == HOLD[kind]
    assert not is_streamed(after(loop, dead_s + 14.0))
    assert loop.moments[-1].mode == Mode.LOST.value


@BOTH
def test_a_target_away_for_long_is_searched_for_by_turning_and_awaits_the_operators_word(
    kind: type[Personality],
) -> None:
    loop = looped(kind, '[follow]\nmode="follow"\n[loss]\nsearch_after_s=2\nsearch_yaw_rate_dps=8\n', wait_s=8.0)
    engaged(loop)
    loop.run(12.0)
    lost_s = loop.time_s
    loop.faults = Faults(is_camera_dead=True)
    loop.run(lost_s + 4.5)
    loop.faults = Faults()
    loop.run(lost_s + 8.0)
    modes = [mode for mode, _ in groupby(moment.mode for moment in after(loop, lost_s))]
    rungs = [Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.AWAITING]
    assert [mode for mode in modes if mode != Mode.FOLLOWING.value] == [mode.value for mode in rungs]
    searching = [moment for moment in after(loop, lost_s) if moment.mode == Mode.SEARCHING.value]
    assert {moment.setpoint_ned_mps for moment in searching} == {(0.0, 0.0, 0.0)}
    assert abs(searching[-1].yaw_rate_radps or 0.0) == pytest.approx(math.radians(8))
    awaiting = after(loop, lost_s + 6.0)
    assert {(moment.setpoint_ned_mps, moment.yaw_rate_radps) for moment in awaiting} == {((0.0, 0.0, 0.0), 0.0)}
    loop.commands.append(Engage())
    loop.run(loop.time_s + 6.0)
    assert loop.moments[-1].mode == Mode.FOLLOWING.value
    assert loop.moments[-1].speed_mps > 1.0


def test_an_engage_during_arducopters_take_off_is_refused_and_the_climb_goes_on() -> None:
    ground = stage("straight", 7)
    start = replace(ground.start, pos_ned_m=(*ground.start.pos_ned_m[:2], 0.0))
    loop = looped(ArduCopter, start=start)
    loop.run(45.0)  # it boots
    assert loop.autopilot.select_mode("GUIDED")
    assert loop.autopilot.arm()
    station = mavlink.MAVLink(BytesIO(), 255, 190)
    take_off = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 14.0)
    loop.autopilot.receive(bytes(take_off.pack(station)))

    def impatient(loop: Loop) -> None:
        if loop.autopilot.pose.pos_ned_m[2] < -3.0 and loop.truth.box is not None:
            is_first = not any(moment.box is not None for moment in loop.moments)
            loop.commands.append(Select(loop.truth.box) if is_first else Engage())

    loop.run(55.0, impatient)
    texts = [text for moment in loop.moments for text in moment.texts]
    assert any("still climbing or sinking" in text for text in texts)
    climbing = [m for m in loop.moments if m.time_s > 46 and m.pose.pos_ned_m[2] > -13.0]
    assert climbing
    assert not is_streamed(climbing)
    loop.run(75.0, impatient)
    assert loop.moments[-1].mode == Mode.FOLLOWING.value
    assert min(m.pose.pos_ned_m[2] for m in loop.moments) == pytest.approx(-14.0, abs=0.7)


# ------------------------------------------------------------------------------------- the link and ourselves
def stays_ended(loop: Loop, since_s: float) -> bool:
    """Whether from then on nothing is sent that moves the vehicle."""
    return all(moment.setpoint_ned_mps in {None, (0.0, 0.0, 0.0)} for moment in after(loop, since_s)) and not any(
        moment.mode in {Mode.FOLLOWING.value, Mode.COASTING.value} for moment in after(loop, since_s)
    )


@BOTH
def test_a_link_that_was_cut_for_long_ends_it_and_an_engage_begins_anew(kind: type[Personality]) -> None:
    loop = looped(kind, COM_OBL_RC_ACT=5.0) if kind is Px4 else looped(kind)
    cut_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_link_cut=True)
    loop.run(cut_s + 5.0)
    loop.faults = Faults()
    loop.run(cut_s + 12.0)
    assert stays_ended(loop, cut_s + 1.0)
    assert not is_streamed(after(loop, cut_s + 3.2))
    assert loop.autopilot.mode_name == ("GUIDED" if kind is ArduCopter else "AUTO.LOITER")
    if kind is Px4:
        loop.autopilot.select_mode("AUTO.LOITER")  # by the pilot, which ends the failsafe
        loop.run(loop.time_s + 1.1)
    engaged(loop, 1.0)
    assert loop.moments[-1].mode == Mode.FOLLOWING.value


def test_on_arducopter_a_link_cut_for_two_seconds_is_stood_through() -> None:
    loop = looped(ArduCopter)
    cut_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_link_cut=True)
    loop.run(cut_s + 2.0)
    loop.faults = Faults()
    loop.run(cut_s + 4.0)
    assert loop.moments[-1].mode == Mode.FOLLOWING.value


@pytest.mark.parametrize("cut_for_s", [1.2, 1.6, 2.0, 2.8])
def test_px4_that_left_offboard_in_a_cut_link_is_not_brought_back_by_our_stream(cut_for_s: float) -> None:
    loop = looped(Px4)
    cut_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_link_cut=True)
    loop.run(cut_s + cut_for_s)
    loop.faults = Faults()
    loop.run(cut_s + 8.0)
    assert loop.autopilot.mode_name != "OFFBOARD"
    assert not is_streamed(after(loop, cut_s + 1.2))


def test_arducopter_flies_on_for_three_seconds_without_us_then_stands_and_is_not_moved_again() -> None:
    loop = looped(ArduCopter, wait_s=8.0)
    engaged(loop)
    loop.run(16.0)
    speed_mps = loop.moments[-1].speed_mps
    assert speed_mps > 2.0
    loop.faults = Faults(is_app_stopped=True)
    loop.run(18.8)
    assert math.hypot(*loop.autopilot.velocity_ned_mps[:2]) > 0.8 * speed_mps
    loop.run(22.0)
    assert math.hypot(*loop.autopilot.velocity_ned_mps) < 0.3
    assert loop.autopilot.mode_name == "GUIDED"
    loop.faults = Faults()
    loop.run(26.0)
    assert stays_ended(loop, 22.0)
    assert loop.autopilot.mode_name == "BRAKE"
    assert "Follow ended: control loop stalled" in [text for moment in loop.moments for text in moment.texts]


@pytest.mark.parametrize(
    ("stopped_for_s", "action", "mode"),
    [
        (0.7, 0.0, "POSCTL"),
        (1.2, 0.0, "POSCTL"),
        (1.2, 5.0, "AUTO.LOITER"),
        (1.7, 0.0, "POSCTL"),
        (3.0, 5.0, "AUTO.LOITER"),
        (6.0, 3.0, "AUTO.RTL"),
    ],
)
def test_px4_leaves_offboard_without_us_and_does_not_come_back_with_us(
    stopped_for_s: float, action: float, mode: str
) -> None:
    loop = looped(Px4, COM_OBL_RC_ACT=action)
    stop_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_app_stopped=True)
    loop.run(stop_s + stopped_for_s)
    if stopped_for_s > 1.5:
        assert loop.autopilot.mode_name == mode
    loop.faults = Faults()
    loop.run(stop_s + stopped_for_s + 5.0)
    assert stays_ended(loop, stop_s + stopped_for_s)
    assert loop.autopilot.mode_name in {mode, "AUTO.LOITER"}
    assert not is_streamed(after(loop, loop.time_s - 2.0))


@BOTH
def test_killed_and_started_anew_it_is_disengaged_and_sends_nothing(kind: type[Personality]) -> None:
    loop = looped(kind, COM_OBL_RC_ACT=5.0) if kind is Px4 else looped(kind)
    kill_s = engaged(loop, 1.0) + 1.0
    loop.faults = Faults(is_app_stopped=True)
    loop.run(kill_s + 2.0)
    loop.follower = Follower(loop._config)
    loop.faults = Faults()
    loop.run(kill_s + 8.0)
    assert not is_streamed(after(loop, kill_s + 0.1))
    assert loop.moments[-1].mode == Mode.IDLE.value
    if kind is Px4:
        loop.autopilot.select_mode("AUTO.LOITER")  # by the pilot, which ends the failsafe
        loop.run(loop.time_s + 1.1)
    engaged(loop, 1.0)
    assert loop.autopilot.mode_name == EXTERNAL[kind]


@BOTH
def test_asked_to_end_it_leaves_the_vehicle_standing(kind: type[Personality]) -> None:
    loop = looped(kind, wait_s=8.0)
    engaged(loop)
    loop.run(15.0)
    loop.autopilot.receive(b"".join(loop.follower.farewell(OUR_CLOCK_S + loop.time_s)))
    loop.faults = Faults(is_app_stopped=True)
    loop.run(21.0)
    assert loop.autopilot.mode_name == HOLD[kind]
    assert math.hypot(*loop.autopilot.velocity_ned_mps) < 0.3


# ------------------------------------------------------------------------------------ the pilot, the vehicle
def take_mode(loop: Loop) -> None:
    assert loop.autopilot.select_mode(PILOT[loop_kind(loop)])


def take_stick(loop: Loop) -> None:
    loop.autopilot.set_sticks(roll=0.5)


def empty_battery(loop: Loop) -> None:
    loop.autopilot.battery_failsafe()


def lose_rc(loop: Loop) -> None:
    loop.autopilot.lose_rc()


def lose_gps(loop: Loop) -> None:
    loop.autopilot.lose_gps()


def reboot(loop: Loop) -> None:
    loop.autopilot.reboot()


def loop_kind(loop: Loop) -> type[Personality]:
    return type(loop.autopilot._personality)


@BOTH
@pytest.mark.parametrize(
    ("happen", "within_s", "modes"),
    [
        (take_mode, 1.1, PILOT),
        (take_stick, 3.2, PILOT),
        (empty_battery, 1.1, HOME),
        (lose_rc, 2.2, HOME),
        (lose_gps, 9.5, LAND),
    ],
)
def test_what_takes_the_vehicle_in_flight_ends_it_for_good(
    kind: type[Personality], happen: Callable[[Loop], None], within_s: float, modes: dict[type[Personality], str]
) -> None:
    loop = looped(kind)
    at_s = engaged(loop, 1.0) + 1.0
    happen(loop)
    loop.run(at_s + within_s)
    assert loop.autopilot.mode_name == modes[kind]
    ended_s = loop.time_s
    loop.run(ended_s + 3.0)
    assert not is_streamed(after(loop, ended_s))
    assert loop.autopilot.mode_name == modes[kind]


@BOTH
def test_the_mode_that_comes_back_moves_nothing(kind: type[Personality]) -> None:
    loop = looped(kind)
    at_s = engaged(loop, 1.0) + 1.0
    take_mode(loop)
    loop.run(at_s + 1.2)  # PX4 tells its mode once a second
    is_back = loop.autopilot.select_mode(EXTERNAL[kind])
    assert is_back is (kind is ArduCopter)  # PX4 does not come back, as nothing is streamed
    loop.run(at_s + 5.0)
    assert not is_streamed(after(loop, at_s + 1.2))
    assert loop.moments[-1].mode == Mode.TRACKING.value


@BOTH
def test_an_autopilot_that_restarts_in_flight_is_left_alone(kind: type[Personality]) -> None:
    loop = looped(kind)
    at_s = engaged(loop, 1.0) + 1.0
    reboot(loop)
    loop.run(at_s + 10.0)
    assert stays_ended(loop, at_s + 2.5)
    assert not is_streamed(after(loop, at_s + 2.5))
    assert any(text.startswith("Follow ended") for moment in loop.moments for text in moment.texts)
    assert loop.follower.is_connected(OUR_CLOCK_S + loop.time_s)


@BOTH
def test_the_operators_disengage_leaves_the_vehicle_holding(kind: type[Personality]) -> None:
    loop = looped(kind)
    engaged(loop, 1.0)
    loop.commands.append(Disengage())
    at_s = loop.time_s
    loop.run(at_s + 5.0)
    assert loop.autopilot.mode_name == HOLD[kind]
    assert not is_streamed(after(loop, at_s + 1.5))
    assert loop.moments[-1].mode == Mode.TRACKING.value


def test_px4_is_prepared_by_engage_and_followed_with_by_a_second_one_in_offboard() -> None:
    loop = looped(Px4)
    engaged(loop, 1.0)
    ready = [moment for moment in loop.moments if moment.mode == Mode.READY.value]
    assert {(moment.setpoint_ned_mps, moment.yaw_rate_radps) for moment in ready} == {((0.0, 0.0, 0.0), 0.0)}
    first = next(moment for moment in ready if moment.flight_mode == "OFFBOARD")
    assert first.time_s - ready[0].time_s > 1.0
    texts = [text for moment in loop.moments for text in moment.texts]
    assert texts.index("Ready: select OFFBOARD, then engage") < texts.index("Following (follow)")


# ------------------------------------------------------------------------------------------- time alignment
def bearing_errors_deg(loop: Loop) -> list[float]:
    """Of the estimate, at every step of the first 3 s of the turn towards a target aside."""
    found: list[float] = []
    end_s = engaged(loop) + 3.0
    while loop.time_s < end_s:
        loop.run(loop.time_s + 0.05)
        assert loop.step is not None
        target, moment = loop.step.control.target, loop.moments[-1]
        assert target is not None
        north_m, east_m = (t - p for t, p in zip(moment.target_ned_m[:2], moment.pose.pos_ned_m[:2], strict=True))
        found.append(math.degrees(math.remainder(target.bearing.value - math.atan2(east_m, north_m), math.tau)))
    assert max(moment.yaw_rate_radps or 0.0 for moment in loop.moments) > math.radians(20)
    return found


@pytest.mark.parametrize("telemetry_delay_s", [0.0, 0.1, 0.2])
def test_telemetry_that_always_was_late_moves_the_bearing_by_what_the_vehicle_turned_meanwhile(
    telemetry_delay_s: float,
) -> None:
    """A delay that never was shorter cannot be known; it costs the yaw rate times the delay, and no more."""
    loop = looped(ArduCopter, off_nose_deg=24, settings="", delay_s=0.1)
    loop._telemetry_delay_s = telemetry_delay_s
    errors_deg = bearing_errors_deg(loop)
    assert max(map(abs, errors_deg)) < 30 * telemetry_delay_s + 1.0
    assert abs(errors_deg[-1]) < 0.5


@pytest.mark.parametrize("telemetry_delay_s", [0.1, 0.2])
def test_telemetry_that_comes_late_does_not_move_the_bearing(telemetry_delay_s: float) -> None:
    """By its time stamps; what is not there yet is turned on by the last yaw rate."""
    loop = looped(ArduCopter, off_nose_deg=24, settings="", delay_s=0.1)
    loop.run(0.4)
    loop._telemetry_delay_s = telemetry_delay_s
    missed_deg = 0.5 * 90 * max(telemetry_delay_s - 0.05, 0.0) ** 2  # by the acceleration of the yaw
    assert max(map(abs, bearing_errors_deg(loop))) < missed_deg + 0.75
