"""A multirotor under velocity control: how it moves, not who commands it. Values only.

World frame: NED in metres, ground at down = 0. Angles as in `sim.world`: pitch is positive nose up, so the
vehicle pitches negative to accelerate forward; roll is positive right side down.

The chain is that of both autopilots: the commanded velocity is shaped into a reference that a vehicle can
follow, a controller turns its error into an acceleration, the attitude that gives this acceleration is
reached with a lag, and the air brakes what moves relative to it.
"""

import math
from dataclasses import dataclass, replace

from sim.world import Pose

GRAVITY_MPS2 = 9.80665

Vector = tuple[float, float, float]
_NONE: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """How an autopilot shapes a commanded velocity.

    accel_mps2, jerk_mps3 : of the reference, horizontally and vertically.
    speed_mps : horizontal speed that is never commanded to be exceeded.
    overrun_mps : by how much the reference runs past `speed_mps` when asked to; slowing down begins that much late.
    """

    accel_mps2: float
    jerk_mps3: float
    speed_mps: float
    overrun_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """What the vehicle is to do now; yaw rate clockwise from above. Without `limits` the velocity is not shaped."""

    velocity_ned_mps: Vector = _NONE
    yaw_rate_radps: float = 0.0
    limits: Limits | None = None


@dataclass(frozen=True, slots=True)
class Airframe:
    """Constants of a vehicle and its velocity controller.

    velocity_gain_per_s, integral_gain_per_s2 : acceleration per velocity error and per its integral.
    drag_per_s : horizontal deceleration per speed relative to the air.
    attitude_lag_s, climb_lag_s, yaw_lag_s : of first order, of the tilt, the vertical velocity and the yaw rate.
    """

    velocity_gain_per_s: float
    integral_gain_per_s2: float
    drag_per_s: float
    attitude_lag_s: float
    climb_lag_s: float = 0.15
    yaw_lag_s: float = 0.12
    max_tilt_rad: float = math.radians(35.0)


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Motion of the vehicle, and the memory of its velocity controller.

    reference_mps, reference_accel_mps2 : the shaped velocity command, NED.
    trim_ne_mps2 : integral of the velocity error as acceleration, north and east; it works against the wind.
    """

    pos_ned_m: Vector
    velocity_ned_mps: Vector = _NONE
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    roll_rate_radps: float = 0.0
    pitch_rate_radps: float = 0.0
    yaw_rate_radps: float = 0.0
    reference_mps: Vector = _NONE
    reference_accel_mps2: Vector = _NONE
    trim_ne_mps2: tuple[float, float] = (0.0, 0.0)

    @property
    def pose(self) -> Pose:
        """Position and attitude."""
        return Pose(self.pos_ned_m, self.roll_rad, self.pitch_rad, self.yaw_rad)

    @property
    def height_m(self) -> float:
        """Height above the ground."""
        return -self.pos_ned_m[2]

    @property
    def is_on_ground(self) -> bool:
        """Whether the vehicle stands on the ground."""
        return self.pos_ned_m[2] >= 0.0

    def with_new_reference(self) -> "VehicleState":
        """The state with a controller that starts from the actual velocity, as after a change of mode."""
        return replace(self, reference_mps=self.velocity_ned_mps, reference_accel_mps2=_NONE)


def step(
    state: VehicleState,
    command: VelocityCommand | None,
    airframe: Airframe,
    wind_ne_mps: tuple[float, float],
    dt_s: float,
) -> VehicleState:
    """State `dt_s` later, which must be short against the lags of `airframe` (20 ms and less).

    Parameters
    ----------
    command : None: the motors are off, and the vehicle falls.
    """
    if command is None:
        return _falling(state, airframe, wind_ne_mps, dt_s)
    reference, accel = _shaped(state, command, dt_s)
    if state.is_on_ground and reference[2] >= 0.0:
        return _standing(state)

    v_n, v_e, v_d = state.velocity_ned_mps
    wanted_n, wanted_e = reference[:2]
    accel_n, accel_e = accel[:2]
    if command.limits is not None and math.hypot(wanted_n, wanted_e) > command.limits.speed_mps:
        wanted_n, wanted_e = _clipped(wanted_n, wanted_e, command.limits.speed_mps)
        accel_n = accel_e = 0.0
    error_n, error_e = wanted_n - v_n, wanted_e - v_e
    trim_n, trim_e = state.trim_ne_mps2
    asked_n = accel_n + airframe.velocity_gain_per_s * error_n + trim_n
    asked_e = accel_e + airframe.velocity_gain_per_s * error_e + trim_e
    max_accel_mps2 = GRAVITY_MPS2 * math.tan(airframe.max_tilt_rad)
    thrust_n, thrust_e = _clipped(asked_n, asked_e, max_accel_mps2)
    # An integral that grew while the tilt is at its limit would overshoot.
    if (thrust_n, thrust_e) == (asked_n, asked_e):
        trim_n += airframe.integral_gain_per_s2 * error_n * dt_s
        trim_e += airframe.integral_gain_per_s2 * error_e * dt_s

    # The attitude that gives this acceleration while the thrust carries the weight, seen along the heading.
    cos_yaw, sin_yaw = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    pitch_goal_rad = -math.atan2(thrust_n * cos_yaw + thrust_e * sin_yaw, GRAVITY_MPS2)
    roll_goal_rad = math.atan2((thrust_e * cos_yaw - thrust_n * sin_yaw) * math.cos(pitch_goal_rad), GRAVITY_MPS2)
    share = 1.0 - math.exp(-dt_s / airframe.attitude_lag_s)
    roll_rad = state.roll_rad + share * (roll_goal_rad - state.roll_rad)
    pitch_rad = state.pitch_rad + share * (pitch_goal_rad - state.pitch_rad)

    forward_mps2 = -GRAVITY_MPS2 * math.tan(pitch_rad)
    right_mps2 = GRAVITY_MPS2 * math.tan(roll_rad) / math.cos(pitch_rad)
    n_mps2 = forward_mps2 * cos_yaw - right_mps2 * sin_yaw - airframe.drag_per_s * (v_n - wind_ne_mps[0])
    e_mps2 = forward_mps2 * sin_yaw + right_mps2 * cos_yaw - airframe.drag_per_s * (v_e - wind_ne_mps[1])
    climb_share = 1.0 - math.exp(-dt_s / airframe.climb_lag_s)
    velocity = (v_n + n_mps2 * dt_s, v_e + e_mps2 * dt_s, v_d + climb_share * (reference[2] - v_d))

    yaw_share = 1.0 - math.exp(-dt_s / airframe.yaw_lag_s)
    yaw_rate_radps = state.yaw_rate_radps + yaw_share * (command.yaw_rate_radps - state.yaw_rate_radps)
    pos_ned_m = _moved(state.pos_ned_m, state.velocity_ned_mps, velocity, dt_s)
    return VehicleState(
        pos_ned_m,
        velocity,
        roll_rad,
        pitch_rad,
        math.remainder(state.yaw_rad + yaw_rate_radps * dt_s, 2 * math.pi),
        (roll_rad - state.roll_rad) / dt_s,
        (pitch_rad - state.pitch_rad) / dt_s,
        yaw_rate_radps,
        reference,
        accel,
        (trim_n, trim_e),
    )


def _shaped(state: VehicleState, command: VelocityCommand, dt_s: float) -> tuple[Vector, Vector]:
    """Velocity reference and its acceleration `dt_s` later, limited in acceleration and jerk.

    Near the goal the acceleration falls with the error at jerk / accel per second: the slope that needs no more jerk
    than is allowed.
    """
    limits = command.limits
    if limits is None:
        return command.velocity_ned_mps, _NONE
    goal_n, goal_e, goal_d = command.velocity_ned_mps
    goal_n, goal_e = _clipped(goal_n, goal_e, limits.speed_mps + limits.overrun_mps)
    ref_n, ref_e, ref_d = state.reference_mps
    was_n, was_e, was_d = state.reference_accel_mps2
    slope_per_s = limits.jerk_mps3 / limits.accel_mps2
    accel_n, accel_e = _clipped(slope_per_s * (goal_n - ref_n), slope_per_s * (goal_e - ref_e), limits.accel_mps2)
    accel_d = min(max(slope_per_s * (goal_d - ref_d), -limits.accel_mps2), limits.accel_mps2)
    change = limits.jerk_mps3 * dt_s
    change_n, change_e = _clipped(accel_n - was_n, accel_e - was_e, change)
    accel_n, accel_e = was_n + change_n, was_e + change_e
    accel_d = was_d + min(max(accel_d - was_d, -change), change)
    return (ref_n + accel_n * dt_s, ref_e + accel_e * dt_s, ref_d + accel_d * dt_s), (accel_n, accel_e, accel_d)


def _standing(state: VehicleState) -> VehicleState:
    n_m, e_m, _ = state.pos_ned_m
    return VehicleState((n_m, e_m, 0.0), yaw_rad=state.yaw_rad)


def _falling(state: VehicleState, airframe: Airframe, wind_ne_mps: tuple[float, float], dt_s: float) -> VehicleState:
    if state.is_on_ground:
        return _standing(state)
    v_n, v_e, v_d = state.velocity_ned_mps
    keep = math.exp(-airframe.drag_per_s * dt_s)
    velocity = (
        wind_ne_mps[0] + keep * (v_n - wind_ne_mps[0]),
        wind_ne_mps[1] + keep * (v_e - wind_ne_mps[1]),
        keep * v_d + GRAVITY_MPS2 * dt_s,
    )
    pos_ned_m = _moved(state.pos_ned_m, state.velocity_ned_mps, velocity, dt_s)
    return replace(state, pos_ned_m=pos_ned_m, velocity_ned_mps=velocity, reference_mps=velocity)


def _moved(pos_ned_m: Vector, before_mps: Vector, after_mps: Vector, dt_s: float) -> Vector:
    """Position `dt_s` later by the mean of both velocities; the ground stops it."""
    n_m, e_m, d_m = (p + (v + w) * dt_s / 2 for p, v, w in zip(pos_ned_m, before_mps, after_mps, strict=True))
    return n_m, e_m, min(d_m, 0.0)


def _clipped(n: float, e: float, most: float) -> tuple[float, float]:
    """The vector (n, e), shortened to `most` if it is longer."""
    length = math.hypot(n, e)
    if length <= most:
        return n, e
    return n * most / length, e * most / length
