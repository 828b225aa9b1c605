"""What differs between autopilots, and what their ways of flying have in common.

A `Personality` decides: it takes setpoints and mode requests, looks at its timers, and flies by returning velocity
commands. It neither parses nor packs a message.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim.vehicle import Airframe, Limits, Vector, VehicleState, VelocityCommand

ORIGIN_ALT_M = 488.0  # of the ground, above mean sea level

_STICK_DEAD_ZONE = 0.05
_HOLD_GAIN_PER_S = 0.5  # no overshoot behind the lag of the velocity
_HOLD_BELOW_MPS = 0.4
_CLIMB_GAIN_PER_S = 0.6
_NEAR_HOME_M = 1.0
_MAX_YAW_RATE_RADPS = math.radians(200.0)  # MC_YAWRATE_MAX of PX4; keeps absurd commands finite

# Bits of the type mask of SET_POSITION_TARGET_LOCAL_NED.
_IGNORE_POSITION = 0b111
IGNORE_VELOCITY = 0b111 << 3
_IGNORE_ACCELERATION = 0b111 << 6
_IGNORE_YAW = 1 << 10
_IGNORE_YAW_RATE = 1 << 11

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
TEMPORARILY_REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = mavlink.MAV_RESULT_DENIED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
FAILED: int = mavlink.MAV_RESULT_FAILED


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A velocity setpoint as the autopilot understood it; yaw fields that it shall ignore are None."""

    velocity_ned_mps: Vector
    yaw_rad: float | None
    yaw_rate_radps: float | None
    received_s: float


@dataclass(frozen=True, slots=True)
class Parameter:
    """Default value and MAV_PARAM_TYPE."""

    value: float
    type: int


@dataclass(slots=True)
class Flight:
    """What an autopilot knows: written by the fake and its personality, read by both."""

    vehicle: VehicleState
    mode: str
    is_armed: bool
    started_s: float  # when the boot sequence began
    parameters: dict[str, float]
    time_s: float = 0.0
    rc_lost_s: float | None = None  # since when; None: the radio control is there; -inf: it never was
    gps_lost_s: float | None = None
    has_low_battery: bool = False
    is_failsafe: bool = False
    channels_us: list[int] = field(default_factory=lambda: [1500] * 4 + [1000] * 14)
    texts: list[tuple[int, str]] = field(default_factory=list)  # MAV_SEVERITY, text; not sent yet

    @property
    def without_rc_s(self) -> float:
        """For how long the radio control has been lost; 0 while it is there, and if it never was."""
        lost_s = self.rc_lost_s
        return 0.0 if lost_s is None or lost_s == -math.inf else self.time_s - lost_s

    def stick(self, channel: int) -> float:
        """Deflection of RC channel `channel` (1 is the first), -1..1, 0 in the dead zone and without RC."""
        share = (self.channels_us[channel - 1] - 1500) / 500
        return 0.0 if self.rc_lost_s is not None or abs(share) < _STICK_DEAD_ZONE else min(max(share, -1.0), 1.0)


class Personality(ABC):
    """What one kind of autopilot does: modes, setpoints, failsafes. It flies by returning a velocity command.

    Class attributes
    ----------------
    MODES : custom_mode of HEARTBEAT by name.
    PARAMETERS : those that can be read, in order.
    INTERVALS_S : of the messages that it sends unasked, by message id.
    HEARTBEAT_AFTER_MODE_S : a heartbeat follows a change of mode that soon; None: only when it is due anyway.
    REFUSAL : MAV_RESULT of what it will not do now.
    """

    AUTOPILOT: ClassVar[int]
    AIRFRAME: ClassVar[Airframe]
    MODES: ClassVar[Mapping[str, int]]
    MODE_ON_GROUND: ClassVar[str]
    MODE_IN_AIR: ClassVar[str]
    LAND_MODE: ClassVar[str]
    HOME_MODE: ClassVar[str]
    AUTONOMOUS_BITS: ClassVar[Mapping[str, int]]  # of base_mode; absent modes are flown by stick
    PARAMETERS: ClassVar[Mapping[str, Parameter]]
    SENDS_PARAMETERS_BYTEWISE: ClassVar[bool]
    INTERVALS_S: ClassVar[Mapping[int, float]]
    HEARTBEAT_AFTER_MODE_S: ClassVar[float | None]
    REFUSAL: ClassVar[int]
    LIMITS: ClassVar[Limits]  # of the modes that it flies by itself
    HOME_HEIGHT_M: ClassVar[float]
    CLIMB_MPS: ClassVar[float]
    SPOOL_S: ClassVar[float]  # from the command to take off until the vehicle moves
    STICK_SPEED_MPS: ClassVar[float]
    STICK_YAW_RATE_RADPS: ClassVar[float]

    def __init__(self, flight: Flight, rng: np.random.Generator) -> None:
        self.flight = flight
        self.home_ne_m = flight.vehicle.pos_ned_m[:2]
        self.setpoint: Setpoint | None = None  # the one that is obeyed now
        self.climb_goal_m: float | None = None
        self._climb_from_s = 0.0
        self._anchor_ned_m: Vector | None = None
        self._is_high_enough = False

    @property
    @abstractmethod
    def is_ready(self) -> bool:
        """Whether it can be armed."""

    @abstractmethod
    def enter(self, mode: str) -> bool:
        """Change the mode on demand, whoever demands; False if it is refused."""

    @abstractmethod
    def mode_results(self, params: tuple[float, ...]) -> tuple[int, ...]:
        """Obey DO_SET_MODE and return the MAV_RESULT of every acknowledgement, in order."""

    @abstractmethod
    def take_off_result(self, altitude_m: float) -> int:
        """Obey NAV_TAKEOFF; `altitude_m` is its parameter 7."""

    @abstractmethod
    def receive_setpoint(self, message: Any) -> None:
        """Take a SET_POSITION_TARGET_LOCAL_NED that is addressed to this system."""

    @abstractmethod
    def update(self) -> VelocityCommand:
        """Look at all timers and fly on; called every few milliseconds. Not flown while disarmed."""

    def restart(self) -> None:
        """Forget what was received, and on the ground the mode."""
        self.setpoint = None
        if self.flight.vehicle.is_on_ground:
            self.change_mode(self.MODE_ON_GROUND)

    def change_mode(self, mode: str) -> None:
        """Be in `mode` from now on."""
        flight = self.flight
        if mode == flight.mode:
            return
        flight.mode = mode
        self.setpoint = None
        flight.vehicle = flight.vehicle.with_new_reference()
        self.climb_goal_m = None
        self._anchor_ned_m = None
        self._is_high_enough = False

    def start_climb(self, height_m: float) -> None:
        """Begin to take off to `height_m` above ground."""
        self.climb_goal_m = height_m
        self._climb_from_s = self.flight.time_s + self.SPOOL_S
        self._anchor_ned_m = self.flight.vehicle.pos_ned_m

    def climb(self, goal_m: float) -> VelocityCommand:
        """Climb on above one place."""
        left_m = goal_m - self.flight.vehicle.height_m
        if not self.flight.is_armed:
            self._climb_from_s = self.flight.time_s + self.SPOOL_S
        if self.flight.time_s < self._climb_from_s:
            return VelocityCommand()
        north_mps, east_mps, _ = self._towards_anchor()
        up_mps = min(self.CLIMB_MPS, _CLIMB_GAIN_PER_S * left_m)
        return VelocityCommand((north_mps, east_mps, -up_mps), limits=self.LIMITS)

    def hold(self, limits: Limits, yaw_rate_radps: float = 0.0) -> VelocityCommand:
        """Brake, then stay where the vehicle came to rest."""
        vehicle = self.flight.vehicle
        if self._anchor_ned_m is None and math.hypot(*vehicle.velocity_ned_mps) < _HOLD_BELOW_MPS:
            self._anchor_ned_m = vehicle.pos_ned_m
        return VelocityCommand(self._towards_anchor(), yaw_rate_radps, limits)

    def leave_place(self) -> None:
        """Do not return to where the vehicle was held before."""
        self._anchor_ned_m = None

    def fly_by_sticks(self, limits: Limits) -> VelocityCommand:
        """Velocities by stick, see `FakeAutopilot.set_sticks`; hold if they are centred."""
        roll, pitch, throttle, yaw = (self.flight.stick(channel) for channel in (1, 2, 3, 4))
        yaw_rate_radps = yaw * self.STICK_YAW_RATE_RADPS
        if roll == pitch == throttle == 0.0:
            return self.hold(limits, yaw_rate_radps)
        self.leave_place()
        north, east = rotated(-pitch, roll, self.flight.vehicle.yaw_rad)
        speed_mps = self.STICK_SPEED_MPS
        velocity = (north * speed_mps, east * speed_mps, -throttle * self.CLIMB_MPS)
        return VelocityCommand(velocity, yaw_rate_radps, limits)

    def land(self) -> VelocityCommand:
        """Come down above one place and disarm on the ground."""
        if self.flight.vehicle.is_on_ground:
            self.flight.is_armed = False
            return VelocityCommand()
        held = self.hold(self.LIMITS)
        # The documented defaults of ArduCopter, LAND_SPEED below 10 m and WPNAV_SPEED_DN above; PX4 is much the same.
        down_mps = 0.5 if self.flight.vehicle.height_m < 10.0 else 1.5
        return VelocityCommand((*held.velocity_ned_mps[:2], down_mps), limits=self.LIMITS)

    def go_home(self) -> VelocityCommand:
        """Climb to the safe height, fly to where the vehicle started, land there."""
        vehicle = self.flight.vehicle
        north_m, east_m = (home - p for home, p in zip(self.home_ne_m, vehicle.pos_ned_m, strict=False))
        way_m = math.hypot(north_m, east_m)
        left_m = self.HOME_HEIGHT_M - vehicle.height_m
        self._is_high_enough = self._is_high_enough or left_m < 0.3
        if not self._is_high_enough:
            held = self.hold(self.LIMITS)
            up_mps = min(self.CLIMB_MPS, _CLIMB_GAIN_PER_S * left_m)
            return VelocityCommand((*held.velocity_ned_mps[:2], -up_mps), limits=self.LIMITS)
        if way_m < _NEAR_HOME_M:
            return self.land()
        self.leave_place()
        share = min(self.STICK_SPEED_MPS, _HOLD_GAIN_PER_S * way_m) / way_m
        return VelocityCommand((north_m * share, east_m * share, 0.0), limits=self.LIMITS)

    def yaw_rate_towards(self, yaw_rad: float, most_radps: float) -> float:
        """Rate that turns the nose to `yaw_rad`."""
        error_rad = math.remainder(yaw_rad - self.flight.vehicle.yaw_rad, 2 * math.pi)
        return min(max(2.0 * error_rad, -most_radps), most_radps)

    def _towards_anchor(self) -> Vector:
        if self._anchor_ned_m is None:
            return (0.0, 0.0, 0.0)
        north, east, down = (
            min(max(_HOLD_GAIN_PER_S * (a - p), -1.0), 1.0)
            for a, p in zip(self._anchor_ned_m, self.flight.vehicle.pos_ned_m, strict=True)
        )
        return north, east, down


def rotated(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """North and east of a vector that points `x` forward and `y` to the right of a heading."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * x - s * y, s * x + c * y


def understood(message: Any, flight: Flight, *, is_body: bool) -> Setpoint | None:
    """Velocity and yaw of a SET_POSITION_TARGET_LOCAL_NED; None if it is not one of a whole, finite velocity alone."""
    must_ignore = _IGNORE_POSITION | _IGNORE_ACCELERATION
    if message.type_mask & (must_ignore | IGNORE_VELOCITY) != must_ignore:
        return None
    if not all(map(math.isfinite, (message.vx, message.vy, message.vz))):
        return None
    # Far beyond any speed: absurd ones shall not overflow where they are rotated and sent back.
    north_mps, east_mps, down_mps = (min(max(v, -1e6), 1e6) for v in (message.vx, message.vy, message.vz))
    if is_body:  # by the heading alone, not by roll and pitch
        north_mps, east_mps = rotated(north_mps, east_mps, flight.vehicle.yaw_rad)
    has_yaw = not message.type_mask & _IGNORE_YAW and math.isfinite(message.yaw)
    has_rate = not message.type_mask & _IGNORE_YAW_RATE
    rate_radps = message.yaw_rate if math.isfinite(message.yaw_rate) else 0.0
    rate_radps = min(max(rate_radps, -_MAX_YAW_RATE_RADPS), _MAX_YAW_RATE_RADPS)
    return Setpoint(
        (north_mps, east_mps, down_mps),
        message.yaw if has_yaw else None,
        rate_radps if has_rate else None,
        flight.time_s,
    )


def whole(value: float) -> int:
    """A whole number that came as a float; -1 for what is none."""
    return int(value) if math.isfinite(value) else -1
