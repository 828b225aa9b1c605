import pytest

from companion.types import (
    Attitude,
    Autopilot,
    AutopilotText,
    Direction,
    FlightMode,
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
)
from companion.vehicle_state import VehicleState

HEARTBEAT = Heartbeat(1.0, Autopilot.PX4, True, FlightMode.EXTERNAL, "OFFBOARD", True, False)  # noqa: FBT003
READINGS: dict[str, LinkEvent] = {
    "heartbeat": HEARTBEAT,
    "attitude": Attitude(1.0, 0.1, 0.2, 0.3, 0.4),
    "local": LocalState(1.0, (1.0, 2.0, -30.0), (0.0, 0.0, 0.0)),
    "height": HeightReading(1.0, 12.0),
    "landed": LandedReading(1.0, Landed.IN_AIR),
    "forward_range": RangeReading(1.0, Direction.FORWARD, 7.0),
    "down_range": RangeReading(1.0, Direction.DOWN, 9.0),
    "rc": RcChannels(1.0, (1500,) * 8),
}


def folded(*events: LinkEvent) -> VehicleState:
    state = VehicleState()
    for event in events:
        state = state.after(event)
    return state


@pytest.mark.parametrize("name", READINGS)
def test_a_reading_is_kept_where_it_belongs_and_nowhere_else(name: str) -> None:
    state = folded(READINGS[name])
    for other in READINGS:
        assert getattr(state, other) == (READINGS[name] if other == name else None)


def test_parameters_gather_by_name_and_no_state_changes_under_its_holder() -> None:
    first = folded(Parameter("A", 1.0))
    second = first.after(Parameter("B", 2.0)).after(Parameter("A", 3.0))
    assert first.parameters == {"A": 1.0}
    assert second.parameters == {"A": 3.0, "B": 2.0}


@pytest.mark.parametrize("event", [ModeAnswer(is_accepted=True), AutopilotText(4, "hello")])
def test_what_says_nothing_of_the_vehicle_changes_nothing(event: LinkEvent) -> None:
    assert folded(HEARTBEAT, event) == folded(HEARTBEAT)


def test_a_restart_forgets_all_but_the_parameters() -> None:
    state = folded(*READINGS.values(), Parameter("A", 1.0), Rebooted(2.0))
    assert state == VehicleState(parameters={"A": 1.0})
    assert not state.is_alive(2.0)


@pytest.mark.parametrize(("age_s", "is_alive"), [(0.0, True), (3.0, True), (3.01, False)])
def test_an_autopilot_lives_for_three_seconds_after_a_heartbeat(age_s: float, is_alive: bool) -> None:  # noqa: FBT001
    assert folded(HEARTBEAT).is_alive(1.0 + age_s) is is_alive
    assert not VehicleState().is_alive(1.0)


def test_an_attitude_and_a_position_can_be_steered_by_while_they_are_fresh() -> None:
    state = folded(READINGS["attitude"], READINGS["local"])
    assert state.fresh_attitude(1.29) == READINGS["attitude"]
    assert state.fresh_attitude(1.31) is None
    assert state.fresh_local(1.5) == READINGS["local"]
    assert state.fresh_local(1.51) is None
    assert VehicleState().fresh_attitude(1.0) is None
    assert VehicleState().fresh_local(1.0) is None


def test_the_height_is_the_autopilots_own_else_that_of_its_local_frame_else_unknown() -> None:
    both = folded(READINGS["height"], READINGS["local"])
    assert both.height_m(2.0) == 12.0
    assert both.height_m(2.01) is None  # both are too old
    assert both.after(LocalState(2.0, (0.0, 0.0, -31.0), (0.0, 0.0, 0.0))).height_m(2.01) == 31.0
    assert folded(READINGS["local"]).height_m(1.0) == 30.0
    assert VehicleState().height_m(1.0) is None


def test_the_height_over_ground_is_the_rangefinders_while_it_is_fresh() -> None:
    state = folded(READINGS["height"], READINGS["down_range"])
    assert state.height_over_ground_m(1.5) == 9.0
    assert state.height_over_ground_m(1.51) == 12.0
    assert folded(READINGS["height"], READINGS["forward_range"]).height_over_ground_m(1.0) == 12.0


@pytest.mark.parametrize(
    ("landed", "is_flying"),
    [
        (Landed.UNKNOWN, None),
        (Landed.ON_GROUND, False),
        (Landed.TAKING_OFF, False),
        (Landed.IN_AIR, True),
        (Landed.LANDING, False),
    ],
)
def test_it_flies_where_it_says_so(landed: Landed, is_flying: bool | None) -> None:  # noqa: FBT001
    assert folded(LandedReading(1.0, landed)).is_flying() is is_flying


def test_it_does_not_say_whether_it_flies_before_it_has_said_so() -> None:
    assert VehicleState().is_flying() is None
