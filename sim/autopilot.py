"""A fake autopilot that speaks real MAVLink 2: bytes in, bytes out, in virtual time.

`FakeAutopilot` is what every autopilot has: the link, commands, streams, parameters, the pilot's side, and a vehicle
that flies. What differs is a `Personality`: `sim.ardupilot.ArduCopter` and `sim.px4.Px4`, which imitate behaviour
measured on ArduCopter 4.7 and PX4 of April 2026 in the loop. What was not measured follows their documentation, and
says so where it stands.

Not imitated: estimator errors (the vehicle knows exactly where it is), missions, fences, setpoints of position or
acceleration (they stop the vehicle).
"""

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim.gimbal import Gimbal
from sim.personality import (
    ACCEPTED,
    DENIED,
    ORIGIN_ALT_M,
    UNSUPPORTED,
    Flight,
    Personality,
    Setpoint,
    whole,
)
from sim.vehicle import Vector, VehicleState, step
from sim.wind import CALM, Wind
from sim.world import Pose

__all__ = ["FakeAutopilot", "Personality", "Setpoint", "Start"]

# The place on the globe of the world's origin, which is also the origin of the local frame.
ORIGIN_LAT_DEG = 47.0
ORIGIN_LON_DEG = 8.0
_METRES_PER_DEG = 111_319.5

_LONGEST_STEP_S = 0.01  # of the vehicle and of all timers, whatever `FakeAutopilot.step` is given
_REBOOT_S = 1.0
_UP_BEFORE_S = 120.0  # an autopilot that starts in the air was switched on that long ago
_RANGEFINDER_M = (0.2, 40.0)
_TEXT_CHUNK = 50
_VELOCITY_AND_YAW_RATE = 0x5C7  # type mask


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """How an autopilot begins.

    pos_ned_m : on the ground (down = 0) it is disarmed and boots; above it is flying, armed and ready.
    mode : by its name in the personality's `MODES`; None is the personality's own. PX4 leaves OFFBOARD soon if no
        setpoints come in.
    has_pilot : whether a radio control is there.
    """

    pos_ned_m: Vector = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    mode: str | None = None
    has_pilot: bool = True


@dataclass(slots=True)
class _Stream:
    interval_s: float
    due_s: float


class FakeAutopilot:
    """An autopilot with its vehicle, for one link.

    Parameters
    ----------
    personality : `sim.ardupilot.ArduCopter` or `sim.px4.Px4`.
    start : where and how it begins.
    seed : of the delays that were measured as a range.
    system_id : of the vehicle; the component is 1.
    parameters : values by name that differ from the defaults in `personality.PARAMETERS`.
    wind : at the vehicle.
    gimbal : that it manages; None: it has none.

    Same construction, same calls: same bytes. Nothing received can make it raise.

    Raises
    ------
    ValueError
        If the start's mode or a parameter is none of the personality's.
    """

    def __init__(
        self,
        personality: type[Personality],
        *,
        start: Start,
        seed: int = 0,
        system_id: int = 1,
        parameters: Mapping[str, float] | None = None,
        wind: Wind = CALM,
        gimbal: Gimbal | None = None,
    ) -> None:
        parameters = parameters or {}
        for name in parameters:
            if name not in personality.PARAMETERS:
                raise ValueError(
                    f"{personality.__name__} has no parameter {name!r}; it has {[*personality.PARAMETERS]}"
                )
        is_flying = start.pos_ned_m[2] < 0.0
        mode = start.mode or (personality.MODE_IN_AIR if is_flying else personality.MODE_ON_GROUND)
        _check_mode(mode, personality)
        drag_per_s = personality.AIRFRAME.drag_per_s
        # A vehicle that flies already leans into the mean wind.
        trim_ne_mps2 = (
            (-drag_per_s * wind.mean_ne_mps[0], -drag_per_s * wind.mean_ne_mps[1]) if is_flying else (0.0, 0.0)
        )
        self._flight = Flight(
            VehicleState(start.pos_ned_m, yaw_rad=start.yaw_rad, trim_ne_mps2=trim_ne_mps2),
            mode,
            is_armed=is_flying,
            started_s=-_UP_BEFORE_S if is_flying else 0.0,
            parameters={name: entry.value for name, entry in personality.PARAMETERS.items()} | dict(parameters),
            rc_lost_s=None if start.has_pilot else -math.inf,
        )
        self._personality = personality(self._flight, np.random.default_rng((seed, 9)))
        self._wind = wind
        self._gimbal = gimbal
        self._system_id = system_id
        self._booted_s = self._flight.started_s
        self._announced_mode = mode
        self._text_id = 0
        self._builders: dict[int, Callable[[], Any]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: self._rc_channels,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._position_target_local_ned,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance_sensor,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
        }
        if gimbal is not None:
            is_px4 = self._is_px4
            self._builders |= {
                mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: lambda: gimbal.information(self._boot_ms),
                mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: lambda: gimbal.status(self._boot_ms),
                mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: lambda: gimbal.attitude(
                    self._boot_ms, is_px4=is_px4
                ),
            }
        self._boot_link(from_s=0.0)

    # What the tests and the simulation see

    @property
    def time_s(self) -> float:
        """Virtual time since construction."""
        return self._flight.time_s

    @property
    def pose(self) -> Pose:
        """Position and attitude of the vehicle."""
        return self._flight.vehicle.pose

    @property
    def gimbal(self) -> Gimbal | None:
        """The gimbal, where there is one."""
        return self._gimbal

    @property
    def camera_pose(self) -> Pose:
        """Position of the vehicle, with the attitude of what carries the camera: the gimbal, or the vehicle itself."""
        if self._gimbal is None:
            return self.pose
        return Pose(self.pose.pos_ned_m, pitch_rad=self._gimbal.pitch_rad, yaw_rad=self._gimbal.yaw_rad)

    @property
    def camera_rates_radps(self) -> tuple[float, float]:
        """Rates of pitch and yaw of what carries the camera; a vehicle's pitch rate is left out."""
        if self._gimbal is None:
            return 0.0, self.yaw_rate_radps
        return self._gimbal.pitch_rate_radps, self._gimbal.yaw_rate_radps

    @property
    def velocity_ned_mps(self) -> Vector:
        """Velocity of the vehicle over ground."""
        return self._flight.vehicle.velocity_ned_mps

    @property
    def yaw_rate_radps(self) -> float:
        """Yaw rate of the vehicle, clockwise from above."""
        return self._flight.vehicle.yaw_rate_radps

    @property
    def mode_name(self) -> str:
        """The mode, as the personality's `MODES` names it."""
        return self._flight.mode

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn."""
        return self._flight.is_armed

    @property
    def is_landed(self) -> bool:
        """Whether the vehicle stands on the ground."""
        return self._flight.vehicle.is_on_ground

    @property
    def setpoint(self) -> Setpoint | None:
        """The last accepted setpoint while it is obeyed; None before, after a time-out, and in every other mode."""
        return self._personality.setpoint

    # The two ends of the link, and time

    def receive(self, data: bytes) -> None:
        """Take bytes from anybody on the link, in any chunks."""
        if self._flight.time_s < self._silent_until_s:
            return
        for message in self._link.parse_buffer(data) or ():
            self._handle(message)
        # pymavlink frees its buffer only when nothing is left in it, which may never happen.
        del self._link.buf[: self._link.buf_index]
        self._link.buf_index = 0

    def step(self, dt_s: float) -> bytes:
        """Advance time and vehicle by `dt_s`; everything that was sent since the last call.

        Raises
        ------
        ValueError
            If `dt_s` is negative or not finite.
        """
        if not 0.0 <= dt_s < math.inf:
            raise ValueError(f"dt_s is {dt_s} s, must be 0 or more")
        count = math.ceil(dt_s / _LONGEST_STEP_S)
        for _ in range(count):
            self._advance(dt_s / count)
        sent = self._port.getvalue()
        self._port.seek(0)
        self._port.truncate()
        return sent

    # The pilot's and the world's side

    def set_sticks(self, roll: float = 0.0, pitch: float = 0.0, throttle: float = 0.0, yaw: float = 0.0) -> None:
        """Move the sticks, each -1..1: right, back (nose up), up and right are positive.

        They are RC channels 1 to 4, at 1500 +- 500 us. A throttle in the middle keeps the height.
        """
        for index, share in enumerate((roll, pitch, throttle, yaw)):
            self.set_rc_channel(index + 1, round(1500 + 500 * share))

    def set_rc_channel(self, channel: int, pulse_us: int) -> None:
        """Set RC channel 1..18. Switches on channels above 4 are shown, not acted on: see `select_mode`."""
        if not 1 <= channel <= len(self._flight.channels_us):
            raise ValueError(f"channel is {channel}, must be 1 to {len(self._flight.channels_us)}")
        self._flight.channels_us[channel - 1] = pulse_us

    def select_mode(self, name: str) -> bool:
        """Select a mode as the pilot's switch or a ground station does; False if it is refused."""
        _check_mode(name, type(self._personality))
        return self._personality.enter(name)

    def lose_rc(self) -> None:
        """Switch the radio control off."""
        if self._flight.rc_lost_s is None:
            self._flight.rc_lost_s = self._flight.time_s

    def regain_rc(self) -> None:
        """Switch the radio control on again."""
        self._flight.rc_lost_s = None

    def lose_gps(self) -> None:
        """Lose the position, for good."""
        if self._flight.gps_lost_s is None:
            self._flight.gps_lost_s = self._flight.time_s

    def battery_failsafe(self) -> None:
        """Let the battery run low: a text, system_status CRITICAL, and the way home, as both are usually configured."""
        self._flight.has_low_battery = True
        self._flight.is_failsafe = True
        self._flight.texts.append((mavlink.MAV_SEVERITY_CRITICAL, "Battery is low"))
        if self._flight.is_armed and not self.is_landed:
            self._personality.enter(self._personality.HOME_MODE)

    def arm(self) -> bool:
        """Arm; False if the autopilot is not ready."""
        if not self._flight.is_armed and self._personality.is_ready:
            self._flight.is_armed = True
            self._personality.home_ne_m = self._flight.vehicle.pos_ned_m[:2]
        return self._flight.is_armed

    def disarm(self) -> None:
        """Disarm whatever happens, as the pilot's kill switch does: in the air, the vehicle falls."""
        self._flight.is_armed = False

    def reboot(self) -> None:
        """Restart the autopilot: 1 s of silence, then time_boot_ms from 0 and the default message intervals.

        In the air the mode, arming and motion are kept and the vehicle holds, as this is for tests of the link; PX4 in
        OFFBOARD then misses its stream as ever. On the ground it disarms and goes through the boot sequence again.
        """
        flight = self._flight
        self._booted_s = flight.time_s + _REBOOT_S
        if self.is_landed:
            flight.is_armed = False
            flight.started_s = self._booted_s
        self._personality.restart()
        self._announced_mode = flight.mode
        self._boot_link(from_s=self._booted_s)

    # Time

    def _boot_link(self, from_s: float) -> None:
        self._silent_until_s = from_s
        self._port = BytesIO()
        self._link = mavlink.MAVLink(self._port, srcSystem=self._system_id, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._link.robust_parsing = True
        intervals_s = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0, **self._personality.INTERVALS_S}
        self._streams = {msg_id: _Stream(interval_s, from_s) for msg_id, interval_s in intervals_s.items()}

    def _advance(self, dt_s: float) -> None:
        flight, personality = self._flight, self._personality
        flight.time_s += dt_s
        command = personality.update()
        wind_ne_mps = self._wind.velocity_ne_mps(flight.time_s)
        flight.vehicle = step(
            flight.vehicle, command if flight.is_armed else None, personality.AIRFRAME, wind_ne_mps, dt_s
        )
        if self._gimbal is not None:
            self._gimbal.step(dt_s, flight.vehicle.yaw_rad)
        if flight.time_s < self._silent_until_s:
            return
        if flight.mode != self._announced_mode:
            self._announced_mode = flight.mode
            heartbeat = self._streams.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)  # None: somebody stopped it
            if heartbeat and personality.HEARTBEAT_AFTER_MODE_S is not None:
                heartbeat.due_s = min(heartbeat.due_s, flight.time_s + personality.HEARTBEAT_AFTER_MODE_S)
        self._send_texts()
        soon_s = flight.time_s + 1e-9  # sums of steps miss round times by rounding
        for msg_id, stream in self._streams.items():
            if stream.due_s <= soon_s:
                # One a step: an interval shorter than a step does not pile up.
                stream.due_s = max(stream.due_s + stream.interval_s, flight.time_s)
                self._send(self._builders[msg_id]())

    # Bytes out

    def _send(self, message: Any) -> None:
        if message is not None:
            self._link.send(message)

    def _send_texts(self) -> None:
        for severity, text in self._flight.texts:
            chunks = [text[at : at + _TEXT_CHUNK] for at in range(0, len(text), _TEXT_CHUNK)]
            # A text that fits has id 0; the chunks of a longer one share another.
            self._text_id = self._text_id % 65535 + 1
            text_id = self._text_id if len(chunks) > 1 else 0
            for index, chunk in enumerate(chunks):
                self._send(mavlink.MAVLink_statustext_message(severity, chunk.encode("ascii"), text_id, index))
        self._flight.texts.clear()

    @property
    def _boot_ms(self) -> int:
        return max(0, round((self._flight.time_s - self._booted_s) * 1000))

    def _heartbeat(self) -> Any:
        flight, personality = self._flight, self._personality
        base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        base_mode |= personality.AUTONOMOUS_BITS.get(flight.mode, mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED)
        if flight.is_armed:
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if flight.is_failsafe:
            status = mavlink.MAV_STATE_CRITICAL
        else:
            status = mavlink.MAV_STATE_ACTIVE if flight.is_armed else mavlink.MAV_STATE_STANDBY
        custom_mode = personality.MODES[flight.mode]
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, personality.AUTOPILOT, base_mode, custom_mode, status, 3
        )

    def _sys_status(self) -> Any:
        flight = self._flight
        gps = mavlink.MAV_SYS_STATUS_SENSOR_GPS
        radio = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        battery = mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        healthy = (
            gps * (flight.gps_lost_s is None)
            | radio * (flight.rc_lost_s is None)
            | battery * (not flight.has_low_battery)
            | prearm * self._personality.is_ready
        )
        every = gps | radio | battery | prearm
        millivolts, percent = (13_600, 12) if flight.has_low_battery else (15_800, 85)
        return mavlink.MAVLink_sys_status_message(
            every, every, healthy, 300, millivolts, 1500, percent, 0, 0, 0, 0, 0, 0
        )

    def _attitude(self) -> Any:
        v = self._flight.vehicle
        rates = (v.roll_rate_radps, v.pitch_rate_radps, v.yaw_rate_radps)
        return mavlink.MAVLink_attitude_message(self._boot_ms, v.roll_rad, v.pitch_rad, v.yaw_rad, *rates)

    def _local_position_ned(self) -> Any:
        v = self._flight.vehicle
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms, *v.pos_ned_m, *v.velocity_ned_mps)

    def _global_position_int(self) -> Any:
        v = self._flight.vehicle
        north_m, east_m, down_m = v.pos_ned_m
        lat_deg = ORIGIN_LAT_DEG + north_m / _METRES_PER_DEG
        lon_deg = ORIGIN_LON_DEG + east_m / (_METRES_PER_DEG * math.cos(math.radians(ORIGIN_LAT_DEG)))
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms,
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            round((ORIGIN_ALT_M - down_m) * 1000),
            round(-down_m * 1000),
            *(round(mps * 100) for mps in v.velocity_ned_mps),
            round(math.degrees(v.yaw_rad) % 360 * 100) % 36000,
        )

    def _rc_channels(self) -> Any:
        if self._flight.rc_lost_s is not None:
            return mavlink.MAVLink_rc_channels_message(self._boot_ms, 0, *([65535] * 18), 255)
        return mavlink.MAVLink_rc_channels_message(self._boot_ms, 16, *self._flight.channels_us, 200)

    def _position_target_local_ned(self) -> Any:
        setpoint = self.setpoint
        velocity_ned_mps = setpoint.velocity_ned_mps if setpoint else (0.0, 0.0, 0.0)
        yaw_rate_radps = (setpoint.yaw_rate_radps or 0.0) if setpoint else 0.0
        return mavlink.MAVLink_position_target_local_ned_message(
            self._boot_ms,
            mavlink.MAV_FRAME_LOCAL_NED,
            _VELOCITY_AND_YAW_RATE,
            *(0.0, 0.0, 0.0),
            *velocity_ned_mps,
            *(0.0, 0.0, 0.0),
            0.0,
            yaw_rate_radps,
        )

    def _distance_sensor(self) -> Any:
        """The height above ground, straight down; nothing beyond its reach."""
        least_m, most_m = _RANGEFINDER_M
        height_m = self._flight.vehicle.height_m
        if height_m > most_m:
            return None
        return mavlink.MAVLink_distance_sensor_message(
            self._boot_ms,
            round(least_m * 100),
            round(most_m * 100),
            round(max(height_m, least_m) * 100),
            mavlink.MAV_DISTANCE_SENSOR_LASER,
            0,
            mavlink.MAV_SENSOR_ROTATION_PITCH_270,
            255,
        )

    def _extended_sys_state(self) -> Any:
        if self.is_landed:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND
        elif self._flight.mode == self._personality.LAND_MODE:
            landed = mavlink.MAV_LANDED_STATE_LANDING
        elif self._personality.climb_goal_m is not None:
            landed = mavlink.MAV_LANDED_STATE_TAKEOFF
        else:
            landed = mavlink.MAV_LANDED_STATE_IN_AIR
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)

    # Bytes in

    def _handle(self, message: Any) -> None:
        match message.get_type():
            case "SET_POSITION_TARGET_LOCAL_NED":
                if self._is_own(message):
                    self._personality.receive_setpoint(message)
            case "COMMAND_LONG":
                names = ("param1", "param2", "param3", "param4", "param5", "param6", "param7")
                self._command(message, tuple(getattr(message, name) for name in names))
            case "COMMAND_INT":
                names = ("param1", "param2", "param3", "param4", "x", "y", "z")
                self._command(message, tuple(getattr(message, name) for name in names))
            case "PARAM_REQUEST_READ":
                if self._is_own(message):
                    self._send_parameter(message)
            case "GIMBAL_MANAGER_SET_PITCHYAW" | "GIMBAL_MANAGER_SET_ATTITUDE":
                if self._gimbal is not None and self._is_own(message):
                    self._gimbal.receive(message, is_px4=self._is_px4)
            case "REQUEST_DATA_STREAM":
                if self._is_own(message):
                    self._request_data_stream(message)
            case "TIMESYNC" if message.tc1 == 0:
                now_ns = round((self._flight.time_s - self._booted_s) * 1e9)
                self._send(mavlink.MAVLink_timesync_message(now_ns, message.ts1))
            case _:
                pass

    @property
    def _is_px4(self) -> bool:
        return bool(self._personality.AUTOPILOT == mavlink.MAV_AUTOPILOT_PX4)

    def _is_own(self, message: Any) -> bool:
        return message.target_system in {0, self._system_id}

    def _command(self, message: Any, params: tuple[float, ...]) -> None:
        # A command to another component, such as a camera, is that one's to answer.
        if not self._is_own(message) or message.target_component not in {0, mavlink.MAV_COMP_ID_AUTOPILOT1}:
            return
        sender = (message.get_srcSystem(), message.get_srcComponent())
        for result in self._results(message.command, params, sender):
            self._send(
                mavlink.MAVLink_command_ack_message(
                    message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
                )
            )
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and (builder := self._builders.get(whole(params[0]))):
            self._send(builder())

    def _results(self, command: int, params: tuple[float, ...], sender: tuple[int, int]) -> tuple[int, ...]:
        """Obey a command; the MAV_RESULT of every acknowledgement."""
        personality = self._personality
        match command:
            case mavlink.MAV_CMD_DO_SET_MODE:
                return personality.mode_results(params)
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                return (self._arm_result(params),)
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                return (personality.take_off_result(params[6]),)
            case mavlink.MAV_CMD_NAV_LAND:
                return (ACCEPTED if personality.enter(personality.LAND_MODE) else personality.REFUSAL,)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return (self._set_message_interval(whole(params[0]), params[1]),)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return (ACCEPTED if whole(params[0]) in self._builders else DENIED,)
            case mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE if self._gimbal is not None:
                return (self._gimbal.configure(params, sender),)
            case _:
                return (UNSUPPORTED,)

    def _arm_result(self, params: tuple[float, ...]) -> int:
        if whole(params[0]) == 1:
            return ACCEPTED if self.arm() else self._personality.REFUSAL
        is_forced = whole(params[1]) == 21196
        if not self.is_landed and not is_forced:
            return self._personality.REFUSAL
        self.disarm()
        return ACCEPTED

    def _set_message_interval(self, msg_id: int, interval_us: float) -> int:
        if msg_id not in self._builders or not math.isfinite(interval_us):
            return DENIED
        if interval_us < 0:
            self._streams.pop(msg_id, None)
            return ACCEPTED
        default_s = 1.0 if msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT else self._personality.INTERVALS_S.get(msg_id)
        if interval_us > 0:
            self._streams[msg_id] = _Stream(interval_us * 1e-6, self._flight.time_s)
        elif default_s is None:
            self._streams.pop(msg_id, None)
        else:
            self._streams[msg_id] = _Stream(default_s, self._flight.time_s)
        return ACCEPTED

    def _request_data_stream(self, message: Any) -> None:
        """The older way to ask, which ArduPilot still knows: a rate for a group of messages, without an answer."""
        if self._personality.AUTOPILOT != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            return
        groups = {
            mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (mavlink.MAVLINK_MSG_ID_SYS_STATUS,),
            mavlink.MAV_DATA_STREAM_RC_CHANNELS: (mavlink.MAVLINK_MSG_ID_RC_CHANNELS,),
            mavlink.MAV_DATA_STREAM_POSITION: (
                mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
                mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
            ),
            mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
            mavlink.MAV_DATA_STREAM_EXTRA3: (mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,),
        }
        every = tuple(msg_id for group in groups.values() for msg_id in group)
        is_on = message.start_stop == 1 and message.req_message_rate > 0
        interval_us = 1e6 / message.req_message_rate if is_on else -1.0
        is_all = message.req_stream_id == mavlink.MAV_DATA_STREAM_ALL
        for msg_id in every if is_all else groups.get(message.req_stream_id, ()):
            self._set_message_interval(msg_id, interval_us)

    def _send_parameter(self, message: Any) -> None:
        """Answer PARAM_REQUEST_READ; silence for a parameter that is not there, as both do."""
        names = [*self._personality.PARAMETERS]
        index = message.param_index
        name = names[index] if 0 <= index < len(names) else message.param_id
        if name not in names:
            return
        value = self._flight.parameters[name]
        kind = self._personality.PARAMETERS[name].type
        if self._personality.SENDS_PARAMETERS_BYTEWISE and kind == mavlink.MAV_PARAM_TYPE_INT32:
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        self._send(
            mavlink.MAVLink_param_value_message(name.encode("ascii"), value, kind, len(names), names.index(name))
        )


def _check_mode(name: str, personality: type[Personality]) -> None:
    if name not in personality.MODES:
        raise ValueError(f"{personality.__name__} has no mode {name!r}; it has {[*personality.MODES]}")
