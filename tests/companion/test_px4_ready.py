"""PX4 takes OFFBOARD only from a stream, and comes back to it by itself: mode READY, and the guard after a gap."""

from dataclasses import replace

import pytest
from cockpit import FOLLOW, ZERO, Cockpit, brought_to, sent

from companion.controller import READY_FOR_S
from companion.engagement import Reason
from companion.modes import Mode
from companion.types import Autopilot, Deselect, Engage, FlightMode, ModeAnswer, Rebooted, Select

ASKED, PREPARED = "Asked PX4 for Hold: engage again", "Ready: select OFFBOARD, then engage"
YES, NO = ModeAnswer(is_accepted=True), ModeAnswer(is_accepted=False)


def on_ground(mode: FlightMode = FlightMode.HOLD) -> Cockpit:
    """PX4 heard for the first time while disarmed: no earlier run of ours can have left it a stream."""
    cockpit = Cockpit(autopilot=Autopilot.PX4)
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=False)
    cockpit.fly(mode)
    cockpit.step()
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=True)
    return cockpit


def ready() -> Cockpit:
    cockpit = on_ground()
    cockpit.track().step(Engage())
    assert cockpit.mode is Mode.READY
    return cockpit


def left_by_failsafe(mode: FlightMode = FlightMode.RTL) -> Cockpit:
    """Our loop stalled for 2 s, and PX4's own time-out ran."""
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.fly(mode)
    cockpit.step(dt_s=2.0)
    cockpit.run(0.5)
    assert cockpit.mode is Mode.TRACKING
    return cockpit


def test_engage_outside_of_offboard_lets_zero_setpoints_flow_and_asks_for_nothing() -> None:
    cockpit = ready()
    outputs = cockpit.run(5.0)
    assert {(sent(output), output.request, output.mode) for output in outputs} == {(ZERO, None, Mode.READY)}
    assert PREPARED in cockpit.texts


def test_selected_offboard_alone_moves_nothing_and_a_second_engage_follows() -> None:
    cockpit = ready()
    cockpit.run(1.5)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.box = replace(cockpit.box, x=400)
    assert {sent(output) for output in cockpit.run(2.0)} == {ZERO}
    output = cockpit.step(Engage())
    assert output.mode is Mode.FOLLOWING
    assert sent(output) != ZERO


def test_a_second_engage_before_offboard_is_refused_and_the_stream_goes_on() -> None:
    cockpit = ready()
    output = cockpit.step(Engage())
    assert output.texts[0].text == f"Engage refused: {Reason.WRONG_MODE.value}"
    assert (output.mode, sent(output)) == (Mode.READY, ZERO)


def test_the_stream_ends_by_itself_where_offboard_is_not_selected() -> None:
    cockpit = ready()
    cockpit.run(READY_FOR_S)
    assert cockpit.mode is Mode.READY
    outputs = cockpit.run(0.25)
    assert outputs[-1].setpoint is None
    assert {output.request for output in outputs} == {None}
    assert f"Not engaged: {Reason.OFFBOARD_NOT_SELECTED.value}" in cockpit.texts


def test_offboard_selected_and_never_engaged_is_left_for_hold() -> None:
    cockpit = ready()
    cockpit.fly(FlightMode.EXTERNAL)
    outputs = cockpit.run(READY_FOR_S + 0.25)
    assert (outputs[-1].mode, sent(outputs[-1])) == (Mode.LEAVING, ZERO)
    assert FlightMode.HOLD in {output.request for output in outputs}


@pytest.mark.parametrize("end", ["missed", "deselected", "another"])
def test_without_its_target_the_stream_ends(end: str) -> None:
    cockpit = ready()
    cockpit.is_seen = end != "missed"
    commands = {"missed": (), "deselected": (Deselect(),), "another": (Select(None),)}[end]
    cockpit.step(*commands)
    outputs = cockpit.run(0.5)
    assert outputs[-1].setpoint is None
    assert {output.request for output in outputs} == {None}


def test_a_target_missed_in_ready_is_said() -> None:
    cockpit = ready()
    cockpit.is_seen = False
    cockpit.run(1.0)
    assert "Not engaged: no target" in cockpit.texts


def test_while_the_pilot_still_flies_the_sticks_do_not_end_the_stream() -> None:
    cockpit = on_ground(FlightMode.PILOT)
    cockpit.track().step(Engage())
    cockpit.pwm_us = (1700, 1500, 1500, 1500)
    assert {output.mode for output in cockpit.run(2.0)} == {Mode.READY}


def test_arducopter_is_never_made_ready() -> None:
    cockpit = Cockpit()
    cockpit.fly(FlightMode.PILOT)
    output = cockpit.track().step(Engage())
    assert output.texts[0].text == f"Engage refused: {Reason.WRONG_MODE.value}"
    assert output.setpoint is None


@pytest.mark.parametrize("reason", ["is_armed", "has_failsafe"])
def test_with_any_other_reason_against_it_no_stream_begins(reason: str) -> None:
    cockpit = on_ground().track()
    cockpit.heartbeat = replace(cockpit.heartbeat, **{reason: reason == "has_failsafe"})
    assert cockpit.step(Engage()).setpoint is None


# ------------------------------------------------------------------------------------------------ the guard
def test_after_a_gap_of_ours_hold_is_commanded_before_any_new_stream() -> None:
    cockpit = left_by_failsafe(FlightMode.HOLD)
    output = cockpit.step(Engage())
    assert (output.request, output.setpoint, output.texts[0].text) == (FlightMode.HOLD, None, ASKED)
    cockpit.step(events=(YES, YES))
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(0.25)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY


def test_px4_says_yes_before_it_says_no_and_only_the_last_word_counts() -> None:
    cockpit = left_by_failsafe(FlightMode.HOLD)
    cockpit.step(Engage())
    cockpit.step(events=(YES, NO))
    cockpit.run(1.0)
    assert cockpit.step(Engage()).texts[0].text == ASKED
    cockpit.step(events=(YES, YES))
    cockpit.run(0.125)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY


def test_an_answer_from_before_the_gap_does_not_count() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.step(events=(YES,))
    cockpit.fly(FlightMode.HOLD)
    cockpit.step(dt_s=2.0)
    cockpit.run(0.5)
    assert cockpit.step(Engage()).texts[0].text == ASKED


@pytest.mark.parametrize("mode", [FlightMode.PILOT, FlightMode.OTHER, FlightMode.LAND, FlightMode.RTL])
def test_hold_is_not_commanded_where_the_sticks_fly_or_it_goes_home(mode: FlightMode) -> None:
    cockpit = left_by_failsafe(mode)
    output = cockpit.step(Engage())
    assert (output.request, output.setpoint) == (None, None)
    assert "Engage refused" in output.texts[0].text
    assert Reason.RESUME_GUARD.value in output.texts[0].text


def test_hold_is_not_commanded_while_px4_says_failsafe_as_that_may_be_its_battery() -> None:
    cockpit = left_by_failsafe(FlightMode.RTL)
    cockpit.heartbeat = replace(cockpit.heartbeat, has_failsafe=True)
    cockpit.step()
    output = cockpit.step(Engage())
    assert (output.request, output.setpoint) == (None, None)
    assert Reason.FAILSAFE.value in output.texts[0].text


def test_a_mode_that_the_pilot_selects_afterwards_is_a_command_too() -> None:
    cockpit = left_by_failsafe(FlightMode.RTL)
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(0.25)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY


@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.PILOT])
def test_an_offboard_left_by_px4s_own_failsafe_is_a_gap_too_where_only_our_words_were_lost(mode: FlightMode) -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.heartbeat = replace(cockpit.heartbeat, mode=mode, has_failsafe=True)
    cockpit.step()
    assert cockpit.mode is Mode.TRACKING
    cockpit.heartbeat = replace(cockpit.heartbeat, has_failsafe=False)
    cockpit.run(0.5)
    output = cockpit.step(Engage())
    assert (output.request is FlightMode.HOLD) is (mode is FlightMode.HOLD)
    assert output.setpoint is None
    assert cockpit.mode is Mode.TRACKING


@pytest.mark.parametrize("mode", [FlightMode.RTL, FlightMode.LAND])
def test_a_way_home_that_nobody_here_asked_for_may_be_a_failsafe(mode: FlightMode) -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.fly(mode)
    cockpit.run(0.5)
    output = cockpit.step(Engage())
    assert Reason.RESUME_GUARD.value in output.texts[0].text
    assert (output.request, output.setpoint) == (None, None)


def test_a_pilot_who_took_over_may_have_it_followed_again_at_once() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.fly(FlightMode.PILOT)
    cockpit.run(0.5)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY


def test_a_failsafe_that_goes_on_to_land_is_no_command() -> None:
    cockpit = left_by_failsafe(FlightMode.HOLD)
    cockpit.fly(FlightMode.RTL)
    cockpit.run(0.25)
    assert Reason.RESUME_GUARD.value in cockpit.step(Engage()).texts[0].text


def test_who_starts_in_the_air_commands_hold_first() -> None:
    cockpit = Cockpit(autopilot=Autopilot.PX4)
    cockpit.fly(FlightMode.HOLD)
    assert cockpit.track().step(Engage()).texts[0].text == ASKED


def test_an_autopilot_that_starts_anew_in_the_air_is_guarded_against_likewise() -> None:
    cockpit = on_ground().track()
    cockpit.step(events=(Rebooted(cockpit.now_s),))
    cockpit.run(0.25)
    assert cockpit.step(Engage()).texts[0].text == ASKED


def test_who_starts_in_the_air_in_offboard_just_engages() -> None:
    cockpit = Cockpit(FOLLOW, Autopilot.PX4).track()
    assert cockpit.step(Engage()).mode is Mode.FOLLOWING


def test_a_mode_left_while_our_stream_ran_leaves_no_guard() -> None:
    cockpit = brought_to(Mode.FOLLOWING, Autopilot.PX4)
    cockpit.fly(FlightMode.PILOT)
    cockpit.run(0.5)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY


# ------------------------------------------------------------------------------- the switch that waits for OFFBOARD
SWITCHED = FOLLOW + '[rc]\nswitch_channel=5\nswitch="engage"\n'


def switched(config: str = SWITCHED) -> Cockpit:
    """READY by the transmitter's switch, in Hold."""
    cockpit = Cockpit(config, Autopilot.PX4)
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=False)
    cockpit.fly(FlightMode.HOLD)
    turn(cockpit, 1100)
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=True)
    cockpit.track()
    turn(cockpit, 1900)
    assert cockpit.mode is Mode.READY
    return cockpit


def turn(cockpit: Cockpit, us: int) -> None:
    cockpit.pwm_us = (*cockpit.pwm_us[:4], us)
    cockpit.run(0.5)


def test_the_switch_and_then_offboard_follow() -> None:
    cockpit = switched()
    assert "Ready: OFFBOARD starts following" in cockpit.texts
    assert PREPARED not in cockpit.texts
    cockpit.run(2.0)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(0.25)
    assert cockpit.mode is Mode.FOLLOWING


def test_offboard_after_the_switch_was_taken_back_follows_nothing() -> None:
    cockpit = switched()
    turn(cockpit, 1100)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(2.0)
    assert not cockpit.mode.is_engaged


def test_a_switch_that_was_on_before_does_not_engage_what_somebody_else_has_prepared() -> None:
    cockpit = switched()
    cockpit.run(READY_FOR_S + 1)
    assert cockpit.mode is Mode.TRACKING
    cockpit.step(Engage())
    assert cockpit.mode is Mode.READY
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(2.0)
    assert cockpit.mode is Mode.READY


def test_a_switch_of_three_positions_engages_twice_as_every_other_order() -> None:
    cockpit = switched(FOLLOW + "[rc]\nswitch_channel=5\n")
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(2.0)
    assert cockpit.mode is Mode.READY


def test_after_the_pilot_has_taken_over_the_resting_switch_engages_no_more() -> None:
    cockpit = switched()
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(0.5)
    cockpit.fly(FlightMode.PILOT)
    cockpit.run(0.5)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(5.0)
    assert cockpit.mode is Mode.TRACKING
    assert sent(cockpit.outputs[-1]) is None


@pytest.mark.parametrize("is_mute", [True, False])
def test_a_switch_whose_transmitter_is_gone_engages_nothing(*, is_mute: bool) -> None:
    cockpit = switched()
    if is_mute:
        cockpit.muted.add("rc")
    else:
        cockpit.pwm_us = (0, 0, 0, 0, 0)
    cockpit.run(3.0)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(2.0)
    assert cockpit.mode is Mode.READY
    assert {sent(output) for output in cockpit.outputs[-20:]} == {ZERO}
