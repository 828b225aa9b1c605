"""The camera that a ground station sees: MAVLink's camera protocol v2, with tracking. Sans-I/O: no port, no clock.

It says what camera and stream there are, takes what the operator clicks or draws on the video, and says how the
tracking goes. A track command is ACCEPTED when the tracker has begun on a frame, FAILED when it refuses or does not
come to it within a second; what has failed is taken back. STOP_TRACKING is obeyed whoever sends it, as disengaging is:
it can only make the vehicle stand. Zoom, modes, photos and recording are not claimed, and are UNSUPPORTED.

Sources: "Camera Protocol v2" of the MAVLink developer guide and the message definitions; of what QGroundControl makes
of it, its `VehicleCameraControl` and `VideoManager`.
"""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.camera_model import CameraModel, product, quaternion
from companion.command_protocol import Command, CommandProtocol, Result
from companion.config import Config, stream_scheme
from companion.controller import MAX_FRAME_AGE_S, NOTHING_SELECTED, ControlOutput
from companion.geo_place import HEADING_SIGMA_RAD, MAX_PLACE_AGE_S, GeoPlace, geo_place
from companion.target import PLACE_TAU_S, TargetEstimate
from companion.types import Deselect, OperatorCommand, Select, Selection, TrackSample
from companion.vehicle_state import VehicleState
from mscf import Box, TrackStatus
from mscf.frame import MIN_BOX_PX

VENDOR, MODEL = "mscf-companion", "MSCF tracker"
ANSWER_S = 1.0  # for the tracker to begin
POINT_RADIUS = 0.02  # over the frame's width, where none is given: QGroundControl's 20 px of a display of 1000
MIN_INTERVAL_S, MAX_INTERVAL_S = 0.05, 60.0  # between two messages of a stream; nothing is newer than the loop's period
IMAGE_STATUS = mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS
GEO_STATUS = mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_GEO_STATUS
DEFAULT_INTERVALS_S = {IMAGE_STATUS: 0.2, GEO_STATUS: 0.5}
IDLE = mavlink.CAMERA_TRACKING_STATUS_FLAGS_IDLE
ACTIVE = mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE
ERROR = mavlink.CAMERA_TRACKING_STATUS_FLAGS_ERROR
COASTING = ACTIVE | mavlink.CAMERA_TRACKING_STATUS_FLAGS_COASTING

_INT32_MAX = 0x7FFFFFFF  # "not given" of COMMAND_INT and "not known" of positions
_UNKNOWN = math.nan
_FIRST = 1  # number of the only stream
_NAME_BYTES = 32
_TRACKS = frozenset({mavlink.MAV_CMD_CAMERA_TRACK_POINT, mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE})
_OLD_REQUESTS: dict[int, int] = {
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_SETTINGS: mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION: mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
_OF_STREAMS = frozenset({mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS})
_STREAM_TYPES = {
    "rtsp": mavlink.VIDEO_STREAM_TYPE_RTSP,
    "udp": mavlink.VIDEO_STREAM_TYPE_RTPUDP,
    "tcp": mavlink.VIDEO_STREAM_TYPE_TCP_MPEG,
    "mpegts": mavlink.VIDEO_STREAM_TYPE_MPEG_TS,
}
_ENCODINGS = {"h264": mavlink.VIDEO_STREAM_ENCODING_H264, "h265": mavlink.VIDEO_STREAM_ENCODING_H265}


@dataclass(frozen=True, slots=True)
class _Shown:
    """What CAMERA_TRACKING_IMAGE_STATUS says; `box` in px, None where no place is known."""

    status: int = IDLE
    mode: int = mavlink.CAMERA_TRACKING_MODE_NONE
    box: Box | None = None


@dataclass(frozen=True, slots=True)
class _Pending:
    """A track command that is not answered yet; its selection's number once the controller has given it one."""

    command: Command
    box: Box
    number: int | None
    since_s: float


@dataclass(slots=True)
class _Stream:
    interval_s: float | None = None  # None: not asked for
    due_s: float = -math.inf


class CameraProtocol:
    """Our camera component.

    In every step `receive` comes before the controller, `after` after it.

    Parameters
    ----------
    sender : of the component, `Wire.sender`.
    version : of this software, as "1.2.3".
    """

    def __init__(self, sender: Any, config: Config, version: str) -> None:
        self._mav = sender
        self._protocol = CommandProtocol(sender, _TRACKS | {mavlink.MAV_CMD_CAMERA_STOP_TRACKING})
        self._config = config
        self._firmware = firmware_number(version)
        self._pending: _Pending | None = None
        self._streams = {number: _Stream() for number in DEFAULT_INTERVALS_S}
        self._size_hw: tuple[int, int] | None = None  # of the newest frame
        self._selection: Selection = NOTHING_SELECTED
        self._measured_s = -math.inf  # capture of the newest frame in which this selection was seen
        self._shown = _Shown()
        self._shown_s = -math.inf  # since when the status is this one
        self._vehicle = VehicleState()
        self._target: TargetEstimate | None = None
        self._messages: dict[int, Callable[[float], None]] = {
            mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._send_information,
            mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: self._send_settings,
            mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION: self._send_storage,
            mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: self._send_capture_status,
            mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS: self._send_fov_status,
            IMAGE_STATUS: self._send_image_status,
            GEO_STATUS: self._send_geo_status,
        }
        if config.ground.stream_uri:
            self._messages[mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION] = self._send_stream_information
            self._messages[mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS] = self._send_stream_status

    # ------------------------------------------------------------------------------- before the controller
    def receive(self, messages: Iterable[Any], track: TrackSample | None, now_s: float) -> tuple[OperatorCommand, ...]:
        """Orders in messages that have arrived, to be obeyed before those of others; requests are answered at once.

        Parameters
        ----------
        track : the newest sample there is: its frame is what the operator looks at.
        """
        if track is not None:
            self._size_hw = track.size_hw
        orders = [*self._settled(track, now_s)]
        for message in messages:
            command = self._protocol.take(message, now_s)
            if command is None:
                continue
            if command.number in _TRACKS:
                orders += self._track(command, now_s)
            elif command.number == mavlink.MAV_CMD_CAMERA_STOP_TRACKING:
                orders += self._stop(command)
            elif command.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._set_interval(command, now_s)
            elif command.number == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                self._protocol.answer(command, Result.ACCEPTED)
                self._send_interval(command.whole(0))
            else:
                self._request(command, now_s)
        return tuple(orders)

    def _settled(self, track: TrackSample | None, now_s: float) -> tuple[OperatorCommand, ...]:
        """Answer the track command that waits for the tracker; one that has failed leaves nothing selected."""
        pending = self._pending
        if pending is None or pending.number is None:
            return ()
        sample = track if track is not None and track.selection == pending.number else None
        if sample is not None and sample.status is not None and not sample.fault:
            self._end(Result.ACCEPTED)
            return ()
        if (sample is not None and sample.fault) or now_s - pending.since_s > ANSWER_S:
            self._end(Result.FAILED)
            return (Deselect(),)
        return ()

    def _end(self, result: Result) -> None:
        if self._pending is not None:
            self._protocol.answer(self._pending.command, result)
            self._pending = None

    def _track(self, command: Command, now_s: float) -> tuple[OperatorCommand, ...]:
        selected = self._asked_for(command)
        if isinstance(selected, Result):
            self._protocol.answer(command, selected)
            return ()
        assert selected.box is not None  # of a track command
        self._end(Result.FAILED)  # the newer one counts
        self._pending = _Pending(command, selected.box, None, now_s)
        return (selected,)

    def _asked_for(self, command: Command) -> Select | Result:
        """What a track command selects, or why it does not."""
        is_point = command.number == mavlink.MAV_CMD_CAMERA_TRACK_POINT
        places, camera = (
            (command.params[:2], command.params[3]) if is_point else (command.params[:4], command.params[4])
        )
        if command.sender[0] not in self._config.ground.system_ids or not self._is_this(camera):
            return Result.DENIED
        if not all(0 <= value <= 1 for value in places):  # nor where one is not a number
            return Result.DENIED
        radius = command.params[2] if is_point else 0.0
        if not (0 <= radius <= 1 or math.isnan(radius)):
            return Result.DENIED
        if self._size_hw is None:
            return Result.TEMPORARILY_REJECTED
        height, width = self._size_hw
        if is_point:
            side = max(2 * width * (POINT_RADIUS if math.isnan(radius) or radius == 0 else radius), MIN_BOX_PX)
            u, v = places[0] * width, places[1] * height
            return Select(Box(u - side / 2, v - side / 2, side, side), is_point=True)
        left, top, right, bottom = places
        box = Box(left * width, top * height, (right - left) * width, (bottom - top) * height)
        return Select(box) if min(box.w, box.h) >= MIN_BOX_PX else Result.DENIED

    def _stop(self, command: Command) -> tuple[OperatorCommand, ...]:
        if not self._is_this(command.params[0]):
            self._protocol.answer(command, Result.DENIED)
            return ()
        self._end(Result.FAILED)
        self._protocol.answer(command, Result.ACCEPTED)
        return (Deselect(),)

    def _is_this(self, camera: float) -> bool:
        return math.isnan(camera) or camera in {0, _INT32_MAX, self._mav.srcComponent}

    def _set_interval(self, command: Command, now_s: float) -> None:
        """-1 stops a stream, 0 is its usual rate."""
        number, interval_us = command.whole(0), command.params[1]
        if number not in DEFAULT_INTERVALS_S:
            self._protocol.answer(command, Result.UNSUPPORTED)
        elif interval_us == -1:
            self._streams[number] = _Stream()
            self._protocol.answer(command, Result.ACCEPTED)
        elif not 0 <= interval_us < math.inf:
            self._protocol.answer(command, Result.DENIED)
        else:
            interval_s = interval_us / 1e6 or DEFAULT_INTERVALS_S[number]
            self._streams[number] = _Stream(min(max(interval_s, MIN_INTERVAL_S), MAX_INTERVAL_S), now_s)
            self._protocol.answer(command, Result.ACCEPTED)

    def _request(self, command: Command, now_s: float) -> None:
        """Requests for one message, of the new kind and of the old; whatever else is asked is unknown here."""
        if command.number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            number, index = command.whole(0), command.params[1]
        else:
            number, index = _OLD_REQUESTS.get(command.number), command.params[0]
        if number == mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            self._protocol.answer(command, Result.ACCEPTED)
            self._send_interval(command.whole(1))
        elif number not in self._messages:
            self._protocol.answer(command, Result.UNSUPPORTED)
        elif number in _OF_STREAMS and not (index in {0, _FIRST} or math.isnan(index)):
            self._protocol.answer(command, Result.DENIED)
        elif number == GEO_STATUS and self._geo_place(now_s) is None:
            self._protocol.answer(command, Result.TEMPORARILY_REJECTED)
        else:
            self._protocol.answer(command, Result.ACCEPTED)
            self._messages[number](now_s)

    # ------------------------------------------------------------------------------- after the controller
    def after(self, control: ControlOutput, vehicle: VehicleState, track: TrackSample | None, now_s: float) -> None:
        """Take in what has come of the step, tell every change at once, and what was asked for when it is due."""
        self._vehicle, self._target = vehicle, control.target
        self._follow_pending(control.selection)
        if control.selection.number != self._selection.number:
            self._measured_s = -math.inf
            if self._pending is None or self._pending.number != control.selection.number:
                self._protocol.forget(_TRACKS)  # somebody else's choice: the same box again is no retry
        self._selection = control.selection
        shown, before = self._seen(track, now_s), self._shown
        self._shown = shown
        is_change = shown.status != before.status  # another selection is idle until the tracker has begun
        if is_change:
            self._shown_s = now_s
            self._send_image_status(now_s)
        for number, stream in self._streams.items():
            if stream.interval_s is None or now_s < stream.due_s - 1e-6:
                continue
            # one a step: an interval shorter than a step does not pile up
            stream.due_s = max(stream.due_s + stream.interval_s, now_s)
            if not (is_change and number == IMAGE_STATUS):
                self._messages[number](now_s)

    def _follow_pending(self, selection: Selection) -> None:
        """Learn the number of what was asked for in this step; what somebody else has replaced has failed."""
        pending = self._pending
        if pending is None:
            return
        if pending.number is None and selection.number != self._selection.number and selection.box == pending.box:
            self._pending = replace(pending, number=selection.number)
        elif pending.number != selection.number:
            self._end(Result.FAILED)

    def _seen(self, track: TrackSample | None, now_s: float) -> _Shown:
        selection = self._selection
        if selection.box is None or track is None or track.selection != selection.number:
            return _Shown()
        if track.status is None and not track.fault:
            return _Shown()
        modes = (mavlink.CAMERA_TRACKING_MODE_RECTANGLE, mavlink.CAMERA_TRACKING_MODE_POINT)
        mode = modes[selection.is_point]
        if track.is_measured:
            self._measured_s = max(track.captured_s, self._measured_s)
        is_old = now_s - track.captured_s > MAX_FRAME_AGE_S
        is_coasting = track.status in {TrackStatus.TRACKING, TrackStatus.UNSURE}
        if track.is_measured and not track.fault and not is_old:
            return _Shown(ACTIVE, mode, track.box)
        if is_coasting and not track.fault and now_s - self._measured_s <= self._config.loss.hold_after_s:
            status = ACTIVE if self._config.ground.plain_status else COASTING
            return _Shown(status, mode, track.box)
        return _Shown(ERROR, mode)

    def _geo_place(self, now_s: float) -> GeoPlace | None:
        """The target's place, while it is measured and its pose is known."""
        target, latency_s = self._target, self._config.camera.latency_ms / 1000
        is_measured = self._shown.status == ACTIVE and now_s - self._measured_s <= MAX_FRAME_AGE_S
        if target is None or not is_measured or now_s - target.seen.time_s > MAX_FRAME_AGE_S + latency_s:
            return None
        place = geo_place(target, self._vehicle, now_s)
        # a filter that has just begun stands still
        is_settled = now_s - self._shown_s >= 2 * PLACE_TAU_S
        return place if place is None or is_settled else replace(place, velocity_ne_mps=None)

    # ------------------------------------------------------------------------------- messages
    def send_heartbeat(self, *, is_healthy: bool) -> None:
        """A camera on standby, active while it tracks, or in trouble."""
        status = mavlink.MAV_STATE_ACTIVE if self._shown.status & ACTIVE else mavlink.MAV_STATE_STANDBY
        if not is_healthy:
            status = mavlink.MAV_STATE_CRITICAL
        self._mav.heartbeat_send(mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, status)

    def _flags(self) -> int:
        """Capabilities that are true."""
        flags: int = mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
        if self._config.ground.stream_uri:
            flags |= mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
        if self._vehicle.place is not None and self._vehicle.local is not None:
            flags |= mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_GEO_STATUS
        return flags

    def _send_information(self, now_s: float) -> None:
        height, width = self._size_hw or (0, 0)  # 0: not known
        gimbal = self._config.gimbal
        self._mav.camera_information_send(
            _boot_ms(now_s),
            list(VENDOR.encode().ljust(_NAME_BYTES, b"\0")),
            list(MODEL.encode().ljust(_NAME_BYTES, b"\0")),
            self._firmware,
            *(_UNKNOWN, _UNKNOWN, _UNKNOWN),  # focal length and sensor, mm: in pixels only are they known
            *(width, height),
            0,
            self._flags(),
            0,
            b"",
            gimbal.device_id if gimbal.axes != "none" else 0,
        )

    def _send_settings(self, now_s: float) -> None:
        self._mav.camera_settings_send(_boot_ms(now_s), mavlink.CAMERA_MODE_VIDEO, _UNKNOWN, _UNKNOWN)

    def _send_storage(self, now_s: float) -> None:
        """There is none for a ground station to see."""
        self._mav.storage_information_send(
            _boot_ms(now_s), 0, 0, mavlink.STORAGE_STATUS_NOT_SUPPORTED, *(0.0, 0.0, 0.0), *(0.0, 0.0)
        )

    def _send_capture_status(self, now_s: float) -> None:
        self._mav.camera_capture_status_send(_boot_ms(now_s), 0, 0, 0.0, 0, 0.0, 0)

    def _send_stream_information(self, now_s: float) -> None:
        ground = self._config.ground
        self._mav.video_stream_information_send(
            _FIRST,
            1,
            _STREAM_TYPES[stream_scheme(ground.stream_uri)],
            *self._stream_facts(),
            b"tracked camera",
            stream_address(ground.stream_uri).encode(),
            _ENCODINGS[ground.stream_encoding],
        )

    def _send_stream_status(self, now_s: float) -> None:
        self._mav.video_stream_status_send(_FIRST, *self._stream_facts())

    def _stream_facts(self) -> tuple[int, float, int, int, int, int, int]:
        """Flags, frames a second, width, height, bit rate, rotation and degrees across: those of the tracked frames.

        A ground station takes the picture's shape from them, and clicks by it: before the first frame, the size that
        the camera is asked for.
        """
        camera = self._config.camera
        height, width = self._size_hw or (camera.height_px, camera.width_px)
        across_deg, _ = CameraModel.of(self._config, (height, width)).fov_deg
        running = mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING
        return running, camera.frames_per_s, width, height, 0, 0, round(across_deg)

    def _send_fov_status(self, now_s: float) -> None:
        place, attitude, camera = self._vehicle.place, self._vehicle.fresh_attitude(now_s), self._config.camera
        here = (_INT32_MAX, _INT32_MAX, _INT32_MAX)
        if place is not None and now_s - place.time_s <= MAX_PLACE_AGE_S:
            here = (round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), round(place.amsl_m * 1000))
        q = (_UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN)
        if attitude is not None and self._config.gimbal.axes == "none":
            mount_deg = (camera.mount_roll_deg, camera.mount_pitch_deg, camera.mount_yaw_deg)
            body = quaternion(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
            q = product(body, quaternion(*map(math.radians, mount_deg)))
        fov_deg = (_UNKNOWN, _UNKNOWN)
        if self._size_hw is not None:
            fov_deg = CameraModel.of(self._config, self._size_hw).fov_deg
        nowhere = (_INT32_MAX, _INT32_MAX, _INT32_MAX)  # what the middle of the picture shows
        self._mav.camera_fov_status_send(_boot_ms(now_s), *here, *nowhere, q, *fov_deg)

    def _send_interval(self, number: int | None) -> None:
        stream = self._streams.get(number) if number is not None else None
        interval_us = 0  # not to be had
        if stream is not None:
            interval_us = round(stream.interval_s * 1e6) if stream.interval_s is not None else -1
        self._mav.message_interval_send((number or 0) & 0xFFFF, interval_us)

    def _send_image_status(self, now_s: float) -> None:
        """The box's edges, or its middle and half the side of a square as large, over the frame's width."""
        shown, nothing = self._shown, _UNKNOWN
        where, circle, corners = 0, (nothing, nothing, nothing), (nothing, nothing, nothing, nothing)
        if shown.box is not None and self._size_hw is not None:
            box, (height, width) = shown.box, self._size_hw
            where = mavlink.CAMERA_TRACKING_TARGET_DATA_IN_STATUS
            if shown.mode == mavlink.CAMERA_TRACKING_MODE_POINT:
                u, v = box.center_xy
                circle = (_share(u, width), _share(v, height), _share(math.sqrt(box.w * box.h) / 2, width))
            else:
                top_left = _share(box.x, width), _share(box.y, height)
                corners = (*top_left, _share(box.x + box.w, width), _share(box.y + box.h, height))
        self._mav.camera_tracking_image_status_send(shown.status, shown.mode, where, *circle, *corners)

    def _send_geo_status(self, now_s: float) -> None:
        """Nothing where no place is known: the message has no word for that."""
        place = self._geo_place(now_s)
        if place is None:
            return
        velocity, velocity_sigma_mps = (_UNKNOWN, _UNKNOWN), _UNKNOWN
        if place.velocity_ne_mps is not None:
            velocity, velocity_sigma_mps = place.velocity_ne_mps, place.velocity_sigma_mps
        self._mav.camera_tracking_geo_status_send(
            ACTIVE,
            round(place.lat_deg * 1e7),
            round(place.lon_deg * 1e7),
            place.amsl_m,
            place.horizontal_sigma_m,
            place.vertical_sigma_m,
            *velocity,
            _UNKNOWN,
            velocity_sigma_mps,
            place.distance_m,
            place.bearing_rad,
            HEADING_SIGMA_RAD,
        )


def firmware_number(version: str) -> int:
    """CAMERA_INFORMATION's `firmware_version` of "1.2.3": major in the lowest byte; 0 where there is no number."""
    numbers = [min(int(word), 0xFF) for word in re.findall(r"\d+", version)[:3]]
    return sum(number << (8 * place) for place, number in enumerate(numbers))


def stream_address(uri: str) -> str:
    """VIDEO_STREAM_INFORMATION's `uri`: of streams that the ground station listens for, the port alone.

    That is the message's definition. QGroundControl puts its own scheme before what is not just the one that it
    expects: `udp265://` with H.265, and in older versions `mpegts://` always.
    """
    _, _, port = uri.rpartition(":")
    return port if stream_scheme(uri) in {"udp", "mpegts"} and port.isdecimal() else uri


def _share(px: float, whole_px: float) -> float:
    """Place or length over the frame's side, in 0..1: a box may stick out."""
    return min(max(px / whole_px, 0.0), 1.0)


def _boot_ms(now_s: float) -> int:
    return int(now_s * 1000) & 0xFFFFFFFF
