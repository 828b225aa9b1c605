"""What is known of the vehicle: the newest reading of each kind, folded from the link's events."""

import math
from dataclasses import dataclass, field, replace

from companion.types import (
    Attitude,
    Battery,
    Direction,
    GlobalPosition,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LinkEvent,
    LocalState,
    Parameter,
    RangeReading,
    RcChannels,
    Rebooted,
)

MAX_HEARTBEAT_AGE_S = 3.0
MAX_ATTITUDE_AGE_S = 0.3
MAX_POSITION_AGE_S = 0.5
MAX_RANGEFINDER_AGE_S = 0.5
MAX_RC_AGE_S = 2.0
MAX_JUMP_M = 2.0  # of a position, beyond what velocity explains
MAX_ACCELERATION_MPS2 = 10.0  # by which velocity may have changed in between


# fields that the last reading of a kind replaces, whatever its time
_NEWEST: dict[type, str] = {
    Heartbeat: "heartbeat",
    HeightReading: "height",
    GlobalPosition: "place",
    LandedReading: "landed",
    RcChannels: "rc",
    Battery: "battery",
}


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Newest readings, None where there is none; parameters by name."""

    heartbeat: Heartbeat | None = None
    attitude: Attitude | None = None
    local: LocalState | None = None
    height: HeightReading | None = None
    place: GlobalPosition | None = None
    landed: LandedReading | None = None
    forward_range: RangeReading | None = None
    down_range: RangeReading | None = None
    rc: RcChannels | None = None
    battery: Battery | None = None
    parameters: dict[str, float] = field(default_factory=dict)

    def after(self, event: LinkEvent) -> "VehicleState":
        """State with an event taken in."""
        match event:
            case Attitude():  # on a link that swaps messages the newer one stays
                is_newer = self.attitude is None or event.time_s >= self.attitude.time_s
                return replace(self, attitude=event) if is_newer else self
            case LocalState():
                is_newer = self.local is None or event.time_s >= self.local.time_s
                return replace(self, local=event) if is_newer else self
            case RangeReading():
                is_forward = event.direction is Direction.FORWARD
                return replace(self, forward_range=event) if is_forward else replace(self, down_range=event)
            case Parameter():
                return replace(self, parameters={**self.parameters, event.name: event.value})
            case Rebooted():
                return VehicleState(parameters=self.parameters)
            case _:
                name = _NEWEST.get(type(event))
                return replace(self, **{name: event}) if name is not None else self  # type: ignore[arg-type]

    def is_alive(self, now_s: float) -> bool:
        """Whether a heartbeat came within the last 3 s."""
        return self.heartbeat is not None and now_s - self.heartbeat.time_s <= MAX_HEARTBEAT_AGE_S

    def fresh_attitude(self, now_s: float) -> Attitude | None:
        """The attitude, where it is not too old to steer by."""
        attitude = self.attitude
        return attitude if attitude is not None and now_s - attitude.time_s <= MAX_ATTITUDE_AGE_S else None

    def fresh_local(self, now_s: float) -> LocalState | None:
        """The position, where it is not too old to steer by."""
        local = self.local
        return local if local is not None and now_s - local.time_s <= MAX_POSITION_AGE_S else None

    def height_m(self, now_s: float) -> float | None:
        """Height above the place of take-off: as the autopilot says it, else of its local frame."""
        if self.height is not None and self.has_height(now_s):
            return self.height.height_m
        local = self.fresh_local(now_s)
        return -local.pos_ned_m[2] if local is not None else None

    def has_height(self, now_s: float) -> bool:
        """Whether the autopilot says how high it is above the place of take-off."""
        return self.height is not None and now_s - self.height.time_s <= 2 * MAX_POSITION_AGE_S

    def is_over_ground(self, now_s: float) -> bool:
        """Whether a rangefinder that looks down says how high it is."""
        return self.down_range is not None and now_s - self.down_range.time_s <= MAX_RANGEFINDER_AGE_S

    def height_over_ground_m(self, now_s: float) -> float | None:
        """Height above what is below: of a rangefinder that looks down, else above the place of take-off."""
        down = self.down_range
        return down.distance_m if down is not None and self.is_over_ground(now_s) else self.height_m(now_s)

    def has_transmitter(self, now_s: float) -> bool:
        """Whether the pilot's channels come in."""
        return self.rc is not None and bool(self.rc.pwm_us) and now_s - self.rc.time_s <= MAX_RC_AGE_S

    def is_flying(self) -> bool | None:
        """Whether it is in the air; None where it does not say."""
        if self.landed is None or self.landed.landed is Landed.UNKNOWN:
            return None
        return self.landed.landed is Landed.IN_AIR


def jump_ne_m(before: LocalState, after: LocalState) -> tuple[float, float] | None:
    """By how much the local frame has moved between two states, north and east; None where the vehicle has moved.

    An estimator that is reset lets the position jump by more than the velocities explain.
    """
    gap_s = after.time_s - before.time_s
    if gap_s <= 0:
        return None
    north_m, east_m = (
        after.pos_ned_m[k] - before.pos_ned_m[k] - gap_s * (before.velocity_ned_mps[k] + after.velocity_ned_mps[k]) / 2
        for k in (0, 1)
    )
    is_jump = math.hypot(north_m, east_m) > MAX_JUMP_M + MAX_ACCELERATION_MPS2 * gap_s**2 / 2
    return (north_m, east_m) if is_jump else None
