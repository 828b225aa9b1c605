"""A gimbal under the vehicle and its manager in the autopilot, as far as gimbal protocol v2 shows them.

What is taken from whom follows the autopilots' sources: ArduPilot's AP_Mount turns the gimbal for anybody, PX4's
InputMavlinkGimbalV2 for who has the primary control, and it reads GIMBAL_MANAGER_SET_ATTITUDE alone. ArduPilot tells
the yaw from the nose; the PX4 of the simulation has a gimbal that tells it from north.
"""

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from sim.personality import ACCEPTED, whole

RATE_RADPS = math.radians(60.0)
LAG_S = 0.08
PITCH_RANGE_RAD = (math.radians(-90.0), math.radians(30.0))
DEVICE_ID = 1

_CAN = (
    mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_ROLL_LOCK
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
)
_RELEASE = -3
_UNCHANGED = -1


class Gimbal:
    """Keeps its roll at 0 and its angles where it is told, as fast as it can; it turns all round.

    Parameters
    ----------
    pitch_rad : where it looks at the start, along the nose; upwards is positive.
    vehicle_yaw_rad : of the vehicle then.
    """

    def __init__(self, pitch_rad: float, vehicle_yaw_rad: float) -> None:
        self.pitch_rad = pitch_rad
        self.yaw_rad = vehicle_yaw_rad  # on earth
        self.pitch_rate_radps = 0.0
        self.yaw_rate_radps = 0.0
        self.primary = (0, 0)  # system and component in control
        self._aim_rad = (pitch_rad, 0.0)
        self._is_yaw_locked = False
        self._vehicle_yaw_rad = vehicle_yaw_rad

    def step(self, dt_s: float, vehicle_yaw_rad: float) -> None:
        """Turn on; without a lock the yaw goes with the vehicle's."""
        self._vehicle_yaw_rad = vehicle_yaw_rad
        pitch_rad, yaw_rad = self._aim_rad
        if not self._is_yaw_locked:
            yaw_rad += vehicle_yaw_rad
        self.pitch_rate_radps = _towards(pitch_rad - self.pitch_rad, dt_s)
        self.yaw_rate_radps = _towards(math.remainder(yaw_rad - self.yaw_rad, math.tau), dt_s)
        self.pitch_rad += self.pitch_rate_radps * dt_s
        self.yaw_rad = math.remainder(self.yaw_rad + self.yaw_rate_radps * dt_s, math.tau)

    def receive(self, message: Any, *, is_px4: bool) -> None:
        """Take a GIMBAL_MANAGER_SET_PITCHYAW or GIMBAL_MANAGER_SET_ATTITUDE that is addressed to the manager."""
        is_attitude = message.get_type() == "GIMBAL_MANAGER_SET_ATTITUDE"
        is_primary = (message.get_srcSystem(), message.get_srcComponent()) == self.primary
        if message.gimbal_device_id not in {0, DEVICE_ID} or (is_px4 and not (is_attitude and is_primary)):
            return
        pitch_rad, yaw_rad = _pitch_and_yaw(message.q) if is_attitude else (message.pitch, message.yaw)
        rates = ("angular_velocity_y", "angular_velocity_z") if is_attitude else ("pitch_rate", "yaw_rate")
        has_rates = not any(math.isnan(getattr(message, name)) for name in rates)
        if not (math.isfinite(pitch_rad) and math.isfinite(yaw_rad)) or has_rates:  # rates are not imitated
            return
        self._aim_rad = (min(max(pitch_rad, PITCH_RANGE_RAD[0]), PITCH_RANGE_RAD[1]), yaw_rad)
        self._is_yaw_locked = bool(message.flags & mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK)

    def configure(self, params: tuple[float, ...], sender: tuple[int, int]) -> int:
        """Obey DO_GIMBAL_MANAGER_CONFIGURE; the MAV_RESULT. Whoever asks for the control gets it, from whomever."""
        wish = (whole(params[0]), whole(params[1]))
        if wish == (_RELEASE, _RELEASE):
            self.primary = (0, 0) if self.primary == sender else self.primary
        elif _UNCHANGED not in wish:
            self.primary = wish
        return ACCEPTED

    def information(self, boot_ms: int) -> Any:
        """GIMBAL_MANAGER_INFORMATION."""
        ends = (0.0, 0.0, *PITCH_RANGE_RAD, -math.pi, math.pi)
        return mavlink.MAVLink_gimbal_manager_information_message(boot_ms, _CAN, DEVICE_ID, *ends)

    def status(self, boot_ms: int) -> Any:
        """GIMBAL_MANAGER_STATUS."""
        return mavlink.MAVLink_gimbal_manager_status_message(boot_ms, 0, DEVICE_ID, *self.primary, 0, 0)

    def attitude(self, boot_ms: int, *, is_px4: bool) -> Any:
        """GIMBAL_DEVICE_ATTITUDE_STATUS."""
        flags = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
        flags |= mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK if self._is_yaw_locked else 0
        yaw_rad = self.yaw_rad
        if is_px4:
            flags |= mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        else:
            flags |= mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
            yaw_rad -= self._vehicle_yaw_rad
        rates = (math.nan, math.nan, math.nan)
        q = _quaternion(self.pitch_rad, yaw_rad)
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot_ms, flags, q, *rates, 0, gimbal_device_id=DEVICE_ID
        )


def _towards(error_rad: float, dt_s: float) -> float:
    return min(max(error_rad / max(LAG_S, dt_s), -RATE_RADPS), RATE_RADPS)


def _quaternion(pitch_rad: float, yaw_rad: float) -> list[float]:
    """(w, x, y, z) of a yaw after a pitch."""
    c_p, s_p, c_y, s_y = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2), math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return [c_p * c_y, -s_p * s_y, s_p * c_y, c_p * s_y]


def _pitch_and_yaw(q: Any) -> tuple[float, float]:
    """Of a quaternion without roll, which is the only kind that this gimbal can follow."""
    w, x, y, z = q
    return 2 * math.atan2(math.hypot(x, y) * math.copysign(1.0, y * w - x * z), math.hypot(w, z)), (
        2 * math.atan2(z, w) if math.hypot(w, z) > math.hypot(x, y) else 2 * math.atan2(-x, y)
    )
