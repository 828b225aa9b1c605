"""PX4's personality: OFFBOARD, its loss and its return, as measured on PX4 of April 2026 in the loop."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim.personality import (
    ACCEPTED,
    IGNORE_VELOCITY,
    ORIGIN_ALT_M,
    TEMPORARILY_REJECTED,
    Flight,
    Parameter,
    Personality,
    Setpoint,
    understood,
    whole,
)
from sim.vehicle import Airframe, Limits, VelocityCommand

_POLL_S = 0.4  # how often losses are looked for; makes the measured 1.0 to 1.4 s out of COM_OF_LOSS_T = 1.0
_STREAM_GAP_S = 0.55  # setpoints further apart are no stream: 2 Hz is one, 1 Hz is not
_STREAM_BEFORE_ENTRY_S = 1.0
_STREAM_BEFORE_RETURN_S = 0.3
_STICK_OVERRIDE = 0.3  # COM_RC_STICK_OV, the documented default
_RC_LOSS_S = 0.5  # COM_RC_LOSS_T, the documented default
_GPS_LOSS_S = 1.0
_READY_S = (4.0, 6.0)
_TURN_RADPS = math.radians(45.0)  # MPC_YAWRAUTO_MAX
_SPEED_MPS = 12.0  # MPC_XY_VEL_MAX
_UP_MPS, _DOWN_MPS = 3.0, 1.5  # MPC_Z_VEL_MAX_UP and _DN
_DEFAULT_TAKEOFF_M = 2.5  # MIS_TAKEOFF_ALT
# 0.3 m/s of climb were flown as 0.39.
_CLIMB_GAIN = 1.3
_POSCTL_LIMITS = Limits(accel_mps2=3.0, jerk_mps3=3.0, speed_mps=_SPEED_MPS)

_OVERRIDE_AUTO, _OVERRIDE_OFFBOARD = 1, 2  # bits of COM_RC_OVERRIDE


class Px4(Personality):
    """PX4, a quadrotor.

    Measured: everything about OFFBOARD. From the documentation, not measured: loss of RC (the way home after
    COM_RC_LOSS_T) and of the position (landing). ALTCTL and MANUAL fly like POSCTL, AUTO.MISSION has no mission and
    holds.
    """

    AUTOPILOT = mavlink.MAV_AUTOPILOT_PX4
    # Fitted to the measured speeds; the gain is MPC_XY_VEL_P_ACC.
    AIRFRAME = Airframe(velocity_gain_per_s=1.8, integral_gain_per_s2=0.12, drag_per_s=0.7, attitude_lag_s=0.15)
    MODES: ClassVar[Mapping[str, int]] = {
        name: main << 16 | sub << 24
        for name, main, sub in (
            ("MANUAL", 1, 0),
            ("ALTCTL", 2, 0),
            ("POSCTL", 3, 0),
            ("AUTO.TAKEOFF", 4, 2),
            ("AUTO.LOITER", 4, 3),
            ("AUTO.MISSION", 4, 4),
            ("AUTO.RTL", 4, 5),
            ("AUTO.LAND", 4, 6),
            ("OFFBOARD", 6, 0),
        )
    }
    MODE_ON_GROUND = "AUTO.LOITER"
    MODE_IN_AIR = "AUTO.LOITER"
    LAND_MODE = "AUTO.LAND"
    HOME_MODE = "AUTO.RTL"
    AUTONOMOUS_BITS: ClassVar[Mapping[str, int]] = dict.fromkeys(
        ("AUTO.TAKEOFF", "AUTO.LOITER", "AUTO.MISSION", "AUTO.RTL", "AUTO.LAND", "OFFBOARD"),
        mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED,
    )
    PARAMETERS: ClassVar[Mapping[str, Parameter]] = {
        "COM_OBL_RC_ACT": Parameter(0.0, mavlink.MAV_PARAM_TYPE_INT32),
        "COM_OF_LOSS_T": Parameter(1.0, mavlink.MAV_PARAM_TYPE_REAL32),
        "COM_RC_OVERRIDE": Parameter(1.0, mavlink.MAV_PARAM_TYPE_INT32),
    }
    SENDS_PARAMETERS_BYTEWISE = True
    # Not measured: a link to a companion computer is busy.
    INTERVALS_S: ClassVar[Mapping[int, float]] = {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.02,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1 / 30,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.1,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 0.2,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 0.1,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    }
    HEARTBEAT_AFTER_MODE_S = None
    REFUSAL = TEMPORARILY_REJECTED
    LIMITS = Limits(accel_mps2=3.0, jerk_mps3=5.0, speed_mps=_SPEED_MPS)
    HOME_HEIGHT_M = 30.0
    CLIMB_MPS = 1.5  # MPC_TKO_SPEED
    SPOOL_S = 3.4
    STICK_SPEED_MPS = 5.0
    STICK_YAW_RATE_RADPS = math.radians(100.0)  # MPC_MAN_Y_MAX is 150; the middle of its curve

    def __init__(self, flight: Flight, rng: np.random.Generator) -> None:
        super().__init__(flight, rng)
        self._ready_after_s = float(rng.uniform(*_READY_S))
        self._poll_s = float(rng.uniform(0.0, _POLL_S))
        self._wanted = flight.mode  # the mode that was commanded last; a failsafe does not change it
        self._heard: Setpoint | None = None  # the last message that counts as a setpoint
        self._stream_from_s = math.inf

    @property
    def is_ready(self) -> bool:
        return self.flight.time_s - self.flight.started_s >= self._ready_after_s

    @property
    def _has_position(self) -> bool:
        lost_s = self.flight.gps_lost_s
        return self.is_ready and (lost_s is None or self.flight.time_s - lost_s < _GPS_LOSS_S)

    def _is_streamed(self, for_s: float, gap_s: float) -> bool:
        """Whether setpoints have come in for `for_s` and the last one not longer than `gap_s` ago."""
        now_s = self.flight.time_s
        return self._heard is not None and (
            now_s - self._heard.received_s <= gap_s and now_s - self._stream_from_s >= for_s
        )

    def restart(self) -> None:
        super().restart()
        self._wanted = self.flight.mode
        self._heard = None
        self._stream_from_s = math.inf

    def enter(self, mode: str) -> bool:
        if mode not in {"MANUAL", "ALTCTL", "AUTO.LAND"} and not self._has_position:
            return False
        if mode == "OFFBOARD" and not self._is_streamed(_STREAM_BEFORE_ENTRY_S, _STREAM_GAP_S):
            return False
        self._wanted = mode
        self.flight.is_failsafe = self.flight.has_low_battery
        self.change_mode(mode)
        return True

    def mode_results(self, params: tuple[float, ...]) -> tuple[int, ...]:
        is_custom = whole(params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        number = (whole(params[1]) & 255) << 16 | (whole(params[2]) & 255) << 24
        is_done = is_custom and any(number == known and self.enter(name) for name, known in self.MODES.items())
        return ACCEPTED, ACCEPTED if is_done else TEMPORARILY_REJECTED

    def take_off_result(self, altitude_m: float) -> int:
        height_m = altitude_m - ORIGIN_ALT_M if math.isfinite(altitude_m) else _DEFAULT_TAKEOFF_M
        if height_m <= 0 or not self.enter("AUTO.TAKEOFF"):
            return TEMPORARILY_REJECTED
        self.start_climb(height_m)
        return ACCEPTED

    def receive_setpoint(self, message: Any) -> None:
        flight = self.flight
        if message.target_component not in {0, mavlink.MAV_COMP_ID_AUTOPILOT1}:
            return
        frame = message.coordinate_frame
        if frame not in {mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED}:
            text = f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"
            flight.texts.append((mavlink.MAV_SEVERITY_CRITICAL, text))
            return
        is_body = frame == mavlink.MAV_FRAME_BODY_NED
        setpoint = understood(message, flight, is_body=is_body)
        if setpoint is None:
            # The body frame needs all three velocities; otherwise the message is alive and moves nothing.
            if is_body and message.type_mask & IGNORE_VELOCITY:
                return
            setpoint = Setpoint((0.0, 0.0, 0.0), None, 0.0, flight.time_s)
        if self._heard is None or flight.time_s - self._heard.received_s > _STREAM_GAP_S:
            self._stream_from_s = flight.time_s
        self._heard = setpoint

    def update(self) -> VelocityCommand:
        if self.flight.time_s >= self._poll_s:
            self._poll_s += _POLL_S
            self._poll()
        match self.flight.mode:
            case "OFFBOARD":
                return self._offboard()
            case "AUTO.TAKEOFF":
                return self._take_off()
            case "AUTO.RTL":
                return self.go_home()
            case "AUTO.LAND":
                return self.land()
            case "AUTO.LOITER" | "AUTO.MISSION":
                return self.hold(self.LIMITS)
            case _:
                return self.fly_by_sticks(_POSCTL_LIMITS)

    def _poll(self) -> None:
        flight, mode = self.flight, self.flight.mode
        override = int(flight.parameters["COM_RC_OVERRIDE"])
        is_deflected = max(abs(flight.stick(channel)) for channel in (1, 2, 3, 4)) > _STICK_OVERRIDE
        is_auto = mode in {"AUTO.LOITER", "AUTO.MISSION", "AUTO.RTL"}
        if is_deflected and override & (_OVERRIDE_OFFBOARD * (mode == "OFFBOARD") | _OVERRIDE_AUTO * is_auto):
            self.enter("POSCTL")
        elif self._is_lost() and mode not in {"AUTO.RTL", "AUTO.LAND"}:
            self._wanted = "AUTO.RTL" if self._has_position else "AUTO.LAND"
            flight.is_failsafe = True
            self.change_mode(self._wanted)
        elif self._wanted == "OFFBOARD":
            loss_s = flight.parameters["COM_OF_LOSS_T"]
            if mode == "OFFBOARD" and not self._is_streamed(0.0, loss_s):
                flight.is_failsafe = True
                self.change_mode(self._mode_after_loss())
            elif self._is_streamed(_STREAM_BEFORE_RETURN_S, loss_s):
                flight.is_failsafe = flight.has_low_battery
                self.change_mode("OFFBOARD")

    def _is_lost(self) -> bool:
        """Whether the vehicle flies without its position, or without a radio control that was there before."""
        is_rc_lost = self.flight.without_rc_s >= _RC_LOSS_S
        return (is_rc_lost or not self._has_position) and not self.flight.vehicle.is_on_ground

    def _mode_after_loss(self) -> str:
        """What COM_OBL_RC_ACT asks for; without a pilot the modes by stick become the way home."""
        action = int(self.flight.parameters["COM_OBL_RC_ACT"])
        by_action = {0: "POSCTL", 1: "ALTCTL", 2: "MANUAL", 3: "AUTO.RTL", 4: "AUTO.LAND", 5: "AUTO.LOITER"}
        mode = by_action.get(action, "AUTO.RTL")
        has_pilot = self.flight.rc_lost_s is None
        return mode if has_pilot or mode.startswith("AUTO.") else "AUTO.RTL"

    def _offboard(self) -> VelocityCommand:
        setpoint = self.setpoint = self._heard
        if setpoint is None:
            return self.hold(self.LIMITS)
        self.leave_place()
        north_mps, east_mps, down_mps = setpoint.velocity_ned_mps
        share = min(1.0, _SPEED_MPS / max(math.hypot(north_mps, east_mps), _SPEED_MPS))
        velocity = (north_mps * share, east_mps * share, min(max(_CLIMB_GAIN * down_mps, -_UP_MPS), _DOWN_MPS))
        if setpoint.yaw_rate_radps is not None:
            yaw_rate_radps = setpoint.yaw_rate_radps
        elif setpoint.yaw_rad is not None:
            yaw_rate_radps = self.yaw_rate_towards(setpoint.yaw_rad, _TURN_RADPS)
        else:
            yaw_rate_radps = 0.0
        return VelocityCommand(velocity, yaw_rate_radps)

    def _take_off(self) -> VelocityCommand:
        goal_m = self.climb_goal_m
        if goal_m is not None and goal_m - self.flight.vehicle.height_m > 0.1:
            return self.climb(goal_m)
        self.enter("AUTO.LOITER")
        return self.hold(self.LIMITS)
