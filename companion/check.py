"""`mscf-companion check`: what the configuration, the camera and the autopilot are like, before anything flies."""

import math
import os
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TextIO

from companion.camera_model import CameraModel
from companion.capture import open_camera
from companion.codec import MavlinkCodec
from companion.config import Config
from companion.controller import Controller
from companion.errors import CompanionError
from companion.flight_folders import NoRoomError, flights_folder, try_folder
from companion.link import Link
from companion.parameters import WANTED, advice
from companion.signing import Signing, read_key, stamp_at
from companion.types import (
    Attitude,
    Autopilot,
    ControlInput,
    Engage,
    FlightMode,
    GimbalAttitude,
    Heartbeat,
    HeightReading,
    Landed,
    LandedReading,
    LocalState,
    OperatorCommand,
    Parameter,
    Select,
    TrackSample,
)
from companion.wire import Wire
from mscf import Box, MscfError, TrackStatus

CAMERA_S = 4.0  # how long to look, after the first frame
CAMERA_WAIT_S = 6.0
LINK_S = 6.0  # how long to listen, after the first heartbeat
LINK_WAIT_S = 8.0
MIN_RATE_SHARE = 0.9
MAX_AGE_S = 10.0  # of a frame: older is no delay but another clock


def check_camera(config: Config, out: TextIO) -> bool:
    """Open the camera, measure its rate, and say whether it is what the configuration says."""
    camera = config.camera
    stamps: list[float] = []
    arrivals: list[float] = []
    size = (0, 0)
    begin_s = time.monotonic()
    try:
        for captured in open_camera(camera):
            now_s = time.monotonic()
            if captured is not None:
                image, captured_s = captured
                size = (image.shape[1], image.shape[0])
                stamps.append(captured_s)
                arrivals.append(now_s)
            # by arrival: the stamps may be wrong
            if now_s - (arrivals[0] if arrivals else begin_s) > (CAMERA_S if arrivals else CAMERA_WAIT_S):
                break
    except (CompanionError, MscfError, OSError) as error:
        print(f"camera    FAILED: {error}", file=out)
        return False
    if len(stamps) < 2:
        print(f"camera    FAILED: {camera.source} gave {len(stamps)} frames in {CAMERA_WAIT_S:g} s", file=out)
        return False
    age_s = sorted(read_s - captured_s for read_s, captured_s in zip(arrivals, stamps, strict=True))[len(stamps) // 2]
    if stamps[-1] <= stamps[0] or not 0 <= age_s <= MAX_AGE_S:
        print(
            f"camera    FAILED: {camera.source} stamps its frames with times {age_s:.3g} s old, over "
            f"{stamps[-1] - stamps[0]:.3g} s: they must be the times of capture, of CLOCK_MONOTONIC",
            file=out,
        )
        return False
    rate_hz = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    longest_ms = max(after_s - before_s for before_s, after_s in pairwise(stamps)) * 1000
    print(
        f"camera    {camera.source}: {size[0]} x {size[1]} px, {rate_hz:.1f} frames/s, longest "
        f"gap {longest_ms:.0f} ms, age when read {age_s * 1000:.0f} ms "
        "(exposure to stamp, camera.latency_ms, is not in it)",
        file=out,
    )
    is_right = True
    if size != (camera.width_px, camera.height_px):
        print(f"          WARNING: camera.width_px x height_px say {camera.width_px} x {camera.height_px}", file=out)
        is_right = size[0] * camera.height_px == size[1] * camera.width_px  # the same aspect: the model scales
    if rate_hz < MIN_RATE_SHARE * camera.frames_per_s and camera.pace == "rate":
        print(f"          WARNING: camera.frames_per_s says {camera.frames_per_s:g}: less light or USB 2?", file=out)
    return is_right


def check_record(config: Config, environ: Mapping[str, str], out: TextIO) -> bool:
    """Try whether the record of a flight would be written, and leave nothing behind.

    Parameters
    ----------
    environ : environment variables, which say where flights are recorded unless the configuration does.
    """
    record = config.record
    if not record.enabled:
        print("record    none: record.enabled = false", file=out)
        return True
    flights = flights_folder(record, environ)
    is_right = True
    try:
        free_mb = try_folder(flights, record)
    except NoRoomError as error:
        print(f"record    FAILED: {error.strerror}", file=out)
        is_right = False
    except OSError as error:
        why = error.strerror or error
        print(f"record    FAILED: {flights} cannot be made or written: {why}; set record.folder", file=out)
        is_right = False
    else:
        print(f"record    {flights}: can be written, {free_mb:.0f} MB free", file=out)
    if not record.folder and not environ.get("STATE_DIRECTORY"):
        print("          of who runs this; the service has a folder of its own", file=out)
    if record.video != "none":
        try:
            import av  # noqa: F401, PLC0415 - an extra
        except ImportError:
            why = f'record.video = "{record.video}" needs PyAV: pip install av, or set "none"'
            print(f"          WARNING: no film: {why}", file=out)
    return is_right


@dataclass(slots=True)
class _Heard:
    heartbeat: Heartbeat | None = None
    first_s: float = 0.0
    asked_s: float = 0.0


def check_link(config: Config, out: TextIO) -> bool:
    """Listen for the autopilot, ask for its telemetry and the parameters that matter, and say what to change."""
    link = Link(config.link.device, config.link.baud)
    key = read_key(config.signing, os.environ)
    signing = Signing(key, config.signing.link_id, stamp_at(time.time())) if key is not None else None
    wire = Wire(config.link.system_id or 1, signing)
    codec = MavlinkCodec(wire, config.link.system_id, config.link.component_id)
    heard, counts, parameters = _Heard(), Counter[str](), dict[str, float]()
    begin_s = time.monotonic()
    try:
        while True:
            now_s = time.monotonic()
            if now_s - heard.asked_s > 1.0:
                heard.asked_s = now_s
                codec.send_heartbeat(is_active=False, is_healthy=True)
                if heard.heartbeat is not None:
                    codec.send_rate_requests()
                    for name in WANTED[heard.heartbeat.autopilot]:
                        if name not in parameters:
                            codec.send_parameter_request(name)
            for event in codec.receive(wire.receive(link.read(now_s)), now_s):
                if isinstance(event, Heartbeat):
                    heard.first_s = heard.first_s or now_s
                    heard.heartbeat = event
                elif isinstance(event, Parameter):
                    parameters[event.name] = event.value
                counts[type(event).__name__] += 1
            link.write(b"".join(wire.drain()))
            limit_s = LINK_S if heard.heartbeat is not None else LINK_WAIT_S
            if now_s - (heard.first_s or begin_s) > limit_s:
                break
            time.sleep(0.01)
    finally:
        link.close()
    if link.fault:
        print(f"link      FAILED: {link.fault}", file=out)
        return False
    if heard.heartbeat is None:
        signed = " that signs with our key" if key is not None else ""
        print(
            f"link      FAILED: {config.link.device} is open, but no autopilot{signed} was heard in {LINK_WAIT_S:g} s",
            file=out,
        )
        return False
    _print_autopilot(heard.heartbeat, counts, parameters, out)
    return heard.heartbeat.is_multicopter


def _print_autopilot(heartbeat: Heartbeat, counts: Counter[str], parameters: dict[str, float], out: TextIO) -> None:
    kind = heartbeat.autopilot
    armed = "armed" if heartbeat.is_armed else "disarmed"
    print(f"link      {kind.value}, {heartbeat.mode_name}, {armed}", file=out)
    if not heartbeat.is_multicopter:
        print("          FAILED: not a multicopter: this application flies no other vehicle", file=out)
    rates = [f"{name} {counts[kind.__name__] / LINK_S:.0f}" for name, kind in _RATES]
    print(f"          per second: {', '.join(rates)}", file=out)
    for name in WANTED[kind]:
        value = f"{parameters[name]:g}" if name in parameters else "no answer"
        print(f"          {name} = {value}", file=out)
    for line in advice(kind, parameters):
        print(f"          ADVICE: {line}", file=out)


_RATES = (("attitude", Attitude), ("position", LocalState), ("height", HeightReading), ("landed", LandedReading))

# ------------------------------------------------------------------------------------------------------ signs
_HEIGHT_M = 15.0
_STEP_S = 0.05
_SETTLE_STEPS = 40


def print_signs(config: Config, out: TextIO) -> None:
    """Say which way the vehicle would move for a target to each side; the flight controller itself is asked."""
    print(f"signs     follow.mode = {config.follow.mode}; level, heading north, {_HEIGHT_M:g} m high:", file=out)
    for name, box, scale in _displaced(config):
        forward, right, down, yaw = _response(config, box, scale)
        words = []
        for value, positive, negative, unit in (
            (forward, "forward", "back", "m/s"),
            (right, "right", "left", "m/s"),
            (-down, "up", "down", "m/s"),
            (math.degrees(yaw), "turn right", "turn left", "deg/s"),
        ):
            if abs(value) > 0.02:
                words.append(f"{positive if value > 0 else negative} {abs(value):.1f} {unit}")
        print(f"          target {name:6} -> {', '.join(words) or 'stand'}", file=out)


def _displaced(config: Config) -> list[tuple[str, Box, float]]:
    """The box by name: moved across the frame, or larger and smaller as by a target nearer and farther."""
    camera = config.camera
    aside, along = camera.width_px * 0.2, camera.height_px * 0.15
    middle = _middle(config)
    return [
        ("left", replace(middle, x=middle.x - aside), 1.0),
        ("right", replace(middle, x=middle.x + aside), 1.0),
        ("above", replace(middle, y=middle.y - along), 1.0),
        ("below", replace(middle, y=middle.y + along), 1.0),
        ("near", middle, 1.4),
        ("far", middle, 0.7),
    ]


def _middle(config: Config) -> Box:
    side = 0.15 * config.camera.height_px
    return Box((config.camera.width_px - side) / 2, (config.camera.height_px - side) / 2, side, side)


def _response(config: Config, box: Box, scale: float) -> tuple[float, float, float, float]:
    """Forward, right, down in m/s and yaw rate in rad/s for a target that jumped to `box` after engagement."""
    controller = Controller(replace(config, engage=replace(config.engage, auto=False)))
    size_hw = (config.camera.height_px, config.camera.width_px)
    wide = Box(box.x - (scale - 1) * box.w / 2, box.y - (scale - 1) * box.h / 2, box.w * scale, box.h * scale)
    orders: dict[int, tuple[OperatorCommand, ...]] = {
        2: (Select(_middle(config)),),
        _SETTLE_STEPS - 2: (Engage(),),
    }
    setpoint = None
    has_gimbal = config.gimbal.axes != "none"  # which then points as the mount's angles say
    mount_rpy_rad = CameraModel.of(config, size_hw).mount_rpy_rad
    for index in range(_SETTLE_STEPS + 8):
        now_s = 100.0 + index * _STEP_S
        seen = _middle(config) if index < _SETTLE_STEPS else wide
        latency_s = config.camera.latency_ms / 1000
        commands: tuple[OperatorCommand, ...] = orders.get(index, ())
        sample = TrackSample(
            index, now_s + latency_s, now_s, size_hw, 1 if index > 2 else 0, TrackStatus.TRACKING, index > 2, seen, 1.0
        )
        events = (
            Heartbeat(
                now_s,
                Autopilot.ARDUPILOT,
                is_multicopter=True,
                mode=FlightMode.EXTERNAL,
                mode_name="GUIDED",
                is_armed=True,
                has_failsafe=False,
            ),
            Attitude(now_s, 0.0, 0.0, 0.0, 0.0),
            LocalState(now_s, (0.0, 0.0, -_HEIGHT_M), (0.0, 0.0, 0.0)),
            HeightReading(now_s, _HEIGHT_M),
            LandedReading(now_s, Landed.IN_AIR),
        )
        pointing = (GimbalAttitude(now_s, *mount_rpy_rad, is_yaw_on_earth=False),) if has_gimbal else ()
        setpoint = controller.step(ControlInput(now_s, sample, (*events, *pointing), commands)).setpoint
    if setpoint is None:
        return 0.0, 0.0, 0.0, 0.0
    return (*setpoint.velocity_ned_mps, setpoint.yaw_rate_radps)


def describe(config: Config) -> str:
    """The configuration in a line."""
    camera = config.camera
    model = CameraModel.of(config, (camera.height_px, camera.width_px))
    fov_deg, _ = model.fov_deg
    return (
        f"{camera.source} {camera.width_px} x {camera.height_px}, {fov_deg:.0f} deg, pitch "
        f"{camera.mount_pitch_deg:g} deg; {config.link.device}; {config.follow.mode}"
    )
