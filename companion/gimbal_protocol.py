"""MAVLink's gimbal protocol v2, as a client of the gimbal manager: its words as events, our orders as messages.

Sans-I/O. On ArduPilot and PX4 the autopilot is the manager, whatever drives the gimbal itself. What they take, by
their sources: ArduPilot reads GIMBAL_MANAGER_SET_PITCHYAW with angles and no rates, from anybody, and of its flags
YAW_LOCK alone decides on the yaw's frame (AP_Mount); PX4 does not read that message, but GIMBAL_MANAGER_SET_ATTITUDE,
and only from who has the primary control (InputMavlinkGimbalV2).
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.camera_model import angles, quaternion, rotation_of
from companion.codec import AUTOPILOT_COMPONENT
from companion.config import GimbalConfig
from companion.time_sync import BootClock
from companion.types import (
    Autopilot,
    Claim,
    GimbalAim,
    GimbalAttitude,
    GimbalControl,
    GimbalManager,
    GimbalOrder,
    Holder,
    LinkEvent,
)

ASK_EVERY_S = 2.0
ATTITUDE_HZ = 30.0  # as frames
STATUS_HZ = 5.0
FROZEN_AFTER = 5  # attitudes with one stamp it is none; two routers on the way bring one attitude twice
MAX_SAME_S = 0.2  # that one without a clock may repeat itself: 0.3 s with what a frame may be ahead of it
MIN_RATE_SHARE = 0.5  # of a rate that was asked for; below, it is asked for again
HORIZON = mavlink.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mavlink.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
EARTH_YAW = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK | mavlink.GIMBAL_MANAGER_FLAGS_YAW_IN_EARTH_FRAME
VEHICLE_YAW = mavlink.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
RELEASE = -3.0  # of MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: give up control where we have it
UNCHANGED = -1.0
_ALL_ROUND_RAD = math.tau - 0.01
_NAN = math.nan
_CONTENT = struct.Struct("<H7f")  # flags, q, angular velocity; as bytes, in which a NaN is equal to itself


@dataclass(frozen=True, slots=True)
class _Told:
    """The newest attitude of one component, and what its stamps have been like.

    repeats : how many attitudes before had its stamp.
    has_ticked : whether the stamp was ever another one.
    content : what it says, without its stamp; it says so since `since_s`, our time.
    """

    stamp_ms: int
    content: bytes
    since_s: float
    repeats: int = 0
    has_ticked: bool = False


def _told(message: Any, before: _Told | None, now_s: float) -> _Told:
    rates_radps = (message.angular_velocity_x, message.angular_velocity_y, message.angular_velocity_z)
    content, stamp_ms = _CONTENT.pack(message.flags, *message.q, *rates_radps), message.time_boot_ms
    if before is None:
        return _Told(stamp_ms, content, now_s)
    since_s = before.since_s if content == before.content else now_s
    if stamp_ms == before.stamp_ms:
        return _Told(stamp_ms, content, since_s, before.repeats + 1, before.has_ticked)
    return _Told(stamp_ms, content, since_s, has_ticked=True)


class GimbalProtocol:
    """The client of one gimbal; silent and deaf where none is configured.

    An attitude is of its `time_boot_ms`. Once that has advanced, one that stands still is of an old attitude, said
    again, and means nothing: telemetry that hangs must not be taken for a gimbal that does not turn.

    A device that leaves it at 0, or where it is from the first attitude on, has no clock that could be mapped to ours:
    its attitudes are of the time at which they are read. Nothing is taken off that, as nothing is off the smallest
    delay of a stamp: they are really older, by the link's delay and by up to a period of the command loop (50 ms at
    20 Hz, in which a gimbal that turns at 40 degrees/s turns by 2). That it still measures is only to be seen by its
    saying something else: what it repeats to the bit for 0.2 s is no measurement from then on. No gimbal in flight is
    that quiet; one on a bench may be.

    Parameters
    ----------
    sender : of the component that shall be in control, `Wire.sender`.
    autopilot_clock : for what the manager itself says; a device of its own has its own clock.
    """

    def __init__(self, sender: Any, config: GimbalConfig, autopilot_clock: BootClock) -> None:
        self._mav = sender
        self._config = config
        self._manager: int | None = None  # component
        self._device = config.device_id  # of the gimbal; 0: the one that the manager names
        self._holder = Holder.NOBODY
        self._autopilot_clock = autopilot_clock
        self._device_clock = BootClock()
        self._told: dict[int, _Told] = {}  # by the component that tells: each has its own clock, or none
        self._asked_s = -math.inf
        self._heard = {"GIMBAL_DEVICE_ATTITUDE_STATUS": 0, "GIMBAL_MANAGER_STATUS": 0}  # since then

    def receive(self, messages: Iterable[Any], now_s: float) -> tuple[LinkEvent, ...]:
        """Events in messages that have arrived; never raises, whatever is in them."""
        if self._config.axes == "none":
            return ()
        events: list[LinkEvent | None] = []
        attitudes: dict[float, GimbalAttitude] = {}  # of several without a stamp, the last one is of this time
        for message in messages:
            if message.get_srcSystem() != self._mav.srcSystem:
                continue
            match message.get_type():
                case "GIMBAL_MANAGER_INFORMATION":
                    events.append(self._information(message))
                case "GIMBAL_MANAGER_STATUS" if message.get_srcComponent() == self._manager:
                    events.append(self._status(message, now_s))
                case "GIMBAL_DEVICE_ATTITUDE_STATUS" if self._is_device(message):
                    attitude = self._attitude(message, now_s)
                    if attitude is not None:
                        attitudes[attitude.time_s] = attitude
        return (*(event for event in events if event is not None), *attitudes.values())

    def _information(self, message: Any) -> LinkEvent | None:
        """What the manager says of the gimbal; the first one that has ours is the manager."""
        device, component = message.gimbal_device_id, message.get_srcComponent()
        if self._config.device_id not in {0, device} or self._manager not in {None, component}:
            return None
        if self._manager is not None and device != self._device:  # of several the first, until we begin anew
            return None
        self._manager, self._device = component, device
        flags = message.cap_flags
        pitch, yaw = (message.pitch_min, message.pitch_max), (message.yaw_min, message.yaw_max)
        is_endless = bool(flags & mavlink.GIMBAL_MANAGER_CAP_FLAGS_SUPPORTS_INFINITE_YAW)
        is_endless = is_endless or not _is_range(yaw) or yaw[1] - yaw[0] >= _ALL_ROUND_RAD
        return GimbalManager(
            pitch if _is_range(pitch) else (-math.pi / 2, math.pi / 2),
            None if is_endless else yaw,
            bool(flags & mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK),
        )

    def _status(self, message: Any, now_s: float) -> LinkEvent | None:
        if message.gimbal_device_id not in {0, self._device}:
            return None
        self._heard["GIMBAL_MANAGER_STATUS"] += 1
        primary = (message.primary_control_sysid, message.primary_control_compid)
        if primary == (self._mav.srcSystem, self._mav.srcComponent):
            self._holder = Holder.US
        else:
            self._holder = Holder.NOBODY if primary == (0, 0) else Holder.OTHER
        # the pilot's transmitter alone turns it
        is_pilots = message.flags & mavlink.GIMBAL_MANAGER_FLAGS_RC_EXCLUSIVE
        return GimbalControl(now_s, Holder.OTHER if is_pilots else self._holder)

    def _is_device(self, message: Any) -> bool:
        """Whether an attitude is that of our gimbal: by its number, or by who sends it where there is none."""
        if self._manager is None:
            return False
        if message.gimbal_device_id:
            return bool(message.gimbal_device_id == self._device)
        return message.get_srcComponent() in {self._device, self._manager}

    def _attitude(self, message: Any, now_s: float) -> GimbalAttitude | None:
        ned_from_camera = rotation_of(message.q)
        if ned_from_camera is None:
            return None
        self._heard["GIMBAL_DEVICE_ATTITUDE_STATUS"] += 1
        time_s = self._time_s(message, now_s)
        if time_s is None:
            return None
        return GimbalAttitude(time_s, *angles(ned_from_camera), _is_yaw_on_earth(message.flags))

    def _time_s(self, message: Any, now_s: float) -> float | None:
        """Our time of an attitude; None where it is not known, or nothing new."""
        component = message.get_srcComponent()
        told = self._told[component] = _told(message, self._told.get(component), now_s)
        if told.has_ticked and (told.repeats or told.stamp_ms == 0):
            return None
        if told.stamp_ms == 0 or told.repeats >= FROZEN_AFTER:
            self._device_clock.reset()  # should it tick later, it does so from another time
            return now_s if now_s - told.since_s <= MAX_SAME_S else None
        boot_s = told.stamp_ms / 1000
        clock = self._device_clock  # a manager that is not the autopilot counts from its own start
        if component == AUTOPILOT_COMPONENT:
            clock = self._autopilot_clock
            if clock.has_gone_back(boot_s):  # that it began anew is for the codec to see, and to say
                return None
        elif clock.has_gone_back(boot_s):
            clock.reset()
        return clock.ours_s(boot_s, now_s)

    def send(self, order: GimbalOrder, autopilot: Autopilot | None, now_s: float) -> None:
        """Write an order; ask for what the manager does not say by itself, again where it does not come."""
        if self._config.axes == "none" or autopilot is None:
            return
        if now_s - self._asked_s >= ASK_EVERY_S:
            self._ask(now_s)
        if order.claim is Claim.TAKE:
            self._configure(self._mav.srcSystem, self._mav.srcComponent)
        elif order.claim is Claim.RELEASE:
            self._configure(RELEASE, RELEASE)
        if order.aim is not None and self._manager is not None:
            self._aim(order.aim, autopilot)

    def release(self) -> None:
        """Give up control where we have it: the application ends."""
        if self._holder is Holder.US:
            self._configure(RELEASE, RELEASE)

    def _ask(self, now_s: float) -> None:
        wanted = (
            ("GIMBAL_MANAGER_STATUS", mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS, STATUS_HZ),
            ("GIMBAL_DEVICE_ATTITUDE_STATUS", mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS, ATTITUDE_HZ),
        )
        if self._manager is None:
            self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION)
        since_s = min(now_s - self._asked_s, ASK_EVERY_S * 2)
        for name, number, rate_hz in wanted:
            if self._heard[name] < MIN_RATE_SHARE * rate_hz * since_s:
                self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)
            self._heard[name] = 0
        self._asked_s = now_s

    def _aim(self, aim: GimbalAim, autopilot: Autopilot) -> None:
        flags = HORIZON | (EARTH_YAW if aim.is_yaw_on_earth else VEHICLE_YAW)
        address = (self._mav.srcSystem, self._manager, flags, self._config.device_id)
        if autopilot is Autopilot.PX4:
            q = quaternion(0.0, aim.pitch_rad, aim.yaw_rad)
            self._mav.gimbal_manager_set_attitude_send(*address, q, _NAN, _NAN, _NAN)
        else:
            self._mav.gimbal_manager_set_pitchyaw_send(*address, aim.pitch_rad, aim.yaw_rad, _NAN, _NAN)

    def _configure(self, system: float, component: float) -> None:
        number = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
        self._command(number, system, component, UNCHANGED, UNCHANGED, 0.0, 0.0, self._config.device_id)

    def _command(self, number: int, *parameters: float) -> None:
        padded = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        component = self._manager if self._manager is not None else AUTOPILOT_COMPONENT
        self._mav.command_long_send(self._mav.srcSystem, component, number, 0, *padded)


def _is_yaw_on_earth(flags: int) -> bool:
    """Whether a gimbal's yaw is from north: without a word on it, where it is locked, as MAVLink defines it."""
    if flags & (mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME):
        return bool(flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
    return bool(flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK)


def _is_range(ends: tuple[float, float]) -> bool:
    return all(map(math.isfinite, ends)) and ends[0] < ends[1]
