"""The ladder of loss: what happens how long after the target was last seen, and the way back."""

import math
from dataclasses import replace

import pytest
from cockpit import AHEAD, CAMERA, FOLLOW, STEP_S, ZERO, Cockpit, brought_to, sent, speed_mps

from companion.engagement import Reason
from companion.modes import Mode
from companion.types import Deselect, Engage, FlightMode, Select
from mscf import Box

LOSS = CAMERA + '[follow]\nmode="follow"\n[loss]\n'


def lost(config: str = FOLLOW) -> Cockpit:
    """Engaged and moving; the target goes out of sight with the next frame."""
    cockpit = Cockpit(config).engage()
    assert speed_mps(cockpit.outputs[-1]) > 0.5
    cockpit.is_seen = False
    return cockpit


def spans(cockpit: Cockpit, duration_s: float) -> dict[Mode, tuple[float, float]]:
    """When each mode began and ended, in seconds since the last frame with the target."""
    last_s = cockpit.now_s - 0.02
    outputs = [(cockpit.step(), cockpit.now_s - last_s) for _ in range(round(duration_s / STEP_S))]
    found: dict[Mode, tuple[float, float]] = {}
    for output, since_s in outputs:
        found[output.mode] = (found.get(output.mode, (since_s, 0.0))[0], since_s)
    return found


def test_each_rung_comes_in_its_time() -> None:
    cockpit = lost()
    found = spans(cockpit, 13.0)
    assert [*found] == [Mode.FOLLOWING, Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.LEAVING]
    assert found[Mode.COASTING][0] == pytest.approx(0.2, abs=STEP_S)  # a blink is no loss
    assert found[Mode.HOLDING][0] == pytest.approx(0.6, abs=STEP_S)
    assert found[Mode.SEARCHING][0] == pytest.approx(2.0, abs=STEP_S)
    assert found[Mode.LEAVING][0] == pytest.approx(12.0, abs=STEP_S)
    said = ["Target lost: holding", f"Follow ended: {Reason.LOST_TOO_LONG.value}"]
    assert cockpit.texts[-2:] == said


def test_a_camera_that_stalls_is_a_loss() -> None:
    cockpit = lost()
    cockpit.is_seen = True
    cockpit.muted = {"frames"}
    found = spans(cockpit, 13.0)
    assert [*found][:3] == [Mode.FOLLOWING, Mode.COASTING, Mode.HOLDING]
    assert found[Mode.COASTING][0] == pytest.approx(0.33, abs=STEP_S)
    assert found[Mode.HOLDING][0] == pytest.approx(0.6, abs=STEP_S)


def test_coasting_slows_down_and_stands_half_a_second_after_the_target_was_seen_last() -> None:
    cockpit = lost(LOSS + "hold_after_s=3\nconfirm_after_s=100\n")
    last_s = cockpit.now_s - 0.02
    speeds = []
    while cockpit.now_s - last_s < 2.9:
        output = cockpit.step()
        if output.mode is Mode.COASTING:
            speeds.append(speed_mps(output))
        if cockpit.now_s - last_s > 0.5:  # whatever the slew: what was seen so long ago is no intent any more
            assert sent(output) == ZERO
    assert cockpit.mode is Mode.COASTING
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[0] > 0.5
    assert speeds[-1] == 0.0


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.AWAITING])
def test_holding_and_awaiting_stand_with_the_stream_running(mode: Mode) -> None:
    cockpit = brought_to(mode)
    assert {sent(output) for output in cockpit.run(0.5)} == {ZERO}


def test_without_a_search_it_holds_until_it_gives_up() -> None:
    found = spans(lost(LOSS + "search_after_s=0\n"), 13.0)
    assert Mode.SEARCHING not in found
    assert found[Mode.HOLDING] == pytest.approx((0.6, 12.0), abs=STEP_S)


@pytest.mark.parametrize(("x", "sign"), [(120, -1), (480, 1)])
@pytest.mark.parametrize("mount_yaw_deg", [0, 90])
def test_a_search_turns_to_the_side_on_which_it_was_lost_and_once_around_at_most(
    x: float, sign: int, mount_yaw_deg: int
) -> None:
    head = f"mount_yaw_deg={mount_yaw_deg}\n"
    cockpit = Cockpit(CAMERA + head + "[loss]\nsearch_after_s=2\ngive_up_after_s=60\nsearch_yaw_rate_dps=20\n")
    cockpit.track().step(Engage())
    cockpit.box = replace(AHEAD, x=x)
    cockpit.run(0.5)
    cockpit.is_seen = False
    outputs = [output for output in cockpit.run(40.0) if output.mode is Mode.SEARCHING]
    rates = [output.setpoint.yaw_rate_radps for output in outputs if output.setpoint is not None]
    assert len(rates) == len(outputs)
    assert all(sign * rate >= 0 for rate in rates)
    assert max(map(abs, rates)) == pytest.approx(math.radians(20))
    assert 0.95 * math.tau < abs(sum(rates) * STEP_S) < 1.01 * math.tau
    assert rates[-1] == 0.0
    assert {speed_mps(output) for output in outputs} == {0.0}


def test_a_target_that_was_never_seen_is_waited_for_and_not_searched_for() -> None:
    cockpit = Cockpit(FOLLOW).engage()
    cockpit.is_seen = False
    outputs = [cockpit.step(Select(AHEAD)), *cockpit.run(13.0)]
    assert {output.mode for output in outputs} == {Mode.HOLDING, Mode.LEAVING}
    assert {sent(output) for output in outputs} == {ZERO}
    assert {output.notes for output in outputs if output.mode is Mode.HOLDING} == {("new target selected, holding",)}
    assert cockpit.mode is Mode.LEAVING


def test_a_new_target_that_nobody_confirmed_is_not_searched_for_when_it_is_lost() -> None:
    cockpit = Cockpit(FOLLOW).engage()
    cockpit.step(Select(AHEAD))
    cockpit.box = Box(560, 194, 31, 23)
    cockpit.run(0.5)
    assert cockpit.mode is Mode.AWAITING
    cockpit.is_seen = False
    outputs = cockpit.run(13.0)
    assert {output.mode for output in outputs} == {Mode.AWAITING, Mode.HOLDING, Mode.LEAVING}
    assert {sent(output) for output in outputs} == {ZERO}


@pytest.mark.parametrize(
    ("word", "mode"), [("hold", FlightMode.HOLD), ("rtl", FlightMode.RTL), ("land", FlightMode.LAND)]
)
def test_giving_up_asks_for_what_is_configured_until_it_is_there(word: str, mode: FlightMode) -> None:
    cockpit = lost(LOSS + f'on_give_up="{word}"\ngive_up_after_s=3\n')
    outputs = cockpit.run(6.0)
    assert {output.request for output in outputs} == {None, mode}
    assert outputs[-1].mode is Mode.LEAVING
    cockpit.fly(mode)
    cockpit.run(0.5)
    assert cockpit.mode is Mode.LOST
    assert cockpit.outputs[-1].setpoint is None


def test_what_was_asked_for_last_time_is_not_asked_for_again() -> None:
    """Given up with RTL; later the operator ends a new engagement: that asks for Hold."""
    cockpit = lost(LOSS + 'on_give_up="rtl"\ngive_up_after_s=3\n')
    cockpit.run(4.0)
    cockpit.fly(FlightMode.RTL)
    cockpit.is_seen = True
    cockpit.run(0.5)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(0.5)
    cockpit.step(Engage())
    assert cockpit.mode is Mode.FOLLOWING
    assert cockpit.step(Deselect()).request is FlightMode.HOLD


# --------------------------------------------------------------------------------------------- the way back
@pytest.mark.parametrize("gap_s", [0.25, 0.5, 1.0, 2.5])
def test_a_target_that_is_seen_again_soon_is_followed_on(gap_s: float) -> None:
    cockpit = lost()
    cockpit.run(gap_s)
    assert cockpit.mode is not Mode.FOLLOWING
    cockpit.is_seen = True
    output = cockpit.step()
    assert output.mode is Mode.FOLLOWING
    assert speed_mps(output) <= speed_mps(cockpit.outputs[-2]) + 1.5 * STEP_S + 1e-9  # slewed, from a stand


@pytest.mark.parametrize("gap_s", [3.25, 6.0, 11.0])
def test_a_target_that_is_seen_again_late_waits_for_the_operator(gap_s: float) -> None:
    cockpit = lost()
    cockpit.run(gap_s)
    cockpit.is_seen = True
    outputs = cockpit.run(5.0)
    assert {output.mode for output in outputs} == {Mode.AWAITING}
    assert {sent(output) for output in outputs} == {ZERO}
    assert cockpit.texts[-1] == "Target seen: engage to confirm"
    aim = cockpit.controller._state.aim
    output = cockpit.step(Engage())
    assert output.mode is Mode.FOLLOWING
    assert cockpit.controller._state.aim is aim  # the framing that the operator chose at first


def test_a_confirmation_is_refused_for_the_same_reasons_as_an_engagement() -> None:
    cockpit = brought_to(Mode.AWAITING)
    cockpit.confidence = 0.4
    cockpit.step()
    output = cockpit.step(Engage())
    assert output.mode is Mode.AWAITING
    assert output.texts[0].text == "Engage refused: confidence too low"


def test_where_it_shall_confirm_early_it_does_so_already_while_coasting() -> None:
    cockpit = lost(LOSS + "confirm_after_s=0.3\nhold_after_s=2\n")
    cockpit.run(1.0)
    assert cockpit.mode is Mode.COASTING
    cockpit.is_seen = True
    assert cockpit.step().mode is Mode.AWAITING


def test_a_confirmation_that_does_not_come_ends_it() -> None:
    cockpit = brought_to(Mode.AWAITING)
    cockpit.run(11.5)
    assert cockpit.mode is Mode.AWAITING
    output = cockpit.run(0.5)[-1]
    assert output.mode is Mode.LEAVING
    assert f"Follow ended: {Reason.NOT_CONFIRMED.value}" in cockpit.texts


def test_a_target_that_comes_and_goes_does_not_prolong_the_wait_for_ever() -> None:
    cockpit = brought_to(Mode.AWAITING)
    for _ in range(10):
        cockpit.is_seen = False
        cockpit.run(1.0)
        cockpit.is_seen = True
        cockpit.run(1.0)
    assert cockpit.mode is Mode.LEAVING


# --------------------------------------------------------------------------------- another choice while engaged
@pytest.mark.parametrize("mode", [Mode.FOLLOWING, Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.AWAITING])
def test_another_target_chosen_while_engaged_is_not_followed_before_it_is_confirmed(mode: Mode) -> None:
    cockpit = brought_to(mode)
    cockpit.is_seen = True
    cockpit.box = Box(100, 200, 30, 30)
    outputs = [cockpit.step(Select(cockpit.box)), *cockpit.run(2.0)]
    assert {output.mode for output in outputs} <= {Mode.HOLDING, Mode.AWAITING}
    assert outputs[-1].mode is Mode.AWAITING
    assert {sent(output) for output in outputs} == {ZERO}
    cockpit.step(Engage())
    assert cockpit.mode is Mode.FOLLOWING
    aim = cockpit.controller._state.aim
    assert aim is not None
    assert aim.height_px == 30


@pytest.mark.parametrize("mode", [Mode.FOLLOWING, Mode.COASTING, Mode.HOLDING, Mode.SEARCHING, Mode.AWAITING])
def test_the_operator_hears_that_it_holds_for_another_choice_and_not_that_the_target_is_lost(mode: Mode) -> None:
    cockpit = brought_to(mode)
    said, steps = len(cockpit.texts), len(cockpit.outputs)
    cockpit.is_seen = False
    output = cockpit.step(Select(AHEAD))
    assert [text.text for text in output.texts] == ["New target selected: holding"]
    cockpit.run(0.5)
    cockpit.is_seen = True
    cockpit.run(0.5)
    assert cockpit.texts[said:] == ["New target selected: holding", "Target seen: engage to confirm"]
    assert not any("lost" in note for output in cockpit.outputs[steps:] for note in output.notes)
    cockpit.is_seen = False  # once it was seen it can be lost
    assert cockpit.run(1.0)[-1].notes == ("target lost, holding",)


@pytest.mark.parametrize("mode", [Mode.READY, Mode.LEAVING])
def test_a_choice_while_nothing_is_followed_holds_nothing(mode: Mode) -> None:
    cockpit = brought_to(mode)
    assert not any("holding" in text.text for text in cockpit.step(Select(AHEAD)).texts)


def test_a_sample_of_the_old_choice_says_nothing_of_the_new_one() -> None:
    cockpit = Cockpit().engage()
    cockpit.step(Select(AHEAD))
    late = cockpit.inputs[-1]
    assert late.track is not None
    for k in range(1, 40):
        now_s = late.now_s + k * STEP_S
        old = replace(late.track, seq=1000 + k, captured_s=now_s, selection=1)
        output = cockpit.put(replace(late, now_s=now_s, track=old, commands=()))
        assert output.mode is Mode.HOLDING
        assert sent(output) == ZERO
