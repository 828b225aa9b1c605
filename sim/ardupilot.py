"""ArduCopter's personality: GUIDED, its time-outs and its failsafes, as measured on ArduCopter 4.7 in the loop."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim.personality import (
    ACCEPTED,
    DENIED,
    FAILED,
    Flight,
    Parameter,
    Personality,
    Setpoint,
    understood,
    whole,
)
from sim.vehicle import Airframe, Limits, VelocityCommand

_READY_S = 23.6
_POSITION_S = 41.4
_RC_LOSS_S = 1.0
_GPS_LOSS_S = 8.0
_TURN_RADPS = math.radians(60.0)
_LOOK_AHEAD_MPS = 1.0  # slower than this, the direction of travel says nothing
_UP_MPS, _DOWN_MPS = 2.5, 1.5  # the documented defaults of WPNAV_SPEED_UP and WPNAV_SPEED_DN
# The reference runs past the speed limit by this much: braking from 9.9 m/s begins about 1.1 s late.
_OVERRUN_MPS = 2.8

_BODY_FRAMES = {mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED}
_LOCAL_FRAMES = {mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED}

_CONTINUE_GUIDED = 4  # bit of FS_OPTIONS
_IGNORE_PILOT_YAW = 4  # bit of GUID_OPTIONS


class ArduCopter(Personality):
    """ArduCopter, a quadrotor.

    POSHOLD, ALT_HOLD and STABILIZE fly like LOITER here, AUTO has no mission and holds. Yaw angles are followed as the
    message's definition says; that was not measured.
    """

    AUTOPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    # Fitted, with the limits below, to the measured answers to steps, to braking and to yawing while it flies.
    AIRFRAME = Airframe(velocity_gain_per_s=2.0, integral_gain_per_s2=1.0, drag_per_s=0.07, attitude_lag_s=0.12)
    MODES: ClassVar[Mapping[str, int]] = {
        "STABILIZE": 0,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "LAND": 9,
        "POSHOLD": 16,
        "BRAKE": 17,
    }
    MODE_ON_GROUND = "STABILIZE"
    MODE_IN_AIR = "LOITER"
    LAND_MODE = "LAND"
    HOME_MODE = "RTL"
    AUTONOMOUS_BITS: ClassVar[Mapping[str, int]] = dict.fromkeys(
        ("AUTO", "GUIDED", "RTL", "LAND", "BRAKE"),
        mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
    )
    PARAMETERS: ClassVar[Mapping[str, Parameter]] = {
        "FS_OPTIONS": Parameter(16.0, mavlink.MAV_PARAM_TYPE_INT32),
        "GUID_OPTIONS": Parameter(0.0, mavlink.MAV_PARAM_TYPE_INT32),
        "GUID_TIMEOUT": Parameter(3.0, mavlink.MAV_PARAM_TYPE_REAL32),
        "WPNAV_SPEED": Parameter(1000.0, mavlink.MAV_PARAM_TYPE_REAL32),  # cm/s
    }
    SENDS_PARAMETERS_BYTEWISE = False
    # Not measured: a link without a ground station is quiet.
    INTERVALS_S: ClassVar[Mapping[int, float]] = {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.5,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.25,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.5,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 0.5,
    }
    HEARTBEAT_AFTER_MODE_S = 0.1
    REFUSAL = FAILED
    LIMITS = Limits(accel_mps2=2.5, jerk_mps3=3.0, speed_mps=10.0)
    HOME_HEIGHT_M = 15.0  # RTL_ALT, the documented default
    CLIMB_MPS = _UP_MPS
    SPOOL_S = 4.1
    STICK_SPEED_MPS = 5.0
    STICK_YAW_RATE_RADPS = _TURN_RADPS

    def __init__(self, flight: Flight, rng: np.random.Generator) -> None:
        super().__init__(flight, rng)
        speed_mps = flight.parameters["WPNAV_SPEED"] / 100
        self._guided_limits = Limits(accel_mps2=2.5, jerk_mps3=5.0, speed_mps=speed_mps, overrun_mps=_OVERRUN_MPS)
        self._is_rc_loss_answered = False
        self._is_gps_loss_answered = False

    @property
    def is_ready(self) -> bool:
        return self.flight.time_s - self.flight.started_s >= _READY_S

    @property
    def _has_position(self) -> bool:
        lost_s = self.flight.gps_lost_s
        is_lost = lost_s is not None and self.flight.time_s - lost_s >= _GPS_LOSS_S
        return not is_lost and self.flight.time_s - self.flight.started_s >= _POSITION_S

    def enter(self, mode: str) -> bool:
        # After a loss of RC, GUIDED is still accepted: the failsafe answers a loss once.
        if mode not in {"STABILIZE", "ALT_HOLD", "LAND"} and not self._has_position:
            return False
        self.change_mode(mode)
        return True

    def mode_results(self, params: tuple[float, ...]) -> tuple[int, ...]:
        if not whole(params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return (DENIED,)
        for name, number in self.MODES.items():
            if number == whole(params[1]):
                return (ACCEPTED if self.enter(name) else FAILED,)
        return (FAILED,)

    def take_off_result(self, altitude_m: float) -> int:
        flight = self.flight
        is_possible = flight.mode == "GUIDED" and flight.is_armed and flight.vehicle.is_on_ground
        if not (is_possible and math.isfinite(altitude_m) and altitude_m > 0):
            return FAILED
        self.start_climb(altitude_m)
        return ACCEPTED

    def receive_setpoint(self, message: Any) -> None:
        if self.flight.mode != "GUIDED":
            return
        self.climb_goal_m = None  # any setpoint ends a take-off, at whatever height
        is_body = message.coordinate_frame in _BODY_FRAMES
        if is_body or message.coordinate_frame in _LOCAL_FRAMES:
            self.setpoint = understood(message, self.flight, is_body=is_body)
        else:
            self.setpoint = None

    def update(self) -> VelocityCommand:
        self._look_for_losses()
        match self.flight.mode:
            case "GUIDED":
                return self._guided()
            case "RTL":
                return self.go_home()
            case "LAND":
                return self.land()
            case "BRAKE" | "AUTO":
                return self.hold(self.LIMITS)
            case _:
                return self.fly_by_sticks(self.LIMITS)

    def _look_for_losses(self) -> None:
        flight = self.flight
        is_flying = not flight.vehicle.is_on_ground
        if flight.without_rc_s < _RC_LOSS_S:
            self._is_rc_loss_answered = False
        elif not self._is_rc_loss_answered and is_flying:
            self._is_rc_loss_answered = True
            if flight.mode == "GUIDED" and int(flight.parameters["FS_OPTIONS"]) & _CONTINUE_GUIDED:
                flight.texts.append((mavlink.MAV_SEVERITY_WARNING, "Radio Failsafe - Continuing Guided Mode"))
            elif flight.mode not in {"RTL", "LAND"}:
                self.change_mode("RTL" if self._has_position else "LAND")
        if flight.gps_lost_s is not None and not self._is_gps_loss_answered and not self._has_position and is_flying:
            self._is_gps_loss_answered = True
            self.change_mode("LAND")
        flight.is_failsafe = flight.has_low_battery or self._is_rc_loss_answered or self._is_gps_loss_answered

    def _guided(self) -> VelocityCommand:
        flight, goal_m = self.flight, self.climb_goal_m if self.flight.is_armed else None
        if goal_m is not None:
            if goal_m - flight.vehicle.height_m > 0.1:
                return self.climb(goal_m)
            self.leave_place()
        self.climb_goal_m = None
        if flight.vehicle.is_on_ground:
            return VelocityCommand()  # only a take-off command lifts it
        if self.setpoint and flight.time_s - self.setpoint.received_s > flight.parameters["GUID_TIMEOUT"]:
            self.setpoint = None
        setpoint = self.setpoint
        yaw_rate_radps = self._guided_yaw_rate(setpoint)
        if setpoint is None:
            return self.hold(self._guided_limits, yaw_rate_radps)
        self.leave_place()
        north_mps, east_mps, down_mps = setpoint.velocity_ned_mps
        velocity = (north_mps, east_mps, min(max(down_mps, -_UP_MPS), _DOWN_MPS))
        return VelocityCommand(velocity, yaw_rate_radps, self._guided_limits)

    def _guided_yaw_rate(self, setpoint: Setpoint | None) -> float:
        stick = self.flight.stick(4)
        if stick and not int(self.flight.parameters["GUID_OPTIONS"]) & _IGNORE_PILOT_YAW:
            return stick * self.STICK_YAW_RATE_RADPS
        if setpoint is None:
            return 0.0
        if setpoint.yaw_rate_radps is not None:
            return setpoint.yaw_rate_radps
        if setpoint.yaw_rad is not None:
            return self.yaw_rate_towards(setpoint.yaw_rad, _TURN_RADPS)
        north_mps, east_mps, _ = setpoint.velocity_ned_mps
        if math.hypot(north_mps, east_mps) < _LOOK_AHEAD_MPS:
            return 0.0
        return self.yaw_rate_towards(math.atan2(east_mps, north_mps), _TURN_RADPS)
