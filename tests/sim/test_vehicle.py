"""How the vehicle moves: signs, limits, lags, ground and wind."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from sim.vehicle import GRAVITY_MPS2, Airframe, Limits, Vector, VehicleState, VelocityCommand, step
from sim.world import Pose

AIRFRAME = Airframe(velocity_gain_per_s=2.0, integral_gain_per_s2=1.0, drag_per_s=0.1, attitude_lag_s=0.1)
LIMITS = Limits(accel_mps2=2.5, jerk_mps3=5.0, speed_mps=10.0)
HOVER = VehicleState((0.0, 0.0, -20.0))
STEP_S = 0.01


def flown(
    state: VehicleState,
    command: VelocityCommand | None,
    duration_s: float,
    *,
    wind_ne_mps: tuple[float, float] = (0.0, 0.0),
    step_s: float = STEP_S,
) -> list[VehicleState]:
    """All states on the way, the last one at the end."""
    states = [state]
    for _ in range(round(duration_s / step_s)):
        states.append(step(states[-1], command, AIRFRAME, wind_ne_mps, step_s))
    return states[1:]


def heading(yaw_rad: float) -> VehicleState:
    return replace(HOVER, yaw_rad=yaw_rad)


def test_hover_stays_where_it_is() -> None:
    assert flown(HOVER, VelocityCommand(limits=LIMITS), 5.0)[-1] == HOVER


@pytest.mark.parametrize("velocity", [(3.0, 0.0, 0.0), (-2.0, 4.0, -1.0), (0.0, -5.0, 0.5)])
@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
def test_commanded_velocity_is_reached_whatever_the_heading(velocity: Vector, yaw_rad: float) -> None:
    end = flown(heading(yaw_rad), VelocityCommand(velocity, limits=LIMITS), 20.0)[-1]
    assert end.velocity_ned_mps == pytest.approx(velocity, abs=0.01)


@pytest.mark.parametrize(
    ("velocity", "roll_sign", "pitch_sign"),
    [((3.0, 0.0, 0.0), 0, -1), ((-3.0, 0.0, 0.0), 0, 1), ((0.0, 3.0, 0.0), 1, 0), ((0.0, -3.0, 0.0), -1, 0)],
    ids=["forward: nose down", "backward: nose up", "right: right side down", "left: left side down"],
)
@pytest.mark.parametrize("yaw_rad", [0.0, 2.5])
def test_vehicle_leans_towards_its_acceleration(
    velocity: Vector, roll_sign: int, pitch_sign: int, yaw_rad: float
) -> None:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    north_east = (c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], 0.0)
    early = flown(heading(yaw_rad), VelocityCommand(north_east, limits=LIMITS), 0.5)[-1]
    assert early.roll_rad == pytest.approx(abs(early.roll_rad) * roll_sign, abs=1e-9)
    assert early.pitch_rad == pytest.approx(abs(early.pitch_rad) * pitch_sign, abs=1e-9)
    assert max(abs(early.roll_rad), abs(early.pitch_rad)) > math.radians(5)


def test_tilt_gives_the_acceleration_that_is_flown() -> None:
    """Without drag: the thrust points up along the body and carries the weight; its horizontal part accelerates."""
    still_air = replace(AIRFRAME, drag_per_s=0.0)
    before = heading(0.9)
    command = VelocityCommand((9.0, -9.0, 0.0), 0.3, replace(LIMITS, accel_mps2=6.0, jerk_mps3=20.0))
    for _ in range(100):
        after = step(before, command, still_air, (0.0, 0.0), STEP_S)
        accel_mps2 = [(w - v) / STEP_S for v, w in zip(before.velocity_ned_mps, after.velocity_ned_mps, strict=True)]
        leaning = Pose((0.0, 0.0, 0.0), after.roll_rad, after.pitch_rad, before.yaw_rad)
        north, east, down = -leaning.ned_from_body()[:, 2]  # where the thrust points
        assert accel_mps2[:2] == pytest.approx([-GRAVITY_MPS2 * north / down, -GRAVITY_MPS2 * east / down])
        before = after
    assert max(abs(before.roll_rad), abs(before.pitch_rad)) > math.radians(20)


def test_attitude_settles_at_the_one_that_gives_the_asked_acceleration() -> None:
    """Diagonal to the heading, so that roll and pitch are both large: 5 m/s2 exactly, along the command."""
    still_air = replace(AIRFRAME, drag_per_s=0.0, velocity_gain_per_s=0.0, integral_gain_per_s2=0.0)
    state, command = HOVER, VelocityCommand((30.0, 30.0, 0.0), limits=Limits(5.0, 50.0, 100.0))
    for _ in range(200):
        before, state = state, step(state, command, still_air, (0.0, 0.0), STEP_S)
    accel_mps2 = [(w - v) / STEP_S for v, w in zip(before.velocity_ned_mps, state.velocity_ned_mps, strict=True)]
    assert accel_mps2[:2] == pytest.approx([5.0 / math.sqrt(2)] * 2)


def test_reference_keeps_to_acceleration_and_jerk() -> None:
    states = [HOVER, *flown(HOVER, VelocityCommand((6.0, -8.0, -3.0), limits=LIMITS), 8.0)]
    for before, after in pairwise(states):
        accel = after.reference_accel_mps2
        change = math.hypot(*(a - b for a, b in zip(accel[:2], before.reference_accel_mps2[:2], strict=True)))
        assert math.hypot(*accel[:2]) <= 2.5 + 1e-9
        assert change <= 5.0 * STEP_S + 1e-9
        assert abs(accel[2]) <= 2.5 + 1e-9


def test_speed_limit_holds_in_every_direction() -> None:
    states = flown(HOVER, VelocityCommand((20.0, 20.0, 0.0), limits=LIMITS), 15.0)
    assert math.hypot(*states[-1].velocity_ned_mps[:2]) == pytest.approx(10.0, abs=0.05)
    assert max(math.hypot(*state.velocity_ned_mps[:2]) for state in states) < 10.5


def test_overrun_delays_the_braking() -> None:
    def speed_after_brake(overrun_mps: float) -> float:
        limits = replace(LIMITS, overrun_mps=overrun_mps)
        fast = flown(HOVER, VelocityCommand((30.0, 0.0, 0.0), limits=limits), 12.0)[-1]
        assert fast.velocity_ned_mps[0] == pytest.approx(10.0, abs=0.1)
        return flown(fast, VelocityCommand(limits=limits), 2.0)[-1].velocity_ned_mps[0]

    assert speed_after_brake(2.5) - speed_after_brake(0.0) == pytest.approx(2.5, abs=0.3)


def test_tilt_has_a_limit_even_for_unshaped_commands() -> None:
    states = flown(HOVER, VelocityCommand((100.0, 0.0, 0.0)), 2.0)
    assert max(-state.pitch_rad for state in states) == pytest.approx(AIRFRAME.max_tilt_rad, abs=1e-3)


def test_integral_does_not_wind_up_while_the_tilt_is_at_its_limit() -> None:
    """A step of 60 m/s takes seconds at full tilt; the overshoot is that of a small step all the same."""
    no_drag = replace(AIRFRAME, drag_per_s=0.0)

    def overshoot_mps(goal_mps: float) -> float:
        state, fastest_mps = HOVER, 0.0
        for _ in range(3000):
            state = step(state, VelocityCommand((goal_mps, 0.0, 0.0)), no_drag, (0.0, 0.0), STEP_S)
            fastest_mps = max(fastest_mps, state.velocity_ned_mps[0])
        return fastest_mps - goal_mps

    assert 0.0 < overshoot_mps(60.0) < 3 * overshoot_mps(3.0)


@pytest.mark.parametrize("rate_radps", [0.5, -0.5])
def test_yaw_follows_its_rate_with_a_lag(rate_radps: float) -> None:
    states = flown(HOVER, VelocityCommand(yaw_rate_radps=rate_radps), 2.0)
    assert states[11].yaw_rate_radps == pytest.approx(rate_radps * (1 - math.exp(-1.0)), rel=0.01)
    # What a lag of first order loses is the rate times its time constant.
    assert states[-1].yaw_rad == pytest.approx(rate_radps * (2.0 - AIRFRAME.yaw_lag_s), abs=0.01)


def test_yaw_stays_within_one_turn() -> None:
    yaws_rad = [state.yaw_rad for state in flown(HOVER, VelocityCommand(yaw_rate_radps=2.0), 10.0)]
    assert max(map(abs, yaws_rad)) <= math.pi


def test_mean_wind_is_worked_against_and_leaned_into() -> None:
    states = flown(HOVER, VelocityCommand(limits=LIMITS), 30.0, wind_ne_mps=(-8.0, 0.0))
    assert max(-state.velocity_ned_mps[0] for state in states) > 0.1  # pushed away at first
    assert states[-1].velocity_ned_mps[0] == pytest.approx(0.0, abs=0.01)
    assert states[-1].pitch_rad == pytest.approx(-math.atan(8.0 * AIRFRAME.drag_per_s / GRAVITY_MPS2), abs=1e-3)


def test_vehicle_on_the_ground_stays_until_it_is_told_to_climb() -> None:
    ground = VehicleState((1.0, 2.0, 0.0), yaw_rad=0.3)
    assert flown(ground, VelocityCommand((3.0, 3.0, 0.5), 0.5, LIMITS), 3.0, wind_ne_mps=(5.0, 5.0))[-1] == ground
    assert flown(ground, VelocityCommand((0.0, 0.0, -1.0), limits=LIMITS), 3.0)[-1].height_m > 1.0


def test_descent_ends_at_rest_on_the_ground() -> None:
    end = flown(replace(HOVER, pos_ned_m=(0.0, 0.0, -2.0)), VelocityCommand((2.0, 0.0, 1.0), limits=LIMITS), 5.0)[-1]
    assert end.is_on_ground
    assert end.pos_ned_m[2] == 0.0
    assert (end.velocity_ned_mps, end.roll_rad, end.pitch_rad) == ((0.0, 0.0, 0.0), 0.0, 0.0)


def test_vehicle_without_motors_falls_to_the_ground() -> None:
    states = flown(HOVER, None, 1.0)
    assert states[-1].height_m == pytest.approx(20.0 - GRAVITY_MPS2 / 2, abs=0.2)
    assert flown(HOVER, None, 5.0)[-1].is_on_ground


def test_motion_hardly_depends_on_the_step() -> None:
    """Reference, tilt and velocity, three stages, are each up to half a step ahead: 30 ms at 4.5 m/s."""
    command = VelocityCommand((4.0, -2.0, -1.0), 0.4, LIMITS)
    fine, coarse = (flown(HOVER, command, 4.0, step_s=step_s)[-1] for step_s in (0.002, 0.02))
    assert coarse.pos_ned_m == pytest.approx(fine.pos_ned_m, abs=0.15)
    assert coarse.velocity_ned_mps == pytest.approx(fine.velocity_ned_mps, abs=0.05)


def test_new_reference_starts_from_the_actual_velocity() -> None:
    state = replace(HOVER, velocity_ned_mps=(1.0, 2.0, 3.0), reference_mps=(9.0, 9.0, 9.0))
    assert state.with_new_reference().reference_mps == (1.0, 2.0, 3.0)
