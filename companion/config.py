"""The configuration: one TOML file, read once, checked whole; every key with its unit in the name.

A table of the file is a frozen dataclass here, a key a field. `setting` gives a field its range or its choices; what
depends on two keys is checked in `_cross_checks`.
"""

import dataclasses
import difflib
import json
import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

from companion.errors import ConfigError
from mscf import PRESETS
from mscf.frame import MIN_BOX_PX  # of a first box

FILE_NAME = "config.toml"
SETPOINT_BITS = 650  # of one on a serial line: 65 bytes, each with a start and a stop bit
SIGNATURE_BITS = 130  # more, where it is signed
MAX_LINE_SHARE = 0.25  # of a serial line for setpoints: a queue of 512 bytes is a tenth of a second old then
FIRST_CAMERA = 100  # MAV_COMP_ID_CAMERA
FIRST_USER_COMMAND = 31010  # MAV_CMD_USER_1
STREAM_SCHEMES = ("rtsp", "udp", "tcp", "mpegts")
MAX_URI = 160  # bytes of VIDEO_STREAM_INFORMATION.uri
MIN_RANGE_M = 3.0  # to be held horizontally; as follow.nominal_range_m


def setting(
    default: Any,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    count: tuple[int, ...] = (),
) -> Any:
    """Field of a configuration: a number in `low`..`high`, a word of `choices`, or a list of so many numbers."""
    return field(default=default, metadata={"low": low, "high": high, "choices": choices, "count": count})


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """Where frames come from, and where they look."""

    source: str = setting("/dev/video0")  # /dev/videoN, a video file, a folder of images, or unix:PATH
    pace: str = setting("rate", choices=("rate", "fast"))  # of files: as they were filmed, or as fast as possible
    width_px: int = setting(1280, low=64, high=7680)
    height_px: int = setting(720, low=48, high=4320)
    frames_per_s: float = setting(30.0, low=1, high=240)
    horizontal_fov_deg: float = setting(0.0, low=0, high=170)  # 0: focal_px is given
    focal_px: float = setting(0.0, low=0, high=20000)  # 0: horizontal_fov_deg is given
    distortion: tuple[float, ...] = setting((), count=(0, 4, 5, 8))  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]
    mount_roll_deg: float = setting(0.0, low=-180, high=180)
    mount_pitch_deg: float = setting(0.0, low=-90, high=45)  # negative looks down
    mount_yaw_deg: float = setting(0.0, low=-180, high=180)  # positive looks right
    latency_ms: float = setting(30.0, low=0, high=1000)  # from exposure to the frame's time stamp


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSection:
    """The tracker."""

    preset: str = setting("mscf", choices=PRESETS)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """The port to the autopilot, in pymavlink's device notation."""

    device: str = setting("udpin:127.0.0.1:14540")  # udpin: udpout: tcp: tcpin: HOST:PORT, or a serial path
    baud: int = setting(921600, low=1200, high=4000000)
    system_id: int = setting(0, low=0, high=254)  # of the vehicle; 0: that of the first autopilot heard
    component_id: int = setting(191, low=2, high=254)  # MAV_COMP_ID_ONBOARD_COMPUTER
    setpoint_frame: str = setting("local_ned", choices=("local_ned", "body_ned"))


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectConfig:
    """What is tracked without being told."""

    at_start: str = setting("nothing", choices=("nothing", "centre", "box"))
    box: tuple[float, ...] = setting((), count=(0, 4))  # x, y, w, h, px
    centre_share: float = setting(0.12, low=0.01, high=0.9)  # side of the centre box over the frame's height


@dataclass(frozen=True, slots=True, kw_only=True)
class RcConfig:
    """The pilot's transmitter: an optional switch, and the sticks that end everything."""

    switch_channel: int = setting(0, low=0, high=18)  # 0: none
    switch: str = setting("select", choices=("select", "engage"))  # off, select the middle, engage; or off, engage
    stick_guard_us: float = setting(120.0, low=40, high=400)  # deviation from 1500 us that means "mine"
    roll_channel: int = setting(1, low=1, high=18)
    pitch_channel: int = setting(2, low=1, high=18)
    yaw_channel: int = setting(4, low=1, high=18)


@dataclass(frozen=True, slots=True, kw_only=True)
class EngageConfig:
    """When following may begin."""

    auto: bool = setting(default=False)  # engage by itself, once a selection, where nothing forbids it
    min_confidence: float = setting(0.5, low=0, high=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowConfig:
    """How the box becomes a velocity."""

    mode: str = setting("spotlight", choices=("spotlight", "follow", "overhead"))
    yaw_gain_per_s: float = setting(1.2, low=0.1, high=8)
    yaw_feed_forward: float = setting(0.8, low=0, high=0.8)  # share of the bearing's own rate
    yaw_dead_zone_deg: float = setting(2.0, low=0, high=15)
    approach_gain_per_s: float = setting(0.35, low=0.05, high=2)
    retreat_gain_per_s: float = setting(0.6, low=0.05, high=2)
    speed_feed_forward: float = setting(0.8, low=0, high=0.8)  # share of the target's own speed
    size_dead_zone_share: float = setting(0.05, low=0, high=0.3)
    range_m: float = setting(0.0, low=0, high=200)  # horizontal range to hold; 0: that at engage
    target_height_m: float = setting(0.0, low=0, high=50)  # true height of what the box holds; 0: not known
    nominal_range_m: float = setting(20.0, low=3, high=200)  # scale of size errors where no range is known
    vertical_gain_per_s: float = setting(0.0, low=0, high=1)  # 0: the height is held
    delay_ms: float = setting(200.0, low=20, high=1000)  # whole delay of the loop, for the check of the gains


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsConfig:
    """The envelope: nothing outside is ever sent."""

    speed_mps: float = setting(5.0, low=0.2, high=20)
    climb_mps: float = setting(1.0, low=0.1, high=5)
    descent_mps: float = setting(0.7, low=0.1, high=3)
    yaw_rate_dps: float = setting(45.0, low=5, high=180)
    acceleration_mps2: float = setting(1.5, low=0.2, high=5)
    yaw_acceleration_dps2: float = setting(90.0, low=10, high=360)
    floor_m: float = setting(5.0, low=1, high=500)  # above the place of take-off
    ceiling_m: float = setting(60.0, low=2, high=1000)
    radius_m: float = setting(150.0, low=5, high=5000)  # around the place of engagement


@dataclass(frozen=True, slots=True, kw_only=True)
class LossConfig:
    """The ladder: seconds since the target was last measured."""

    hold_after_s: float = setting(0.6, low=0.2, high=3)
    search_after_s: float = setting(0.0, low=0, high=60)  # 0: no search by turning
    search_yaw_rate_dps: float = setting(15.0, low=1, high=20)
    give_up_after_s: float = setting(12.0, low=2, high=120)
    confirm_after_s: float = setting(3.0, low=0, high=120)  # found later: the operator has to engage again
    on_give_up: str = setting("hold", choices=("hold", "rtl", "land"))


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopConfig:
    """The command loop."""

    rate_hz: float = setting(20.0, low=10, high=50)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlConfig:
    """The local control socket that `mscf-companion ctl` speaks to."""

    socket: str = setting("/run/mscf-companion/control.sock")  # empty: none


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundConfig:
    """The ground station: our camera component, which it sees, and what it may order."""

    camera_component: int = setting(100, low=0, high=105)  # MAV_COMP_ID_CAMERA; 0: none
    system_ids: tuple[int, ...] = setting((255,), low=1, high=255, count=(0, 1, 2, 3, 4))  # may select and engage
    engage_command: int = setting(0, low=0, high=31014)  # MAV_CMD_USER_1 to _5: 31010..31014; 0: none
    stream_uri: str = setting("")  # of the video that the operator sees; empty: none
    stream_encoding: str = setting("h264", choices=("h264", "h265"))
    plain_status: bool = setting(
        default=False
    )  # "coasting" told as "active", for ground stations that hide the box else


@dataclass(frozen=True, slots=True, kw_only=True)
class SigningConfig:
    """MAVLink 2 signing: with a key, everything is signed and nothing unsigned is heard."""

    key_file: str = setting("")  # empty: systemd's credential, if there is one; else no signing
    link_id: int = setting(0, low=0, high=255)


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalConfig:
    """A gimbal that carries the camera, by the gimbal protocol v2."""

    axes: str = setting("none", choices=("none", "pitch", "pitch_yaw"))  # that we turn; none: a fixed camera
    device_id: int = setting(0, low=0, high=255)  # as GIMBAL_MANAGER_SET_PITCHYAW names it; 0: all of the manager
    rate_dps: float = setting(40.0, low=2, high=180)


@dataclass(frozen=True, slots=True, kw_only=True)
class LandingConfig:
    """LANDING_TARGET for the autopilot's own precision landing, from a camera that looks down."""

    send_target: bool = setting(default=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConfig:
    """The flight record: a folder a run."""

    enabled: bool = setting(default=True)
    folder: str = setting("")  # of all flights; empty: $STATE_DIRECTORY/flights, else below the user's state folder
    video: str = setting("overlay", choices=("none", "plain", "overlay"))
    video_frames_per_s: float = setting(10.0, low=1, high=60)
    max_total_mb: float = setting(4096.0, low=16, high=1000000)  # of all flights; the oldest go first
    max_age_days: float = setting(30.0, low=0.1, high=3650)
    min_free_mb: float = setting(512.0, low=1, high=1000000)  # of the disk, below which nothing is written


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A whole configuration."""

    camera: CameraConfig = field(default_factory=CameraConfig)
    tracker: TrackerSection = field(default_factory=TrackerSection)
    link: LinkConfig = field(default_factory=LinkConfig)
    select: SelectConfig = field(default_factory=SelectConfig)
    rc: RcConfig = field(default_factory=RcConfig)
    engage: EngageConfig = field(default_factory=EngageConfig)
    follow: FollowConfig = field(default_factory=FollowConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    ground: GroundConfig = field(default_factory=GroundConfig)
    signing: SigningConfig = field(default_factory=SigningConfig)
    gimbal: GimbalConfig = field(default_factory=GimbalConfig)
    landing: LandingConfig = field(default_factory=LandingConfig)
    record: RecordConfig = field(default_factory=RecordConfig)

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, from whichever of the two was given."""
        camera = self.camera
        return camera.focal_px or camera.width_px / 2 / math.tan(math.radians(camera.horizontal_fov_deg) / 2)


def read(path: Path) -> Config:
    """Configuration in a file.

    Raises
    ------
    ConfigError
        If it cannot be read; the text begins with the path.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; give another file with -c") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not UTF-8 text: save it as such") from error
    try:
        return parse(text)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def parse(text: str) -> Config:
    """Configuration in a TOML text.

    Raises
    ------
    ConfigError
        If the text is not TOML, a key is unknown (the nearest valid one is named), a value has the wrong type
        or is out of range, or two values contradict each other.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"not valid TOML: {error}") from error
    types = get_type_hints(Config)
    sections = {}
    for name, table in tables.items():
        if name not in types:
            raise ConfigError(_unknown("table", name, types, "[{}]"))
        if not isinstance(table, dict):
            raise ConfigError(f"{name} = {table!r} stands outside a table: write it as a key of one, below [{name}]")
        sections[name] = _section(name, types[name], table)
    config = Config(**sections)
    for is_bad, text_of in _cross_checks(config):
        if is_bad:
            raise ConfigError(text_of)
    return config


def without_passwords(config: Config) -> Config:
    """The configuration as it may be kept and shown: of the video's address, a name and a password are left out."""
    uri = re.sub(r"(?<=://)[^/?#]+@", "", config.ground.stream_uri)  # not the bare @ of udp://@:5600
    uri = re.sub(r"\?.*", "", uri)  # where some cameras want them
    return replace(config, ground=replace(config.ground, stream_uri=uri))


def text_of(config: Config) -> str:
    """The configuration as a TOML text with every key; `parse` reads it back as it is."""
    lines = []
    for table in dataclasses.fields(config):
        section = getattr(config, table.name)
        lines.append(f"[{table.name}]")
        for key in dataclasses.fields(section):
            value = getattr(section, key.name)
            value = list(value) if isinstance(value, tuple) else value
            text = json.dumps(value, ensure_ascii=False)  # TOML knows no surrogates, and must have DEL escaped
            lines.append(f"{key.name} = {text}".replace("\x7f", "\\u007f"))
    return "\n".join(lines) + "\n"


def warnings(config: Config) -> tuple[str, ...]:
    """What is allowed but likely not meant; a line each."""
    follow, found = config.follow, []
    gain_delay = follow.yaw_gain_per_s * follow.delay_ms / 1000
    # pi/6 leaves 60 degrees of phase margin to an integrator behind a dead time, pi/2 none
    if gain_delay > 0.52:
        found.append(
            f"follow.yaw_gain_per_s x follow.delay_ms = {gain_delay:.2f}, above 0.52 the nose overshoots: "
            f"at {follow.delay_ms:g} ms use a gain of at most {0.52 / follow.delay_ms * 1000:.1f}"
        )
    if follow.mode == "follow" and config.camera.mount_pitch_deg > -10 and not follow.target_height_m:
        found.append(
            "the camera looks to the horizon and follow.target_height_m is not given: where no range is known the "
            "drone keeps the size of the box, not a distance"
        )
    if config.camera.latency_ms > 300:
        found.append(
            f"camera.latency_ms = {config.camera.latency_ms:g}: what was seen more than 500 ms ago moves nothing, and "
            "the tracker's own time comes on top"
        )
    if config.link.device.startswith("udpin:0.0.0.0:"):
        found.append(
            f"link.device = {config.link.device}: whoever reaches this port can play the autopilot; give the address "
            "of the interface that the autopilot is on, 127.0.0.1 behind a router on this computer"
        )
    if config.loop.rate_hz < 20:
        found.append(f"loop.rate_hz = {config.loop.rate_hz:g}: both autopilots are at ease from 20")
    return tuple(found)


def _section(table: str, kind: type, values: dict[str, Any]) -> Any:
    fields = {item.name: item for item in dataclasses.fields(kind)}
    types = get_type_hints(kind)
    checked = {}
    for key, value in values.items():
        if key not in fields:
            raise ConfigError(_unknown(f"key in [{table}]", key, fields, table + ".{}"))
        checked[key] = _value(f"{table}.{key}", types[key], value, fields[key].metadata)
    return kind(**checked)


def _unknown(what: str, name: str, valid: Any, form: str) -> str:
    near = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    mend = f"did you mean {form.format(near[0])}?" if near else f"valid are {', '.join(valid)}"
    return f"unknown {what}, {name!r}: {mend}"


def _value(name: str, kind: Any, value: Any, rule: Any) -> Any:
    if kind is bool or kind is str:
        if not isinstance(value, kind):
            word = "true or false" if kind is bool else "a text in quotes"
            raise ConfigError(f"{name} = {value!r} must be {word}")
        if rule["choices"] and value not in rule["choices"]:
            raise ConfigError(f"{name} = {value!r} is unknown: choose {' or '.join(map(repr, rule['choices']))}")
        return value
    if kind is int or kind is float:
        return _number(name, kind, value, rule)
    counts = " or ".join(str(count) for count in rule["count"])
    if not (isinstance(value, list) and len(value) in rule["count"] and all(map(_is_finite, value))):
        raise ConfigError(f"{name} = {value!r} must be a list of {counts} numbers")
    (item_kind, _) = get_args(kind)
    return tuple(_number(f"{name}[{index}]", item_kind, item, rule) for index, item in enumerate(value))


def _number(name: str, kind: Callable[[Any], Any], value: Any, rule: Any) -> Any:
    low, high = rule["low"], rule["high"]
    is_right = _is_finite(value) and (kind is float or isinstance(value, int))
    if low is None and is_right:
        return kind(value)
    if not is_right or not low <= value <= high:
        word = "a whole number" if kind is int else "a number"
        raise ConfigError(f"{name} = {value!r} must be {word} in {low}..{high}")
    return kind(value)


def _is_finite(value: object) -> bool:
    if isinstance(value, int):  # TOML's may be too long for a float
        return not isinstance(value, bool) and abs(value) < 1 << 63
    return isinstance(value, float) and math.isfinite(value)


def stream_scheme(uri: str) -> str:
    """What stands before "://"; empty where there is none."""
    scheme, mark, rest = uri.partition("://")
    return scheme if mark and rest else ""


def _cross_checks(config: Config) -> tuple[tuple[bool, str], ...]:
    """What two keys must not say together: whether they do, and the line that says so."""
    camera, select, follow, limits, loss = config.camera, config.select, config.follow, config.limits, config.loss
    setpoint_bits = SETPOINT_BITS + SIGNATURE_BITS * bool(config.signing.key_file)
    link, needed_baud = config.link, setpoint_bits * config.loop.rate_hz / MAX_LINE_SHARE
    rc, gain_delay = config.rc, config.follow.yaw_gain_per_s * config.follow.delay_ms / 1000
    is_fixed = config.gimbal.axes == "none"  # with a gimbal the mount's angles are its own
    channels = [rc.roll_channel, rc.pitch_channel, rc.yaw_channel] + [rc.switch_channel] * (rc.switch_channel > 0)
    return (
        (
            (camera.focal_px > 0) == (camera.horizontal_fov_deg > 0),
            "camera: give one of horizontal_fov_deg and focal_px, not both and not neither",
        ),
        (
            select.at_start == "box" and not select.box,
            'select.at_start = "box" needs select.box = [x, y, w, h] in pixels',
        ),
        (
            bool(select.box) and min(select.box[2:], default=1) <= 0,
            f"select.box = {list(select.box)}: width and height must be above 0",
        ),
        (
            limits.floor_m >= limits.ceiling_m,
            f"limits.floor_m = {limits.floor_m:g} must be below limits.ceiling_m = {limits.ceiling_m:g}",
        ),
        (
            gain_delay >= math.pi / 2,
            f"follow.yaw_gain_per_s x follow.delay_ms = {gain_delay:.2f} s/s is unstable from 1.57: lower the gain",
        ),
        (
            follow.retreat_gain_per_s < follow.approach_gain_per_s,
            (
                f"follow.retreat_gain_per_s = {follow.retreat_gain_per_s:g} must not be below "
                f"follow.approach_gain_per_s = {follow.approach_gain_per_s:g}: backing off comes first"
            ),
        ),
        (
            0 < follow.range_m < MIN_RANGE_M,
            f"follow.range_m = {follow.range_m:g} must be 0 or in {MIN_RANGE_M:g}..200: nearer is no distance to keep",
        ),
        (
            is_fixed and follow.mode == "follow" and abs(math.remainder(camera.mount_roll_deg, 180)) > 45,
            (
                f"camera.mount_roll_deg = {camera.mount_roll_deg:g} must be within 45 of 0 or 180: sizes and ranges "
                "are measured along the picture's height"
            ),
        ),
        (
            is_fixed and follow.mode == "overhead" and camera.mount_pitch_deg > -70,
            (
                f'follow.mode = "overhead" needs a camera that looks down: camera.mount_pitch_deg = '
                f"{camera.mount_pitch_deg:g} must be in -90..-70"
            ),
        ),
        (
            is_fixed and follow.mode != "overhead" and camera.mount_pitch_deg < -75,
            (
                f'follow.mode = "{follow.mode}" needs a camera that looks ahead: camera.mount_pitch_deg = '
                f'{camera.mount_pitch_deg:g} must be in -75..45, or follow.mode "overhead"'
            ),
        ),
        (
            loss.give_up_after_s <= max(loss.hold_after_s, loss.search_after_s),
            (
                f"loss.give_up_after_s = {loss.give_up_after_s:g} must be above loss.hold_after_s = "
                f"{loss.hold_after_s:g} and loss.search_after_s = {loss.search_after_s:g}"
            ),
        ),
        (
            0 < loss.search_after_s <= loss.hold_after_s,
            (
                f"loss.search_after_s = {loss.search_after_s:g} must be 0 or above loss.hold_after_s = "
                f"{loss.hold_after_s:g}"
            ),
        ),
        (
            loss.search_yaw_rate_dps > limits.yaw_rate_dps,
            (
                f"loss.search_yaw_rate_dps = {loss.search_yaw_rate_dps:g} must not be above limits.yaw_rate_dps = "
                f"{limits.yaw_rate_dps:g}"
            ),
        ),
        (
            select.centre_share * camera.height_px < MIN_BOX_PX,
            (
                f"select.centre_share = {select.centre_share:g} of camera.height_px = {camera.height_px} is no "
                f"{MIN_BOX_PX:g} px: nothing so small is tracked"
            ),
        ),
        (
            link.device.startswith("/") and link.baud < needed_baud,
            (
                f"link.baud = {link.baud} is too slow for {config.loop.rate_hz:g} setpoints a second: give "
                f"{needed_baud:.0f} or more, or lower loop.rate_hz"
            ),
        ),
        (
            0 < config.ground.camera_component < FIRST_CAMERA,
            (
                f"ground.camera_component = {config.ground.camera_component} must be 0 for none, or a camera's id in "
                f"{FIRST_CAMERA}..105"
            ),
        ),
        (
            0 < config.ground.engage_command < FIRST_USER_COMMAND,
            (
                f"ground.engage_command = {config.ground.engage_command} must be 0 for none, or one of "
                f"{FIRST_USER_COMMAND}..31014 (MAV_CMD_USER_1 to MAV_CMD_USER_5)"
            ),
        ),
        (
            config.ground.camera_component == link.component_id,
            f"ground.camera_component and link.component_id are both {link.component_id}: give two different ids",
        ),
        (
            bool(config.ground.stream_uri) and stream_scheme(config.ground.stream_uri) not in STREAM_SCHEMES,
            (
                f"ground.stream_uri = {config.ground.stream_uri!r} must begin with "
                f"{', '.join(scheme + '://' for scheme in STREAM_SCHEMES)}"
            ),
        ),
        (
            len(config.ground.stream_uri.encode()) > MAX_URI,
            f"ground.stream_uri is {len(config.ground.stream_uri.encode())} bytes long: MAVLink carries {MAX_URI}",
        ),
        (
            config.landing.send_target and camera.mount_pitch_deg > -70 and is_fixed,
            (
                f"landing.send_target needs a camera that looks down: camera.mount_pitch_deg = "
                f"{camera.mount_pitch_deg:g} must be in -90..-70"
            ),
        ),
        (
            len(set(channels)) < len(channels),
            "rc: roll_channel, pitch_channel, yaw_channel and switch_channel must be four different channels",
        ),
    )
