"""The limiter: the only maker of setpoints that may be sent."""

import math
from dataclasses import InitVar, dataclass

from companion.config import LimitsConfig
from companion.types import Setpoint, Vector

_MINT = object()
NOTED_MPS = 0.1  # of a wish that is cut off; less is not worth a word
RESPONSE_S = 0.5  # by which a vehicle lags behind its setpoint
MAX_STEP_S = 0.2  # a loop that stalled longer must not slew by as much more


@dataclass(frozen=True, slots=True)
class SafeSetpoint:
    """A setpoint inside the envelope; made by `limit` and `stop` only."""

    velocity_ned_mps: Vector
    yaw_rate_radps: float
    mint: InitVar[object]

    def __post_init__(self, mint: object) -> None:
        if mint is not _MINT:
            raise TypeError("only safety.limit and safety.stop make a SafeSetpoint")


@dataclass(frozen=True, slots=True)
class Place:
    """Where the vehicle is in the envelope; None where it is not known."""

    height_m: float | None  # above the place of take-off
    from_engagement_ne_m: tuple[float, float] | None


def stop() -> SafeSetpoint:
    """Stand still. A stop is never slewed: the autopilot brakes as hard as it has been told to."""
    return SafeSetpoint((0.0, 0.0, 0.0), 0.0, _MINT)


def limit(wish: Setpoint, before: SafeSetpoint | None, place: Place, limits: LimitsConfig, dt_s: float) -> SafeSetpoint:
    """The nearest setpoint to a wish that may be sent.

    Speed is clamped as a vector, then the change since `before` is slewed, then the envelope cuts off what would leave
    it: it only ever makes a setpoint smaller. Near the radius the speed outwards falls with the square root
    of the distance, so that the limit of acceleration is enough to stop there, half a second of lag included.

    Promised for every input: the numbers are finite and inside the limits; no speed or rate grows by more than its
    limit of acceleration times `dt_s`. A stop and the envelope may shorten it by more.

    Parameters
    ----------
    wish : anything, non-finite numbers too: those give a stop.
    before : the setpoint sent last; None: none, the vehicle stands.
    dt_s : since then; more than 0.2 s counts as 0.2.
    """
    values = (*wish.velocity_ned_mps, wish.yaw_rate_radps, dt_s, *(place.from_engagement_ne_m or ()))
    if not all(map(math.isfinite, values)) or not math.isfinite(place.height_m or 0.0):
        return stop()
    last = before or stop()
    step_s = min(max(dt_s, 0.0), MAX_STEP_S)

    north, east, down = wish.velocity_ned_mps
    north, east = _clamped((north, east), limits.speed_mps)
    down = min(max(down, -limits.climb_mps), limits.descent_mps)
    top_radps = math.radians(limits.yaw_rate_dps)
    yaw = min(max(wish.yaw_rate_radps, -top_radps), top_radps)

    step_mps = limits.acceleration_mps2 * step_s
    last_north, last_east, last_down = last.velocity_ned_mps
    change = _clamped((north - last_north, east - last_east), step_mps)
    north, east = _clamped((last_north + change[0], last_east + change[1]), limits.speed_mps)
    down = last_down + min(max(down - last_down, -step_mps), step_mps)
    down = min(max(down, -limits.climb_mps), limits.descent_mps)
    yaw_step = math.radians(limits.yaw_acceleration_dps2) * step_s
    yaw = last.yaw_rate_radps + min(max(yaw - last.yaw_rate_radps, -yaw_step), yaw_step)
    yaw = min(max(yaw, -top_radps), top_radps)

    north, east = _inside_radius((north, east), place.from_engagement_ne_m, limits)
    if place.height_m is None:
        down = 0.0
    elif place.height_m <= limits.floor_m:
        down = min(down, 0.0)
    elif place.height_m >= limits.ceiling_m:
        down = max(down, 0.0)
    return SafeSetpoint((north, east, down), yaw, _MINT)


def held_back_by(wish: Setpoint, place: Place, limits: LimitsConfig) -> tuple[str, ...]:
    """Settings whose edge of the envelope a finite wish runs into, for the operator."""
    down = wish.velocity_ned_mps[2]
    flat = _clamped(wish.velocity_ned_mps[:2], limits.speed_mps)
    inside = _inside_radius(flat, place.from_engagement_ne_m, limits)
    checks = (
        (math.dist(flat, inside) > NOTED_MPS, "at limits.radius_m"),
        (place.height_m is not None and place.height_m <= limits.floor_m and down > NOTED_MPS, "at limits.floor_m"),
        (
            place.height_m is not None and place.height_m >= limits.ceiling_m and down < -NOTED_MPS,
            "at limits.ceiling_m",
        ),
    )
    return tuple(name for is_met, name in checks if is_met)


def _clamped(vector: tuple[float, float], longest: float) -> tuple[float, float]:
    length = math.hypot(*vector)
    if length <= longest:
        return vector
    if math.isinf(length):  # of finite numbers near the largest there are
        vector = vector[0] / 4, vector[1] / 4
        length = math.hypot(*vector)
    # divided first: the product overflows for such numbers
    return vector[0] / length * longest, vector[1] / length * longest


def _inside_radius(
    velocity_ne_mps: tuple[float, float], from_engagement_ne_m: tuple[float, float] | None, limits: LimitsConfig
) -> tuple[float, float]:
    distance_m = math.hypot(*from_engagement_ne_m) if from_engagement_ne_m is not None else math.inf
    if from_engagement_ne_m is None or math.isinf(distance_m):
        return 0.0, 0.0
    if distance_m < 1e-3:
        return velocity_ne_mps
    out = from_engagement_ne_m[0] / distance_m, from_engagement_ne_m[1] / distance_m
    outwards_mps = velocity_ne_mps[0] * out[0] + velocity_ne_mps[1] * out[1]
    # from such a speed it stands at the radius: it flies on for a while, then brakes
    late_mps = limits.acceleration_mps2 * RESPONSE_S
    rest_m = max(limits.radius_m - distance_m, 0.0)
    top_mps = math.sqrt(late_mps**2 + 2 * limits.acceleration_mps2 * rest_m) - late_mps
    excess_mps = max(outwards_mps - top_mps, 0.0)
    return velocity_ne_mps[0] - excess_mps * out[0], velocity_ne_mps[1] - excess_mps * out[1]
