"""The controller as a whole: freshness, nonsense from outside, and what holds in every sequence of events."""

import math
from dataclasses import replace

import pytest
from cockpit import AHEAD, CAMERA, FOLLOW, SIZE_HW, STEP_S, ZERO, Cockpit, brought_to, sent, speed_mps
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import parse
from companion.controller import Controller
from companion.modes import Mode
from companion.types import (
    Attitude,
    Autopilot,
    AutopilotText,
    ControlInput,
    Deselect,
    Direction,
    Disengage,
    Engage,
    FlightMode,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LocalState,
    ModeAnswer,
    Parameter,
    RangeReading,
    RcChannels,
    Rebooted,
    Select,
    TrackSample,
)
from mscf import Box, TrackStatus

MOVING = {Mode.FOLLOWING, Mode.COASTING, Mode.SEARCHING}
OVERHEAD = CAMERA.replace("mount_pitch_deg=-30", "mount_pitch_deg=-90") + '[follow]\nmode="overhead"\n'


# ------------------------------------------------------------------------------------------------ freshness
@pytest.mark.parametrize(("name", "age_s"), [("attitude", 0.3), ("local", 0.5), ("heartbeat", 2.0)])
def test_an_input_that_grows_old_stops_the_vehicle_and_its_return_moves_it_again(name: str, age_s: float) -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {name}
    outputs = cockpit.run(2.5)
    is_late = [k * STEP_S > age_s for k in range(1, len(outputs) + 1)]
    assert [sent(output) == ZERO for output in outputs] == is_late
    assert outputs[-1].notes != ()
    cockpit.muted = set()
    cockpit.run(0.5)
    assert cockpit.mode is Mode.FOLLOWING
    assert sent(cockpit.outputs[-1]) != ZERO


def test_frames_that_stop_move_the_vehicle_for_0_3_s_and_turn_it_for_half_a_second() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {"frames"}
    outputs = cockpit.run(2.0)
    assert {output.mode for output in outputs[5:8]} == {Mode.COASTING}
    speeds = [speed_mps(output) for output in outputs[4:]]
    assert speeds == sorted(speeds, reverse=True)
    assert {sent(output) for output in outputs[10:30]} == {ZERO}


def test_without_an_attitude_at_the_frames_time_a_frame_is_no_measurement() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.muted = {"attitude"}
    cockpit.run(1.0)
    assert cockpit.mode is not Mode.FOLLOWING
    cockpit.muted = set()
    cockpit.step()  # a fresh attitude; the frame of 20 ms before lies in the gap
    assert cockpit.mode is not Mode.FOLLOWING
    cockpit.step()
    assert cockpit.mode is Mode.FOLLOWING


def test_without_a_height_no_vertical_speed_is_sent_and_without_the_rest_none_at_all() -> None:
    cockpit = Cockpit(FOLLOW.replace('mode="follow"', 'mode="follow"\nvertical_gain_per_s=1')).engage()
    assert cockpit.outputs[-1].setpoint is not None
    assert cockpit.outputs[-1].setpoint.velocity_ned_mps[2] != 0.0
    cockpit.muted = {"height", "local"}
    assert sent(cockpit.run(1.5)[-1]) == ZERO


def test_an_engagement_without_a_height_over_take_off_says_whose_height_counts() -> None:
    cockpit = Cockpit().track()
    cockpit.step(Engage())
    assert not any("No height" in text for text in cockpit.texts)
    cockpit = Cockpit()
    cockpit.muted = {"height"}
    cockpit.track().step(Engage())
    assert "No height over take-off: that of local frame" in cockpit.texts


@pytest.mark.parametrize("shift_s", [-1.0, 1.0, 1e9, math.inf, math.nan])
def test_a_frame_from_another_time_is_none(shift_s: float) -> None:
    """One from the future would never grow old."""
    cockpit = brought_to(Mode.FOLLOWING)
    last = cockpit.inputs[-1].track
    assert last is not None
    odd = replace(last, seq=last.seq + 1, captured_s=cockpit.now_s + shift_s)
    cockpit.muted = {"frames"}
    cockpit._sample = odd
    cockpit.run(1.0)
    assert cockpit.mode in {Mode.COASTING, Mode.HOLDING}
    assert sent(cockpit.outputs[-1]) == ZERO


NONSENSE = [
    Box(math.nan, 225, 40, 30),
    Box(300, math.inf, 40, 30),
    Box(300, 225, -40, 30),
    Box(300, 225, 40, 0),
    Box(300, 225, 1e-300, 1e-300),
    Box(-1e300, -1e300, 2e300, 2e300),
    Box(1e9, 225, 40, 30),
    Box(300, 225, 8.9, 9.0),  # a speck
    Box(-50, 225, 40, 30),  # its middle is outside
    Box(-1000, 0, 2640, 480),
]


@pytest.mark.parametrize("box", NONSENSE)
def test_a_box_that_cannot_be_one_is_no_measurement(box: Box) -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    before = cockpit.outputs[-1].target
    cockpit.box = box
    outputs = cockpit.run(1.0)
    assert all(output.target is before for output in outputs)
    assert sent(outputs[-1]) == ZERO
    assert outputs[-1].mode is Mode.HOLDING


@pytest.mark.parametrize("box", NONSENSE)
def test_what_was_never_measured_cannot_be_engaged(box: Box) -> None:
    cockpit = Cockpit()
    cockpit.box = box
    cockpit.step()
    cockpit.step(Select(AHEAD))
    cockpit.run(0.5)
    assert cockpit.step(Engage()).setpoint is None


def test_a_fault_of_the_tracker_is_said_once_and_is_a_loss() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    track = cockpit.inputs[-1].track
    assert track is not None
    cockpit.muted = {"frames"}
    cockpit._sample = TrackSample(track.seq + 1, cockpit.now_s, cockpit.now_s, SIZE_HW, track.selection, fault="broken")
    cockpit.run(1.0)
    assert cockpit.texts.count("Tracker: broken") == 1
    assert cockpit.mode is Mode.HOLDING


def test_a_loop_whose_time_goes_back_or_stands_neither_raises_nor_jumps() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    before = cockpit.outputs[-1].setpoint
    for dt_s in (0.0, -0.0625, 0.0, 0.125):
        after = cockpit.step(dt_s=dt_s).setpoint
        assert before is not None
        assert after is not None
        assert math.dist(before.velocity_ned_mps, after.velocity_ned_mps) <= 1.5 * max(dt_s, 0) + 1e-9
        before = after


def test_a_vehicle_that_flies_overhead_turns_nothing_while_it_coasts() -> None:
    cockpit = Cockpit(OVERHEAD).track()
    cockpit.step(Engage())
    cockpit.box = replace(AHEAD, x=400)
    assert speed_mps(cockpit.run(1.0)[-1]) > 0.5
    cockpit.is_seen = False
    outputs = [output for output in cockpit.run(0.5) if output.mode is Mode.COASTING]
    assert {output.setpoint.yaw_rate_radps for output in outputs if output.setpoint is not None} == {0.0}


def test_a_lost_target_is_expected_where_it_was_seen_on_earth() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.is_seen = False
    before = cockpit.step().expected
    cockpit.yaw_rad = math.radians(10)
    after = cockpit.step().expected
    assert before is not None
    assert after is not None
    assert before.xy[0] - after.xy[0] > 60  # ten degrees to the right: it moves to the left in the picture
    cockpit.yaw_rad = math.radians(180)
    assert cockpit.step().expected is None
    cockpit.muted = {"local", "height"}
    cockpit.yaw_rad = 0.0
    cockpit.run(1.5)
    assert cockpit.outputs[-1].expected is not None


def test_a_lost_target_is_expected_larger_where_the_vehicle_has_come_nearer() -> None:
    cockpit = brought_to(Mode.FOLLOWING)
    cockpit.is_seen = False
    before = cockpit.step().expected
    cockpit.height_m -= 5.0
    after = cockpit.step().expected
    assert before is not None
    assert after is not None
    assert before.growth == pytest.approx(1.0, abs=0.05)
    assert after.growth > before.growth + 0.03


def test_a_size_gives_a_range_where_the_targets_height_is_known() -> None:
    cockpit = Cockpit(FOLLOW.replace('mode="follow"', 'mode="follow"\ntarget_height_m=1.5')).track()
    fix = cockpit.outputs[-1].target
    assert fix is not None
    assert fix.fix is not None
    slant_m = 554 * 1.5 / AHEAD.h
    assert fix.fix.range_m == pytest.approx(slant_m * math.cos(math.radians(30)), rel=0.1)


def test_a_forward_rangefinder_counts_only_while_it_is_fresh() -> None:
    cockpit = Cockpit(FOLLOW.replace("mount_pitch_deg=-30", "mount_pitch_deg=0")).track()  # no range by depression
    reading = RangeReading(cockpit.now_s, Direction.FORWARD, 40.0)
    targets = [cockpit.step(events=(reading,)).target, *(output.target for output in cockpit.run(0.625))]
    fixes = [target.fix for target in targets if target is not None]
    assert fixes[0] is not None
    assert fixes[0].range_m == pytest.approx(40.0, rel=0.01)
    assert [fix is not None for fix in fixes] == [True] * 8 + [False] * 3  # 0.5 s


# --------------------------------------------------------------------------------------------- determinism
def test_the_same_inputs_give_the_same_outputs() -> None:
    cockpit = brought_to(Mode.AWAITING, Autopilot.PX4)
    cockpit.step(Engage())
    cockpit.pwm_us = (1900, 1500, 1500, 1500)
    cockpit.run(1.0)
    again = Controller(parse(FOLLOW))
    assert [repr(again.step(inputs)) for inputs in cockpit.inputs] == [repr(output) for output in cockpit.outputs]


# -------------------------------------------------------------------------------------- whatever happens
FLOATS = st.floats(allow_nan=False, allow_infinity=False, width=32)
PWM = st.sampled_from([0, 900, 1000, 1500, 1505, 1700, 2000])
BOXES = st.one_of(
    st.just(AHEAD),
    st.builds(Box, st.floats(-50, 640), st.floats(-50, 480), st.floats(1, 300), st.floats(1, 300)),
    st.builds(Box, *[st.floats()] * 4),
)
COMMANDS = st.one_of(
    st.builds(Select, st.one_of(st.none(), BOXES)),
    st.just(Deselect()),
    st.just(Engage()),
    st.just(Engage()),
    st.just(Disengage()),
)
CHANGES = st.one_of(  # of a cockpit that goes on flying
    st.tuples(st.just("mode"), st.sampled_from(FlightMode)),
    st.tuples(st.just("mode"), st.just(FlightMode.EXTERNAL)),
    st.tuples(st.just("is_armed"), st.booleans()),
    st.tuples(st.just("has_failsafe"), st.booleans()),
    st.tuples(st.just("landed"), st.sampled_from(Landed)),
    st.tuples(st.just("landed"), st.just(Landed.IN_AIR)),
    st.tuples(st.just("is_seen"), st.booleans()),
    st.tuples(st.just("confidence"), st.floats()),
    st.tuples(st.just("box"), BOXES),
    st.tuples(st.just("yaw_rad"), st.floats(-10, 10)),
    st.tuples(st.just("height_m"), st.floats(-10, 200)),
    st.tuples(st.just("pwm_us"), st.one_of(st.just(()), st.tuples(PWM, PWM, PWM, PWM, PWM, PWM, PWM))),
    st.tuples(
        st.just("muted"),
        st.sets(st.sampled_from(["heartbeat", "attitude", "local", "height", "landed", "rc", "frames"])),
    ),
    st.tuples(st.just("muted"), st.just(frozenset())),
)
EVENTS = st.one_of(
    st.builds(Rebooted, st.just(0.0)),
    st.builds(ModeAnswer, st.booleans()),
    st.builds(Attitude, st.floats(0, 200), FLOATS, FLOATS, FLOATS, FLOATS),
    st.builds(LocalState, st.floats(0, 200), st.tuples(FLOATS, FLOATS, FLOATS), st.tuples(FLOATS, FLOATS, FLOATS)),
    st.builds(HeightReading, st.floats(0, 200), st.floats(-2e6, 2e6)),
    st.builds(RangeReading, st.floats(0, 200), st.sampled_from(Direction), st.floats(0.01, 655)),
    st.builds(LandedReading, st.floats(0, 200), st.sampled_from(Landed)),
    st.builds(RcChannels, st.floats(0, 200), st.lists(PWM, max_size=18).map(tuple)),
    st.builds(Parameter, st.text(max_size=16), FLOATS),
    st.builds(AutopilotText, st.integers(0, 7), st.text(max_size=50)),
)
ACTS = st.one_of(CHANGES, COMMANDS, EVENTS, st.sampled_from([STEP_S, 0.25, 0.25, 0.6, 3.0]), st.just(-0.7))
SETUPS = [
    FOLLOW,
    FOLLOW + "[engage]\nauto=true\nmin_confidence=0\n[rc]\nswitch_channel=7\n",
    CAMERA + "[loss]\nsearch_after_s=1\nconfirm_after_s=0\ngive_up_after_s=4\n",
    OVERHEAD,
]


def do(cockpit: Cockpit, act: object) -> None:
    match act:
        case (str(name), value):
            if name in {"mode", "is_armed", "has_failsafe"}:
                cockpit.heartbeat = replace(cockpit.heartbeat, **{name: value})
            else:
                setattr(cockpit, name, value)
            cockpit.step()
        case float(time_s) if time_s < 0:  # the loop stalls
            cockpit.step(dt_s=-time_s)
        case float(time_s):
            cockpit.run(time_s)
        case Select() | Deselect() | Engage() | Disengage():
            cockpit.step(act)
        case _:
            cockpit.step(events=(act,))


def judge(cockpit: Cockpit) -> None:
    """What holds in every step, from what went in and what came out."""
    beat: Heartbeat | None = None
    engaged = False  # by a word of the operator, or by itself where configured
    for inputs, output in zip(cockpit.inputs, cockpit.outputs, strict=True):
        for event in inputs.events:
            beat = None if isinstance(event, Rebooted) else event if isinstance(event, Heartbeat) else beat
        is_obeyed = beat is not None and beat.mode is FlightMode.EXTERNAL
        assert (output.setpoint is not None) == output.mode.is_streaming
        if output.setpoint is not None:
            assert beat is not None
            assert beat.is_armed
            assert inputs.now_s - beat.time_s <= 3.0
            assert is_obeyed or output.mode in {Mode.READY, Mode.LEAVING}
            velocity, rate_radps = output.setpoint.velocity_ned_mps, output.setpoint.yaw_rate_radps
            assert all(map(math.isfinite, (*velocity, rate_radps)))
            assert math.hypot(*velocity[:2]) <= 5.0 + 1e-6
            assert abs(rate_radps) <= math.radians(45) + 1e-9
            if output.mode not in MOVING:
                assert sent(output) == ZERO
            if output.mode is Mode.SEARCHING:
                assert velocity == (0.0, 0.0, 0.0)
        if output.request is not None:
            assert output.request is not FlightMode.EXTERNAL
            assert output.mode is Mode.LEAVING or "Asked PX4 for Hold: engage again" in {t.text for t in output.texts}
        if output.mode in {Mode.IDLE, Mode.LOST, Mode.TRACKING, Mode.READY, Mode.LEAVING}:
            engaged = False
        elif not engaged:  # it begins
            assert any(text.text.startswith("Following") for text in output.texts)
            engaged = True


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.sampled_from(SETUPS), st.sampled_from(Autopilot), st.sampled_from([*Mode]), st.lists(ACTS, max_size=16))
def test_whatever_happens_it_does_not_raise_and_never_moves_what_is_not_its_own(
    setup: str, autopilot: Autopilot, start: Mode, acts: list[object]
) -> None:
    cockpit = Cockpit(setup, autopilot)
    if start.is_streaming and setup is FOLLOW:
        cockpit = brought_to(start, autopilot)
        cockpit.inputs.clear()
        cockpit.outputs.clear()
        cockpit.step()
        assert cockpit.mode is start
        acts = acts[:8]
        for act in acts:
            do(cockpit, act)
            for output in cockpit.outputs:
                assert (output.setpoint is not None) == output.mode.is_streaming
                assert output.mode in MOVING or sent(output) in {None, ZERO}
        return
    cockpit.track()
    for act in acts:
        do(cockpit, act)
    judge(cockpit)


def test_an_order_that_is_none_is_a_mistake_of_this_code() -> None:
    with pytest.raises(AssertionError, match="land"):
        Controller(parse(FOLLOW)).step(ControlInput(0.0, None, commands=("land",)))


def test_nothing_at_all_is_an_input_too() -> None:
    output = Controller(parse(FOLLOW)).step(ControlInput(0.0, None))
    assert (output.mode, output.setpoint, output.request, output.texts) == (Mode.IDLE, None, None, ())
    assert output.expected is None


def test_a_sample_without_a_target_leaves_it_idle() -> None:
    controller = Controller(parse(FOLLOW))
    sample = TrackSample(0, 1.0, 1.0, SIZE_HW, 0, TrackStatus.TRACKING, is_measured=True, box=AHEAD, confidence=1.0)
    assert controller.step(ControlInput(1.0, sample)).mode is Mode.IDLE


@pytest.mark.parametrize("had_height", [True, False])
def test_a_height_that_comes_from_another_source_than_at_engagement_moves_nothing_up_or_down(
    had_height: bool,  # noqa: FBT001 - a table
) -> None:
    cockpit = Cockpit(OVERHEAD.replace('"overhead"', '"overhead"\nvertical_gain_per_s=0.5'))
    cockpit.muted = set() if had_height else {"height"}
    cockpit.track().step(Engage())
    cockpit.height_m = 18.0
    assert any(output.setpoint and output.setpoint.velocity_ned_mps[2] > 0.1 for output in cockpit.run(2.0))
    cockpit.muted = {"height"} if had_height else set()
    outputs = cockpit.run(3.0)[20:]  # the last word is believed for a second
    assert {output.setpoint.velocity_ned_mps[2] for output in outputs if output.setpoint} == {0.0}
    assert cockpit.mode is Mode.FOLLOWING
