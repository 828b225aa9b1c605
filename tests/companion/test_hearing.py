import pytest

from companion.hearing import DEAF_S, Hearing, ResumeGuard
from companion.types import Autopilot, FlightMode, Heartbeat, SetpointInForce

EXTERNAL, HOLD, PILOT, RTL, LAND = (
    FlightMode.EXTERNAL, FlightMode.HOLD, FlightMode.PILOT, FlightMode.RTL, FlightMode.LAND
)  # fmt: skip


def beat(
    mode: FlightMode, *, is_armed: bool = True, has_failsafe: bool = False, autopilot: Autopilot = Autopilot.PX4
) -> Heartbeat:
    return Heartbeat(
        0.0, autopilot, is_multicopter=True, mode=mode, mode_name="", is_armed=is_armed, has_failsafe=has_failsafe
    )


def heard(*modes: FlightMode) -> ResumeGuard:
    """A guard of a PX4 that was on the ground at first, then in these modes, one after the other, all by choice."""
    guard = ResumeGuard().after(beat(HOLD, is_armed=False), has_gap=False, requested=None)
    for mode in modes:
        guard = guard.after(beat(mode), has_gap=False, requested=None)
    return guard


@pytest.mark.parametrize(
    ("mode", "is_armed", "is_up"), [(HOLD, True, True), (HOLD, False, False), (EXTERNAL, True, False)]
)
def test_who_is_heard_first_in_the_air_may_have_left_before(mode: FlightMode, *, is_armed: bool, is_up: bool) -> None:
    guard = ResumeGuard().after(beat(mode, is_armed=is_armed), has_gap=False, requested=None)
    assert (guard.is_up, guard.heard) == (is_up, mode)


@pytest.mark.parametrize(
    ("mode", "has_gap", "has_failsafe", "requested", "is_up"),
    [
        (HOLD, False, False, None, False),  # the pilot, by a switch
        (PILOT, False, False, None, False),
        (HOLD, False, False, HOLD, False),
        (HOLD, True, False, None, True),
        (PILOT, True, False, None, True),
        (HOLD, False, True, None, True),  # not heard, though we have sent
        (HOLD, False, True, HOLD, True),
        (RTL, False, False, None, True),
        (LAND, False, False, None, True),
        (RTL, False, False, RTL, False),  # ours
        (RTL, False, False, HOLD, True),
    ],
)
def test_offboard_that_ends_is_a_gap_unless_somebody_ended_it(
    mode: FlightMode, *, has_gap: bool, has_failsafe: bool, requested: FlightMode | None, is_up: bool
) -> None:
    guard = heard(EXTERNAL).after(beat(mode, has_failsafe=has_failsafe), has_gap=has_gap, requested=requested)
    assert guard.is_up is is_up


@pytest.mark.parametrize(
    ("before", "mode", "is_answered", "is_up"),
    [
        (RTL, HOLD, False, False),  # a mode that somebody chose
        (RTL, PILOT, False, False),
        (HOLD, EXTERNAL, False, False),
        (HOLD, HOLD, False, True),
        (HOLD, HOLD, True, False),  # as it was told
        (PILOT, PILOT, True, True),
        (HOLD, RTL, False, True),  # its failsafe goes on
        (RTL, LAND, True, True),
    ],
)
def test_only_a_commanded_mode_takes_the_guard_down(
    before: FlightMode, mode: FlightMode, *, is_answered: bool, is_up: bool
) -> None:
    guard = ResumeGuard(is_up=True, is_answered=is_answered, heard=before)
    assert guard.after(beat(mode), has_gap=False, requested=None).is_up is is_up


def test_arducopter_does_not_resume_by_itself() -> None:
    guard = ResumeGuard().after(beat(EXTERNAL, autopilot=Autopilot.ARDUPILOT), has_gap=False, requested=None)
    guard = guard.after(beat(RTL, autopilot=Autopilot.ARDUPILOT, has_failsafe=True), has_gap=True, requested=None)
    assert (guard.is_up, guard.heard) == (False, RTL)


def said(*readings: tuple[float, float, float]) -> Hearing:
    """Hearing after what was in force, m/s, while so much was told, m/s: (time, in force, told)."""
    hearing = Hearing()
    for time_s, in_force_mps, told_mps in readings:
        hearing = hearing.after(SetpointInForce(time_s, (0.0, in_force_mps, 0.0)), told_mps)
    return hearing


def test_zero_for_long_while_told_to_move_is_deaf() -> None:
    assert said((10.0, 0.0, 1.0), (10.0 + DEAF_S, 0.0, 1.0)).is_deaf
    assert not said((10.0, 0.0, 1.0), (9.9 + DEAF_S, 0.0, 1.0)).is_deaf


@pytest.mark.parametrize("middle", [(11.0, 0.4, 1.0), (11.0, 0.0, 0.4)])
def test_a_speed_in_force_or_a_stop_of_ours_begins_anew(middle: tuple[float, float, float]) -> None:
    assert not said((10.0, 0.0, 1.0), middle, (10.5 + DEAF_S, 0.0, 1.0)).is_deaf
