"""Every reason against an engagement: alone, in pairs, and all that go together; and that a refusal moves nothing."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import pytest
from cockpit import AHEAD, CAMERA, FOLLOW, SIZE_HW, Cockpit, sent, speed_mps

from companion.camera_model import CameraModel
from companion.config import Config, parse
from companion.engagement import Reason, refusals
from companion.modes import Mode
from companion.target import RangeFix, TargetEstimate, estimate, measure
from companion.types import (
    Attitude,
    Autopilot,
    Disengage,
    Engage,
    FlightMode,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LocalState,
    Select,
    Selection,
    TrackSample,
)
from companion.vehicle_state import VehicleState
from mscf import Box, TrackStatus

NOW_S = 100.0
OVERHEAD = parse(
    CAMERA.replace("mount_pitch_deg=-30", "mount_pitch_deg=-90")
    + '[follow]\nmode="overhead"\n[limits]\nfloor_m=5\nceiling_m=60\n'
)
BEHIND = parse(CAMERA + '[follow]\nmode="follow"\n[limits]\nfloor_m=5\nceiling_m=60\n')


def target(fix: RangeFix | None) -> TargetEstimate:
    level = Attitude(NOW_S, 0.0, 0.0, 0.0, 0.0)
    return estimate(measure(CameraModel.of(OVERHEAD, SIZE_HW), AHEAD, level, NOW_S), fix, None, None)


@dataclass(frozen=True)
class Situation:
    """All that `refusals` looks at."""

    mode: Mode
    selection: Selection
    sample: TrackSample | None
    target: TargetEstimate | None
    vehicle: VehicleState
    config: Config = OVERHEAD
    is_stick_moved: bool = False
    has_resume_guard: bool = False

    @property
    def refusals(self) -> tuple[Reason, ...]:
        return refusals(
            self.mode,
            self.selection,
            self.sample,
            self.target,
            self.vehicle,
            self.config,
            NOW_S,
            is_stick_moved=self.is_stick_moved,
            has_resume_guard=self.has_resume_guard,
        )


# everything is just within its limit
FINE = Situation(
    Mode.TRACKING,
    Selection(1, AHEAD),
    TrackSample(1, NOW_S, NOW_S, SIZE_HW, 1, TrackStatus.TRACKING, is_measured=True, box=AHEAD, confidence=0.5),
    target(RangeFix(0.5, is_conflicting=False)),
    VehicleState(
        heartbeat=Heartbeat(
            NOW_S - 3.0,
            Autopilot.ARDUPILOT,
            is_multicopter=True,
            mode=FlightMode.EXTERNAL,
            mode_name="GUIDED",
            is_armed=True,
            has_failsafe=False,
        ),
        attitude=Attitude(NOW_S - 0.3, 0.0, 0.0, 0.0, 0.0),
        local=LocalState(NOW_S - 0.5, (0.0, 0.0, -20.0), (9.0, 9.0, 0.7)),
        height=HeightReading(NOW_S - 1.0, 60.0),
        landed=LandedReading(NOW_S - 3.0, Landed.IN_AIR),
    ),
)


def with_heartbeat(s: Situation, **changes: object) -> Situation:
    assert s.vehicle.heartbeat is not None
    beat = replace(s.vehicle.heartbeat, **changes)
    return replace(s, vehicle=replace(s.vehicle, heartbeat=beat))


def with_vehicle(s: Situation, **changes: object) -> Situation:
    return replace(s, vehicle=replace(s.vehicle, **changes))


def with_box(s: Situation, box: Box) -> Situation:
    assert s.sample is not None
    return replace(s, sample=replace(s.sample, box=box))


def with_confidence(s: Situation, confidence: float) -> Situation:
    assert s.sample is not None
    return replace(s, sample=replace(s.sample, confidence=confidence))


SINKING = LocalState(NOW_S, (0.0, 0.0, -20.0), (0.0, 0.0, 0.71))
CLIMBING = LocalState(NOW_S, (0.0, 0.0, -20.0), (0.0, 0.0, -0.71))
CASES: dict[str, tuple[Reason, Callable[[Situation], Situation]]] = {
    "nothing selected": (Reason.NO_TARGET, lambda s: replace(s, selection=Selection(2, None), mode=Mode.IDLE)),
    "lost": (Reason.TARGET_UNSURE, lambda s: replace(s, mode=Mode.LOST)),
    "small": (Reason.TARGET_SMALL, lambda s: with_box(s, Box(300, 225, 8.9, 9.0))),
    "not seen yet": (Reason.TARGET_UNSURE, lambda s: replace(s, mode=Mode.IDLE)),
    "confidence low": (Reason.LOW_CONFIDENCE, lambda s: with_confidence(s, 0.49)),
    "confidence nan": (Reason.LOW_CONFIDENCE, lambda s: with_confidence(s, math.nan)),
    "no sample": (Reason.LOW_CONFIDENCE, lambda s: replace(s, sample=None)),
    "heartbeat old": (Reason.NO_HEARTBEAT, lambda s: with_heartbeat(s, time_s=NOW_S - 3.1)),
    "a plane": (Reason.UNSUPPORTED_VEHICLE, lambda s: with_heartbeat(s, is_multicopter=False)),
    "disarmed": (Reason.NOT_ARMED, lambda s: with_heartbeat(s, is_armed=False)),
    "on ground": (Reason.NOT_AIRBORNE, lambda s: with_vehicle(s, landed=LandedReading(NOW_S, Landed.ON_GROUND))),
    "taking off": (Reason.NOT_AIRBORNE, lambda s: with_vehicle(s, landed=LandedReading(NOW_S, Landed.TAKING_OFF))),
    "landing": (Reason.NOT_AIRBORNE, lambda s: with_vehicle(s, landed=LandedReading(NOW_S, Landed.LANDING))),
    "does not know": (Reason.NOT_AIRBORNE, lambda s: with_vehicle(s, landed=LandedReading(NOW_S, Landed.UNKNOWN))),
    "does not say": (Reason.NOT_AIRBORNE, lambda s: with_vehicle(s, landed=None)),
    "said so long ago": (
        Reason.NOT_AIRBORNE,
        lambda s: with_vehicle(s, landed=LandedReading(NOW_S - 3.1, Landed.IN_AIR)),
    ),
    "sinking": (Reason.CHANGING_HEIGHT, lambda s: with_vehicle(s, local=SINKING)),
    "climbing": (Reason.CHANGING_HEIGHT, lambda s: with_vehicle(s, local=CLIMBING)),
    "pilot's mode": (Reason.WRONG_MODE, lambda s: with_heartbeat(s, mode=FlightMode.PILOT)),
    "any other mode": (Reason.WRONG_MODE, lambda s: with_heartbeat(s, mode=FlightMode.OTHER)),
    "guard": (Reason.RESUME_GUARD, lambda s: replace(s, has_resume_guard=True)),
    "position old": (
        Reason.NO_POSITION,
        lambda s: with_vehicle(s, local=LocalState(NOW_S - 0.51, (0, 0, -20.0), (0, 0, 0))),
    ),
    "no position": (Reason.NO_POSITION, lambda s: with_vehicle(s, local=None)),
    "attitude old": (Reason.NO_ATTITUDE, lambda s: with_vehicle(s, attitude=Attitude(NOW_S - 0.31, 0, 0, 0, 0))),
    "no attitude": (Reason.NO_ATTITUDE, lambda s: with_vehicle(s, attitude=None)),
    "none at frame time": (Reason.NO_ATTITUDE, lambda s: replace(s, target=None)),
    "failsafe": (Reason.FAILSAFE, lambda s: with_heartbeat(s, has_failsafe=True)),
    "sticks": (Reason.STICKS, lambda s: replace(s, is_stick_moved=True)),
    "too low": (Reason.TOO_LOW, lambda s: with_vehicle(s, height=HeightReading(NOW_S, 4.9))),
    "too high": (Reason.TOO_HIGH, lambda s: with_vehicle(s, height=HeightReading(NOW_S, 60.1))),
    "no range": (Reason.RANGE_UNKNOWN, lambda s: replace(s, target=target(None))),
    "conflict": (
        Reason.RANGE_CONFLICT,
        lambda s: replace(s, config=BEHIND, target=target(RangeFix(20.0, is_conflicting=True))),
    ),
    "too near": (
        Reason.TOO_NEAR,
        lambda s: replace(s, config=BEHIND, target=target(RangeFix(2.9, is_conflicting=False))),
    ),
}
# pairs that touch the same thing: the second would undo the first, or hides it
CLASHES = [
    {"nothing selected", "lost", "not seen yet", "confidence low", "confidence nan", "no sample", "none at frame time"},
    {"small", "no sample"},
    {"on ground", "taking off", "landing", "does not know", "does not say", "said so long ago"},
    {"sinking", "climbing", "position old", "no position"},
    {"pilot's mode", "any other mode"},
    {"attitude old", "no attitude"},
    {"too low", "too high"},
    {"no range", "conflict", "too near", "none at frame time"},
    {"no range", "none at frame time"},
]
PAIRS = [pair for pair in combinations(CASES, 2) if not any(set(pair) <= clash for clash in CLASHES)]


def test_with_everything_just_within_its_limit_nothing_forbids_it() -> None:
    assert FINE.refusals == ()


@pytest.mark.parametrize("name", CASES)
def test_each_reason_alone(name: str) -> None:
    reason, spoil = CASES[name]
    assert spoil(FINE).refusals == (reason,)


def test_each_pair_of_reasons_says_both() -> None:
    for first, second in PAIRS:
        spoiled = CASES[first][1](CASES[second][1](FINE))
        assert set(spoiled.refusals) == {CASES[first][0], CASES[second][0]}, (first, second)


def test_all_that_go_together_are_all_said() -> None:
    names = ["confidence low", "heartbeat old", "a plane", "disarmed", "on ground", "sinking", "pilot's mode", "guard",
             "attitude old", "failsafe", "sticks", "too low", "no range"]  # fmt: skip
    situation = FINE
    for name in names:
        situation = CASES[name][1](situation)
    assert set(situation.refusals) == {CASES[name][0] for name in names}


def test_every_reason_that_can_refuse_is_in_this_table() -> None:
    ends = {Reason.MODE_LEFT, Reason.DISARMED, Reason.LANDED, Reason.REBOOTED, Reason.LINK_SILENT, Reason.STALLED,
            Reason.NOT_OBEYED, Reason.OPERATOR, Reason.DESELECTED, Reason.LOST_TOO_LONG, Reason.NOT_CONFIRMED,
            Reason.OFFBOARD_NOT_SELECTED, Reason.SHUTDOWN}  # fmt: skip
    assert {reason for reason, _ in CASES.values()} == set(Reason) - ends - {Reason.LEAVING}


def test_while_leaving_it_is_refused() -> None:
    assert Reason.LEAVING in replace(FINE, mode=Mode.LEAVING).refusals


def test_of_an_unknown_vehicle_only_what_is_unknown_is_said() -> None:
    situation = replace(FINE, vehicle=VehicleState())
    assert set(situation.refusals) == {Reason.NO_HEARTBEAT, Reason.NO_POSITION, Reason.NO_ATTITUDE}


# ------------------------------------------------------------------------------------- in the controller
def test_a_refused_engage_says_all_its_reasons_and_changes_nothing() -> None:
    cockpit = Cockpit().track()
    cockpit.heartbeat = replace(cockpit.heartbeat, is_armed=False, mode=FlightMode.PILOT)
    output = cockpit.step(Engage())
    assert [text.text for text in output.texts] == ["Engage refused: not armed, flight mode is not GUIDED/OFFBOARD"]
    assert (output.mode, output.setpoint, output.request) == (Mode.TRACKING, None, None)


def test_an_engage_begins_to_move_in_the_same_step_from_a_stand() -> None:
    cockpit = Cockpit().track()
    cockpit.box = replace(AHEAD, x=400)
    cockpit.run(0.5)
    output = cockpit.step(Engage())
    assert output.mode is Mode.FOLLOWING
    assert output.setpoint is not None
    assert 0 < output.setpoint.yaw_rate_radps < 0.2
    cockpit.run(1.0)
    assert cockpit.step(Engage()).texts == ()  # twice is once


def test_a_second_engagement_begins_as_gently_as_the_first() -> None:
    cockpit = Cockpit(FOLLOW + "[limits]\nacceleration_mps2=1\n").engage()
    cockpit.step(Disengage())
    cockpit.fly(FlightMode.HOLD)
    cockpit.run(5.0)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(0.5)
    cockpit.box = replace(AHEAD, x=450, y=170)
    output = cockpit.step(Engage())
    assert output.setpoint is not None
    assert 0 < abs(output.setpoint.yaw_rate_radps) <= math.radians(90) / 20  # a step of the loop's, not of 5 s


def test_a_dry_run_streams_nothing_and_asks_for_nothing() -> None:
    outputs = Cockpit().track().run(5.0)
    assert {(sent(output), output.request) for output in outputs} == {(None, None)}


def test_an_estimate_from_before_a_gap_in_the_attitudes_does_not_move_the_vehicle() -> None:
    cockpit = Cockpit().track()
    cockpit.muted = {"attitude"}
    cockpit.run(5.0)
    assert cockpit.mode is Mode.TRACKING
    cockpit.muted = {"frames"}  # the attitude is back, the frame it would be needed for is not
    output = cockpit.step(Engage())
    assert "attitude too old" in output.texts[0].text
    assert output.setpoint is None


def test_a_box_in_the_middle_is_selected_where_none_is_given_and_a_wrong_one_refused() -> None:
    cockpit = Cockpit()
    cockpit.muted = {"frames"}
    assert cockpit.step(Select(None)).texts[0].text == "Select refused: no frame yet"
    cockpit.muted = set()
    cockpit.step()
    box = cockpit.step(Select(None)).selection.box
    assert box is not None
    assert (box.center_xy, box.w) == ((320, 240), pytest.approx(0.12 * 480))
    for bad in (replace(AHEAD, w=0), replace(AHEAD, h=-1), replace(AHEAD, x=math.nan), replace(AHEAD, y=math.inf)):
        output = cockpit.step(Select(bad))
        assert output.texts[0].text == "Select refused: not a box"
        assert output.selection.box == box


# ------------------------------------------------------------------------------------- by itself, by switch
AUTO = CAMERA + "[engage]\nauto=true\n"


def test_configured_so_it_engages_by_itself_once_nothing_forbids_it() -> None:
    cockpit = Cockpit(AUTO)
    cockpit.fly(FlightMode.PILOT)
    cockpit.track()
    assert not any("refused" in text for text in cockpit.texts)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(0.125)
    assert cockpit.mode is Mode.FOLLOWING


def test_by_itself_it_does_not_engage_after_a_restart_in_the_air() -> None:
    cockpit = Cockpit(AUTO)
    cockpit.step()
    cockpit.step(Select(AHEAD))
    cockpit.run(5.0)
    assert cockpit.mode is Mode.TRACKING


def test_by_itself_it_engages_once_a_selection_and_not_again_after_an_override() -> None:
    cockpit = Cockpit(AUTO)
    cockpit.fly(FlightMode.PILOT)
    cockpit.step()
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.step()
    cockpit.step(Select(AHEAD))
    cockpit.run(0.5)
    assert cockpit.mode is Mode.FOLLOWING
    cockpit.fly(FlightMode.PILOT)
    cockpit.run(0.5)
    cockpit.fly(FlightMode.EXTERNAL)
    cockpit.run(2.0)
    assert cockpit.mode is Mode.TRACKING
    cockpit.step(Select(AHEAD))
    cockpit.run(0.5)
    assert cockpit.mode is Mode.FOLLOWING


def test_the_transmitters_switch_selects_engages_and_ends() -> None:
    cockpit = Cockpit(CAMERA + "[rc]\nswitch_channel=7\n")
    rest = (1500, 1500, 1000, 1500, 1000, 1000)
    found = []
    for pwm_us in (2000, 1000, 1500, 2000, 1000):  # where it rests at the start means nothing
        cockpit.pwm_us = (*rest, pwm_us)
        cockpit.run(0.6)
        found.append(cockpit.mode)
    assert found == [Mode.IDLE, Mode.IDLE, Mode.TRACKING, Mode.FOLLOWING, Mode.LEAVING]
    assert speed_mps(cockpit.outputs[-1]) == 0.0
