"""What the autopilot says, as events; setpoints, requests and texts, as messages. Sans-I/O: no port, no clock.

One codec is one component (191, the onboard computer) on one vehicle: that of the first autopilot whose heartbeat
arrives, unless the configuration names another. Everything else on the link is not for it.
"""

import math
import struct
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from companion.flight_modes import flight_mode, request_numbers
from companion.safety import SafeSetpoint
from companion.time_sync import BootClock
from companion.types import (
    Attitude,
    Autopilot,
    AutopilotText,
    Battery,
    Direction,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LandingTarget,
    LinkEvent,
    LocalState,
    ModeAnswer,
    Parameter,
    RangeReading,
    RcChannels,
    Rebooted,
    SetpointInForce,
    Text,
    Vector,
)
from companion.wire import Wire

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

# velocity and yaw rate count, positions, accelerations and yaw do not; the force bit stays clear
VELOCITY_AND_YAW_RATE = 1479
TEXT_LENGTH = 50  # of one STATUSTEXT
AUTOPILOT_COMPONENT = 1
MAX_PLACE_M = 1e6  # from the local origin
MAX_SPEED_MPS = 200.0
_FLOAT = struct.Struct("<f")
_MOST_ANSWERS = 4  # to TIMESYNC, a read: a flood of questions must not push the setpoint out of the port

_AUTOPILOTS = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: Autopilot.ARDUPILOT,
    mavlink.MAV_AUTOPILOT_PX4: Autopilot.PX4,
}
_MULTICOPTERS = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
    }
)
_LANDED = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    mavlink.MAV_LANDED_STATE_TAKEOFF: Landed.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    mavlink.MAV_LANDED_STATE_LANDING: Landed.LANDING,
}
_FRAMES = {"local_ned": mavlink.MAV_FRAME_LOCAL_NED, "body_ned": mavlink.MAV_FRAME_BODY_NED}
_DIRECTIONS = {
    mavlink.MAV_SENSOR_ROTATION_NONE: Direction.FORWARD,
    mavlink.MAV_SENSOR_ROTATION_PITCH_270: Direction.DOWN,
}
ATTITUDE_HZ = 50.0
# Hz of what we ask of both
_RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: ATTITUDE_HZ,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}


def rates_hz(autopilot: Autopilot) -> dict[int, float]:
    """Hz of what we ask for, by message; PX4 tells by its flight mode that it does not hear us."""
    more = {mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 2.0} if autopilot is Autopilot.ARDUPILOT else {}
    return _RATES_HZ | more


class MavlinkCodec:
    """Messages in, events out; setpoints, requests and texts go out over the wire.

    Parameters
    ----------
    system_id : of the vehicle; 0: that of the first autopilot heard.
    component_id : ours.
    setpoint_frame : local_ned, or body_ned, which both autopilots rotate by the yaw.
    """

    def __init__(
        self, wire: Wire, system_id: int = 0, component_id: int = 191, setpoint_frame: str = "local_ned"
    ) -> None:
        self._wanted_id = system_id
        self._wire = wire
        self._mav = wire.sender(component_id)
        self._frame = _FRAMES[setpoint_frame]
        self._is_body = setpoint_frame == "body_ned"
        self._clock = BootClock()
        self._autopilot: tuple[int, int, Autopilot] | None = None  # system, component, kind
        self._yaw_rad: float | None = None
        self._text_id = 0
        self._answers = 0  # to TIMESYNC, in this read
        self._readers: dict[str, Callable[[Any, float], list[LinkEvent]]] = {
            "ATTITUDE": self._attitude,
            "LOCAL_POSITION_NED": self._local,
            "GLOBAL_POSITION_INT": _global,
            "EXTENDED_SYS_STATE": _landed,
            "DISTANCE_SENSOR": _range,
            "RC_CHANNELS": _rc,
            "SYS_STATUS": _battery,
            "POSITION_TARGET_LOCAL_NED": _in_force,
            "PARAM_VALUE": self._parameter,
            "COMMAND_ACK": self._ack,
            "STATUSTEXT": _text,
        }

    @property
    def autopilot(self) -> Autopilot | None:
        """Kind of the autopilot, once it has been heard."""
        return self._autopilot[2] if self._autopilot is not None else None

    @property
    def clock(self) -> BootClock:
        """What turns the autopilot's time into ours."""
        return self._clock

    # ---------------------------------------------------------------------------------- messages -> events
    def receive(self, messages: "Iterable[Any]", now_s: float) -> list[LinkEvent]:
        """Events in messages that have arrived; never raises, whatever is in them."""
        events: list[LinkEvent] = []
        self._answers = 0
        for message in messages:
            kind = message.get_type()
            if kind == "HEARTBEAT":
                events += self._heartbeat(message, now_s)
                continue
            if kind == "TIMESYNC":
                self._time_sync(message, now_s)
                continue
            sender = (message.get_srcSystem(), message.get_srcComponent())
            if self._autopilot is None or sender != self._autopilot[:2] or kind not in self._readers:
                continue
            boot_ms = getattr(message, "time_boot_ms", None)
            if boot_ms is not None:
                if self._clock.has_gone_back(boot_ms / 1000):
                    self._clock.reset()
                    events.append(Rebooted(now_s))
                time_s = self._clock.ours_s(boot_ms / 1000, now_s)
            else:
                time_s = now_s
            events += self._readers[kind](message, time_s)
        return events

    def _heartbeat(self, message: Any, now_s: float) -> list[LinkEvent]:
        """A heartbeat of the vehicle; the first one latches it. Ground stations and cameras say autopilot 8."""
        kind = _AUTOPILOTS.get(message.autopilot)
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if kind is None or (self._wanted_id and sender[0] != self._wanted_id):
            return []
        if self._autopilot is None:
            self._autopilot = (*sender, kind)
            self._wire.system_id = sender[0]
        if self._autopilot[:2] != sender:
            return []
        mode, name = flight_mode(kind, message.custom_mode)
        is_bad = message.system_status in {mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY}
        is_armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        return [Heartbeat(now_s, kind, message.type in _MULTICOPTERS, mode, name, is_armed, is_bad)]

    def _time_sync(self, message: Any, now_s: float) -> None:
        """Tell whoever asks our time, in ns; take the autopilot's."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if message.tc1 == 0:
            if self._answers < _MOST_ANSWERS:
                self._answers += 1
                self._mav.timesync_send(round(now_s * 1e9), message.ts1)
        elif self._autopilot is not None and sender == self._autopilot[:2]:
            self._clock.hear(message.tc1, message.ts1, now_s)

    def _attitude(self, message: Any, time_s: float) -> list[LinkEvent]:
        angles = message.roll, message.pitch, message.yaw, message.yawspeed
        if not all(map(math.isfinite, angles)):
            return []
        self._yaw_rad = message.yaw
        return [Attitude(time_s, *angles)]

    def _local(self, message: Any, time_s: float) -> list[LinkEvent]:
        place, speed = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
        # what is farther or faster is an error, and may overflow what is computed from it; no NaN is below either
        is_sane = all(abs(x) < MAX_PLACE_M for x in place) and all(abs(v) < MAX_SPEED_MPS for v in speed)
        return [LocalState(time_s, place, speed)] if is_sane else []

    def _parameter(self, message: Any, time_s: float) -> list[LinkEvent]:
        """PX4 carries whole numbers byte by byte in the float, ArduPilot converts them."""
        value = message.param_value
        if self.autopilot is Autopilot.PX4 and message.param_type != mavlink.MAV_PARAM_TYPE_REAL32:
            value = _integer_in(value)
        return [Parameter(message.param_id, float(value))] if math.isfinite(value) else []

    def _ack(self, message: Any, time_s: float) -> list[LinkEvent]:
        target = (message.target_system, message.target_component)
        is_ours = target in {(0, 0), (self._mav.srcSystem, self._mav.srcComponent)}  # old autopilots name nobody
        if message.command != mavlink.MAV_CMD_DO_SET_MODE or not is_ours:
            return []
        return [ModeAnswer(message.result == mavlink.MAV_RESULT_ACCEPTED)]

    # ---------------------------------------------------------------------------------- to the wire
    def send_setpoint(self, setpoint: SafeSetpoint, now_s: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED with velocity and yaw rate, the other fields 0.

        Nothing is sent before an autopilot was heard, nor in body_ned before its attitude is known.
        """
        if self._autopilot is None or (self._is_body and self._yaw_rad is None):
            return
        north, east, down = setpoint.velocity_ned_mps
        if self._is_body and self._yaw_rad is not None:
            c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
            north, east = c * north + s * east, c * east - s * north
        self._mav.set_position_target_local_ned_send(
            int(now_s * 1000) & 0xFFFFFFFF,
            self._autopilot[0],
            AUTOPILOT_COMPONENT,
            self._frame,
            VELOCITY_AND_YAW_RATE,
            *(0.0, 0.0, 0.0),
            *(north, east, down),
            *(0.0, 0.0, 0.0),
            0.0,
            setpoint.yaw_rate_radps,
        )

    def send_heartbeat(self, *, is_active: bool, is_healthy: bool) -> None:
        """Ours: an onboard computer on standby, active, or in trouble."""
        status = mavlink.MAV_STATE_ACTIVE if is_active else mavlink.MAV_STATE_STANDBY
        if not is_healthy:
            status = mavlink.MAV_STATE_CRITICAL
        self._mav.heartbeat_send(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, status)

    def send_mode_request(self, mode: FlightMode) -> None:
        """Ask for a flight mode other than the one in which we are obeyed."""
        if self._autopilot is not None:
            second, third = request_numbers(self._autopilot[2], mode)
            self._command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, second, third)

    def send_rate_requests(self) -> None:
        """Ask for the telemetry that steering needs."""
        if self._autopilot is not None:
            for number, rate_hz in rates_hz(self._autopilot[2]).items():
                self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def send_stream_request(self) -> None:
        """The old way to ask, for ArduPilot versions that do not know the new one: all streams at 20 Hz."""
        if self._autopilot is not None:
            self._mav.request_data_stream_send(
                self._autopilot[0], self._autopilot[1], mavlink.MAV_DATA_STREAM_ALL, 20, 1
            )

    def send_parameter_request(self, name: str) -> None:
        """Ask for one parameter."""
        if self._autopilot is not None:
            self._mav.param_request_read_send(self._autopilot[0], self._autopilot[1], name.encode(), -1)

    def send_time_request(self, now_s: float) -> None:
        """TIMESYNC: ask the autopilot for its time, about once a second."""
        if self._autopilot is not None:
            self._mav.timesync_send(0, self._clock.ask(now_s))

    def send_landing_target(self, target: LandingTarget) -> None:
        """LANDING_TARGET in the form that the autopilot reads; what it cannot read is not sent.

        ArduPilot (AC_PrecLand_Companion) takes a position in MAV_FRAME_BODY_FRD whose distance is above 0, or else the
        two angles, and corrects the jitter of any clock in `time_usec`. PX4 (MavlinkReceiver) takes a position in
        MAV_FRAME_LOCAL_NED; it would read angles as those of an IR-LOCK in its own mount, so it gets none.
        """
        if self._autopilot is None:
            return
        if self.autopilot is Autopilot.PX4:
            frame, place = mavlink.MAV_FRAME_LOCAL_NED, target.place_ned_m
            if place is None:
                return
        else:
            frame, distance_m = mavlink.MAV_FRAME_BODY_FRD, target.distance_m
            place = None if distance_m is None else _scaled(target.ray_frd, distance_m)
        forward, right, down = target.ray_frd
        self._mav.landing_target_send(
            max(round(target.time_s * 1e6), 0),
            0,
            frame,
            math.atan2(right, down),
            math.atan2(-forward, down),
            target.distance_m or 0.0,
            *target.size_rad,
            *(place or (0.0, 0.0, 0.0)),
            (0.0, 0.0, 0.0, 0.0),
            mavlink.LANDING_TARGET_TYPE_VISION_OTHER,
            int(place is not None),
        )

    def send_text(self, text: Text) -> None:
        """STATUSTEXT, in chunks of 50 characters where it is longer; the last one is known by not being full."""
        data = text.text.encode("ascii", "replace")
        is_long = len(data) > TEXT_LENGTH
        chunks = [data[k : k + TEXT_LENGTH] for k in range(0, len(data) + 1, TEXT_LENGTH)] if is_long else [data]
        self._text_id = self._text_id % 0xFFFF + 1 if len(chunks) > 1 else self._text_id
        for number, chunk in enumerate(chunks):
            identity = self._text_id if len(chunks) > 1 else 0
            self._mav.statustext_send(int(text.severity), chunk, identity, number)

    def _command(self, command: int, *parameters: float) -> None:
        assert self._autopilot is not None
        padded = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        self._mav.command_long_send(self._autopilot[0], self._autopilot[1], command, 0, *padded)


def _integer_in(value: float) -> int:
    """Whole number whose bytes are those of a float32."""
    return int.from_bytes(_FLOAT.pack(value), "little", signed=True)


def _scaled(vector: Vector, by: float) -> Vector:
    return vector[0] * by, vector[1] * by, vector[2] * by


def _global(message: Any, time_s: float) -> list[LinkEvent]:
    height = HeightReading(time_s, message.relative_alt / 1000)
    if not (message.lat or message.lon):  # not known yet: nobody flies there
        return [height]
    return [height, GlobalPosition(time_s, message.lat / 1e7, message.lon / 1e7, message.alt / 1000)]


def _landed(message: Any, time_s: float) -> list[LinkEvent]:
    return [LandedReading(time_s, _LANDED.get(message.landed_state, Landed.UNKNOWN))]


def _range(message: Any, time_s: float) -> list[LinkEvent]:
    direction = _DIRECTIONS.get(message.orientation)
    is_valid = message.min_distance < message.current_distance < message.max_distance
    return [RangeReading(time_s, direction, message.current_distance / 100)] if direction and is_valid else []


def _rc(message: Any, time_s: float) -> list[LinkEvent]:
    count = min(message.chancount, 18)
    values = [getattr(message, f"chan{k}_raw") for k in range(1, count + 1)]
    return [RcChannels(time_s, tuple(0 if value == 0xFFFF else value for value in values))]


def _battery(message: Any, _time_s: float) -> list[LinkEvent]:
    remaining_pct = message.battery_remaining
    return [Battery(remaining_pct)] if 0 <= remaining_pct <= 100 else []  # -1: not known


def _in_force(message: Any, time_s: float) -> list[LinkEvent]:
    velocity = message.vx, message.vy, message.vz
    return [SetpointInForce(time_s, velocity)] if all(map(math.isfinite, velocity)) else []


def _text(message: Any, _time_s: float) -> list[LinkEvent]:
    return [AutopilotText(message.severity, message.text)]
