"""What ends an engagement: every way, from every mode in which setpoints flow, on both autopilots."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from cockpit import STEP_S, ZERO, Cockpit, brought_to, sent, speed_mps

from companion.controller import ControlOutput
from companion.engagement import Reason
from companion.hearing import DEAF_MPS, DEAF_S
from companion.modes import Mode
from companion.types import (
    Autopilot,
    Deselect,
    Disengage,
    Engage,
    FlightMode,
    Heartbeat,
    Landed,
    LandedReading,
    LocalState,
    Parameter,
    Rebooted,
    Select,
    SetpointInForce,
)

STREAMING = [mode for mode in Mode if mode.is_streaming]
OBEYED = [mode for mode in STREAMING if mode is not Mode.LEAVING]
AUTOPILOTS = [*Autopilot]


def leave_mode(cockpit: Cockpit) -> None:
    cockpit.fly(FlightMode.PILOT)


def disarm(cockpit: Cockpit) -> None:
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=False)


def touch_ground(cockpit: Cockpit) -> None:
    cockpit.landed = Landed.ON_GROUND


def begin_landing(cockpit: Cockpit) -> None:
    cockpit.landed = Landed.LANDING


def reboot(cockpit: Cockpit) -> None:
    cockpit.step(events=(Rebooted(cockpit.now_s),))


ENDS: list[tuple[Callable[[Cockpit], None], Reason]] = [
    (leave_mode, Reason.MODE_LEFT),
    (disarm, Reason.DISARMED),
    (touch_ground, Reason.LANDED),
    (begin_landing, Reason.LANDED),
    (reboot, Reason.REBOOTED),
]


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", STREAMING)
@pytest.mark.parametrize(("end", "reason"), ENDS)
def test_what_takes_the_vehicle_away_ends_the_stream_at_once_and_for_good(
    end: Callable[[Cockpit], None], reason: Reason, mode: Mode, autopilot: Autopilot
) -> None:
    cockpit = brought_to(mode, autopilot)
    at = len(cockpit.outputs)
    end(cockpit)
    cockpit.step()
    is_by_itself = mode is Mode.LEAVING and reason is Reason.MODE_LEFT  # that was asked for
    assert (f"Follow ended: {reason.value}" in cockpit.texts) is not is_by_itself
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=True)
    cockpit.landed = Landed.IN_AIR
    cockpit.is_seen = True
    cockpit.run(1.0)
    cockpit.fly(FlightMode.EXTERNAL)  # the mode comes back
    cockpit.run(2.0)
    assert {(output.setpoint, output.request) for output in cockpit.outputs[at:]} == {(None, None)}
    assert cockpit.mode is Mode.TRACKING


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", OBEYED)
def test_after_the_mode_came_back_an_engage_starts_again(mode: Mode, autopilot: Autopilot) -> None:
    cockpit = brought_to(mode, autopilot)
    cockpit.fly(FlightMode.PILOT)
    cockpit.is_seen = True
    cockpit.run(1.0)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(1.0)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.FOLLOWING


@pytest.mark.parametrize("mode", STREAMING)
def test_a_mode_that_was_left_and_came_back_within_one_step_was_left(mode: Mode) -> None:
    cockpit = brought_to(mode)
    away = replace(cockpit.heartbeat, mode=FlightMode.PILOT, time_s=cockpit.now_s)
    cockpit.step(events=(away,))
    assert not cockpit.mode.is_streaming
    assert cockpit.controller.vehicle.heartbeat is not None
    assert cockpit.controller.vehicle.heartbeat.mode is FlightMode.EXTERNAL


def test_a_landing_that_was_over_within_one_step_was_one() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.step(events=(LandedReading(cockpit.now_s, Landed.ON_GROUND),))
    assert cockpit.mode is Mode.TRACKING


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", STREAMING)
def test_an_autopilot_unheard_for_three_seconds_is_sent_nothing(mode: Mode, autopilot: Autopilot) -> None:
    cockpit = brought_to(mode, autopilot)
    cockpit.muted = {"heartbeat"}
    assert all(output.mode.is_streaming for output in cockpit.run(3.0))
    outputs = cockpit.run(5.0)
    assert {output.setpoint for output in outputs[1:]} == {None}
    assert f"Follow ended: {Reason.NO_HEARTBEAT.value}" in cockpit.texts


@pytest.mark.parametrize("mode", OBEYED)
@pytest.mark.parametrize("channel", [0, 1, 3])
@pytest.mark.parametrize("pwm_us", [1379, 1621])
def test_a_stick_held_for_200_ms_stops_at_once_and_asks_for_the_pilots_mode_when_the_autopilot_has_been_heard(
    mode: Mode, channel: int, pwm_us: int
) -> None:
    cockpit = brought_to(mode)
    pwm = [1500] * 4
    pwm[channel] = pwm_us
    cockpit.pwm_us = (pwm[0], pwm[1], pwm[2], pwm[3])
    assert all(output.mode is not Mode.LEAVING for output in cockpit.run(0.25))  # the first step begins the time
    output = cockpit.step()
    assert (output.mode, output.request) == (Mode.LEAVING, None)  # the pilot may have selected a mode by now
    assert sent(output) == ZERO
    assert f"Follow ended: {Reason.STICKS.value}" in cockpit.texts
    outputs = cockpit.run(1.2)
    assert {sent(output) for output in outputs} == {ZERO}
    assert [output.request for output in outputs if output.request is not None] == [FlightMode.PILOT]


@pytest.mark.parametrize("mode", OBEYED)
def test_a_stick_that_only_twitches_or_trembles_ends_nothing(mode: Mode) -> None:
    cockpit = brought_to(mode)
    for _ in range(5):
        cockpit.pwm_us = (1700, 1500, 1500, 1500)
        cockpit.run(0.1875)
        cockpit.pwm_us = (1500, 1500, 1500, 1500)
        cockpit.run(0.125)
    cockpit.pwm_us = (1619, 1381, 1000, 1500)  # inside the guard; and throttle rests anywhere
    cockpit.run(0.5)
    assert cockpit.mode is not Mode.LEAVING
    assert cockpit.mode.is_streaming


def test_a_stick_while_leaving_asks_for_the_pilots_mode_instead() -> None:
    cockpit = brought_to(Mode.LEAVING)
    assert cockpit.outputs[-1].request is FlightMode.HOLD
    cockpit.pwm_us = (1500, 1800, 1500, 1500)
    requests = [output.request for output in cockpit.run(2.5) if output.request]
    assert requests == [FlightMode.PILOT] * 2


@pytest.mark.parametrize("pwm_us", [(), (0, 0, 0, 0)])
def test_a_lost_transmitter_moves_no_stick(pwm_us: tuple[int, ...]) -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.pwm_us = pwm_us
    cockpit.run(1.0)
    assert cockpit.mode is Mode.FOLLOWING


@pytest.mark.parametrize("mode", OBEYED)
def test_a_failsafe_of_a_vehicle_that_still_obeys_asks_for_hold(mode: Mode) -> None:
    cockpit = brought_to(mode)
    cockpit.heartbeat = replace(cockpit.heartbeat, has_failsafe=True)
    output = cockpit.step()
    assert (output.mode, output.request, sent(output)) == (Mode.LEAVING, FlightMode.HOLD, ZERO)
    assert f"Follow ended: {Reason.FAILSAFE.value}" in cockpit.texts


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("mode", OBEYED)
@pytest.mark.parametrize("gap_s", [0.55, 1.5, 60.0])
def test_a_loop_that_stalled_does_not_go_on_by_itself(gap_s: float, mode: Mode, autopilot: Autopilot) -> None:
    cockpit = brought_to(mode, autopilot)
    is_px4 = cockpit.heartbeat.autopilot is Autopilot.PX4  # whoever asked for what: READY is PX4's alone
    cockpit.is_seen = True
    output = cockpit.step(dt_s=gap_s)
    assert f"Follow ended: {Reason.STALLED.value}" in cockpit.texts
    if is_px4 and gap_s > 1:  # its own time-out has run: a stream would bring OFFBOARD back, whoever flies it now
        assert (output.mode, output.request, sent(output)) == (Mode.TRACKING, None, None)
        assert {sent(later) for later in cockpit.run(2.0)} == {None}
        assert Reason.RESUME_GUARD.value in cockpit.step(Engage()).texts[0].text
        return
    request = FlightMode.HOLD if is_px4 else None  # not before the mode of now has been heard
    assert (output.mode, output.request, sent(output)) == (Mode.LEAVING, request, ZERO)
    cockpit.is_seen = True
    later = cockpit.run(1.5)
    assert {output.mode for output in later} == {Mode.LEAVING}
    assert {sent(output) for output in later} == {ZERO}
    assert FlightMode.HOLD in {output.request for output in later}


def test_px4_with_a_longer_time_out_is_stopped_by_a_loop_that_stalled() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.step(events=(Parameter("COM_OF_LOSS_T", 5.0),))
    output = cockpit.step(dt_s=3.0)
    assert (output.mode, output.request, sent(output)) == (Mode.LEAVING, FlightMode.HOLD, ZERO)


def test_after_a_stall_the_pilot_who_took_an_arducopter_meanwhile_keeps_it() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    outputs = [cockpit.step(dt_s=3.0)]  # its heartbeat has waited in the port: it is of before
    cockpit.fly(FlightMode.PILOT)
    outputs += cockpit.run(2.0)
    assert {output.request for output in outputs} == {None}
    assert cockpit.mode is Mode.TRACKING


def test_a_loop_that_stumbles_goes_on() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    assert cockpit.step(dt_s=0.45).mode.is_engaged
    cockpit.run(0.125)
    assert cockpit.mode is Mode.FOLLOWING


def test_a_loop_that_stalled_while_the_mode_was_left_asks_for_nothing() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.fly(FlightMode.PILOT)
    output = cockpit.step(dt_s=3.0)
    assert (output.setpoint, output.request) == (None, None)


def in_force(cockpit: Cockpit, speed_mps: float) -> ControlOutput:
    """A step in which the autopilot says what it steers by."""
    return cockpit.step(events=(SetpointInForce(cockpit.now_s, (speed_mps, 0.0, 0.0)),))


def test_an_arducopter_that_steers_by_zero_though_told_to_move_does_not_hear_us_and_is_left() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.velocity_ned_mps = (0.0, 0.0, 0.0)
    assert speed_mps(cockpit.outputs[-1]) > DEAF_MPS
    outputs = [in_force(cockpit, 0.0) for _ in range(40)]
    left = next(index for index, output in enumerate(outputs) if output.mode is Mode.LEAVING)
    assert left / 16 == pytest.approx(DEAF_S, abs=0.1)
    assert f"Follow ended: {Reason.NOT_OBEYED.value}" in cockpit.texts
    assert outputs[left].request is FlightMode.HOLD


def test_zeros_from_the_time_of_a_stall_of_ours_end_it_as_a_stall() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    times_s = [cockpit.now_s + 0.5 * k for k in range(1, 7)]
    output = cockpit.step(events=tuple(SetpointInForce(t, ZERO[0]) for t in times_s), dt_s=3.0)
    assert f"Follow ended: {Reason.STALLED.value}" in cockpit.texts
    assert output.request is None  # the heartbeat may be as old


def test_one_zero_alone_says_nothing() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    in_force(cockpit, 0.0)
    cockpit.run(5.0)
    assert cockpit.mode is Mode.FOLLOWING


def test_an_autopilot_that_obeys_now_and_then_hears_us() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    for _ in range(4):
        for _ in range(24):
            in_force(cockpit, 0.0)
        in_force(cockpit, 1.0)
    assert cockpit.mode is Mode.FOLLOWING


def test_px4_leaves_offboard_by_itself_where_it_does_not_hear_us() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    for _ in range(60):
        in_force(cockpit, 0.0)
    assert cockpit.mode is Mode.FOLLOWING


def test_zero_in_force_says_nothing_while_we_stand() -> None:
    cockpit = brought_to(Mode.HOLDING)
    for _ in range(60):
        in_force(cockpit, 0.0)
    assert f"Follow ended: {Reason.NOT_OBEYED.value}" not in cockpit.texts


def moved_frame(jump_m: float) -> tuple[Cockpit, ControlOutput, ControlOutput]:
    """A vehicle whose local frame is moved to the north from a step on, and the outputs around it."""
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {"local"}
    place = 0.0
    outputs = []
    for index in range(32):
        place = jump_m if index >= 16 else 0.0
        now_s = cockpit.now_s + STEP_S
        outputs.append(cockpit.step(events=(LocalState(now_s, (place, 0.0, -14.0), (0.0, 0.0, 0.0)),)))
    return cockpit, outputs[15], outputs[16]


def test_a_jump_of_the_local_frame_moves_neither_the_target_nor_the_start() -> None:
    cockpit, before, after = moved_frame(400.0)  # limits.radius_m is far less
    assert "Local position jumped: start shifted" in cockpit.texts
    assert before.setpoint is not None
    assert after.setpoint is not None
    assert math.dist(before.setpoint.velocity_ned_mps, after.setpoint.velocity_ned_mps) < 0.3
    assert "at limits.radius_m" not in after.notes
    last = cockpit.outputs[-1]
    assert last.target is not None
    place = last.target.place_ne_m(cockpit.now_s)
    assert place is not None
    assert place[0] == pytest.approx(400.0 + (last.target.fix.range_m if last.target.fix else 0.0), abs=5.0)
    velocity = last.target.velocity_ne_mps
    assert velocity is not None
    assert math.hypot(*velocity) < 2.0  # the target did not run


def test_a_small_step_is_no_jump() -> None:
    cockpit, _, _ = moved_frame(1.9)
    assert "Local position jumped: start shifted" not in cockpit.texts


def test_a_vehicle_that_moves_is_no_jump() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {"local"}
    start_s = cockpit.now_s
    for _ in range(5):
        cockpit.run(0.375)
        now_s = cockpit.now_s + STEP_S  # 0.44 s after the last one: 4.4 m away, 4.8 m at the first
        place = 10.0 * (now_s - start_s)
        cockpit.step(events=(LocalState(now_s, (place, 0.0, -14.0), (10.0, 0.0, 0.0)),))
    assert "Local position jumped: start shifted" not in cockpit.texts


def test_px4_unheard_for_a_second_is_sent_nothing_as_it_may_not_hear_us_either() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.muted = {"heartbeat", "attitude", "local", "height", "landed", "rc"}
    outputs = cockpit.run(1.5)
    assert {speed_mps(output) for output in outputs[5:]} == {0.0}  # no attitude for 0.3 s
    assert {output.setpoint for output in outputs[17:]} == {None}
    assert f"Follow ended: {Reason.LINK_SILENT.value}" in cockpit.texts
    cockpit.muted = set()
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(0.5)
    cockpit.step(Engage())  # a stream now would bring OFFBOARD back by itself
    assert cockpit.outputs[-1].request is FlightMode.HOLD
    assert cockpit.outputs[-1].setpoint is None


def test_px4_that_is_heard_again_at_once_after_the_silence_may_have_left_by_failsafe_all_the_same() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.muted = {"heartbeat", "attitude", "local", "height", "landed", "rc"}
    cockpit.run(1.0625)
    assert cockpit.mode is Mode.TRACKING
    cockpit.muted = set()
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(0.25)
    output = cockpit.step(Engage())
    assert (output.request, output.setpoint) == (FlightMode.HOLD, None)


@pytest.mark.parametrize("gap_s", [0.55, 3.0])
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_stall_while_leaving_takes_nothing_from_a_pilot_who_came_meanwhile(
    autopilot: Autopilot, gap_s: float
) -> None:
    cockpit = brought_to(Mode.LEAVING, autopilot)
    cockpit.run(1.5)  # a request is due again
    output = cockpit.step(dt_s=gap_s)  # the heartbeat that is read now was sent before
    is_gone = autopilot is Autopilot.PX4 and gap_s > 1
    if gap_s > 1 or autopilot is Autopilot.ARDUPILOT:
        assert output.request is None
    assert sent(output) == (None if is_gone else ZERO)
    cockpit.fly(FlightMode.PILOT)
    assert {output.request for output in cockpit.run(3.0)} == {None}
    assert not cockpit.mode.is_streaming


def test_px4_that_still_obeys_long_after_a_stall_is_asked_to_hold_without_a_stream() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.step(dt_s=3.0)  # nobody could read COM_OF_LOSS_T, and it is longer
    assert cockpit.mode is Mode.TRACKING
    outputs = cockpit.run(1.4)
    assert {output.request for output in outputs} == {None}
    outputs = cockpit.run(2.0)
    assert [output.request for output in outputs].count(FlightMode.HOLD) == 2
    assert {output.setpoint for output in outputs} == {None}
    cockpit.fly(FlightMode.HOLD)
    assert {output.request for output in cockpit.run(3.0)} == {None}


def test_the_operator_can_have_it_held_at_once() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.step(dt_s=3.0)
    output = cockpit.step(Disengage())
    assert (output.request, output.setpoint) == (FlightMode.HOLD, None)


def test_px4_in_offboard_that_was_never_ours_is_asked_for_nothing() -> None:
    cockpit = Cockpit(autopilot=Autopilot.PX4).track()
    outputs = [cockpit.step(Disengage()), *cockpit.run(5.0)]
    assert {output.request for output in outputs} == {None}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_setpoints_that_the_port_does_not_take_are_a_stall(autopilot: Autopilot) -> None:
    cockpit = brought_to(Mode.FOLLOWING, autopilot)
    cockpit.is_sent = False
    cockpit.run(0.25)
    assert cockpit.mode is Mode.FOLLOWING
    cockpit.run(0.5)
    assert f"Follow ended: {Reason.STALLED.value}" in cockpit.texts
    cockpit.is_sent = True
    cockpit.run(0.5)
    assert not cockpit.mode.is_engaged


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_position_that_was_away_for_long_does_not_move_the_vehicle_when_it_is_back(autopilot: Autopilot) -> None:
    cockpit = brought_to(Mode.FOLLOWING, autopilot)
    cockpit.muted = {"local"}
    cockpit.run(2.5)
    assert cockpit.mode is Mode.FOLLOWING
    outputs = cockpit.run(2.0)
    assert cockpit.mode is Mode.LEAVING
    assert f"Follow ended: {Reason.NO_POSITION.value}" in cockpit.texts
    assert FlightMode.HOLD in {output.request for output in outputs}
    cockpit.muted = set()
    assert {sent(output) for output in cockpit.run(2.0)} == {ZERO}


def test_arducopter_unheard_for_a_second_is_told_to_stand_and_followed_on() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {"heartbeat", "attitude", "local", "height", "landed", "rc"}
    outputs = cockpit.run(1.5)
    assert {sent(output) for output in outputs[7:]} == {ZERO}
    cockpit.muted = set()
    cockpit.run(1.0)
    assert cockpit.mode is Mode.FOLLOWING


# ------------------------------------------------------------------------------------- our own will
@pytest.mark.parametrize("mode", OBEYED)
def test_disengage_stands_and_asks_for_hold_until_the_autopilot_has_left(mode: Mode) -> None:
    cockpit = brought_to(mode)
    output = cockpit.step(Disengage())
    assert (output.mode, output.request, sent(output)) == (Mode.LEAVING, FlightMode.HOLD, ZERO)
    outputs = cockpit.run(3.0)
    assert {sent(each) for each in outputs} == {ZERO}
    assert [each.request for each in outputs if each.request] == [FlightMode.HOLD] * 3  # once a second
    cockpit.fly(FlightMode.HOLD)
    assert cockpit.step().setpoint is None
    cockpit.is_seen = True
    cockpit.run(0.1)
    assert cockpit.mode is Mode.TRACKING


@pytest.mark.parametrize("mode", OBEYED)
def test_deselect_ends_it_likewise_and_leads_to_idle(mode: Mode) -> None:
    cockpit = brought_to(mode)
    output = cockpit.step(Deselect())
    assert (output.mode, output.request, sent(output)) == (Mode.LEAVING, FlightMode.HOLD, ZERO)
    assert output.selection.box is None
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(0.1)
    assert cockpit.mode is Mode.IDLE


@pytest.mark.parametrize("command", [Select(None), Deselect(), Disengage(), Engage()])
def test_while_leaving_no_order_stops_the_leaving_or_changes_where_to(command: Select) -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.pwm_us = (1500, 1800, 1500, 1500)
    cockpit.run(0.3)
    cockpit.pwm_us = (1500, 1500, 1500, 1500)
    assert cockpit.mode is Mode.LEAVING
    cockpit.step(command)
    outputs = cockpit.run(2.0)
    assert cockpit.mode is Mode.LEAVING
    assert {output.request for output in outputs if output.request} == {FlightMode.PILOT}
    assert {sent(output) for output in outputs} == {ZERO}


def test_shutting_down_asks_for_hold_or_what_was_asked_for_and_only_where_we_are_obeyed() -> None:
    assert brought_to(Mode.FOLLOWING).controller.shut_down() is FlightMode.HOLD
    assert Cockpit().track().controller.shut_down() is None
    leaving = brought_to(Mode.LEAVING)
    leaving.pwm_us = (1500, 1800, 1500, 1500)
    leaving.run(0.3)
    assert leaving.controller.shut_down() is FlightMode.PILOT
    leaving.step(Engage())
    assert leaving.outputs[-1].setpoint is None


def test_another_autopilots_heartbeat_type_never_reaches_a_mode() -> None:
    """A heartbeat that says failsafe while nothing is engaged asks for nothing."""
    cockpit = Cockpit().track()
    beat = replace(cockpit.heartbeat, has_failsafe=True)
    assert isinstance(beat, Heartbeat)
    cockpit.heartbeat = beat
    output = cockpit.step()
    assert (output.request, output.setpoint) == (None, None)
