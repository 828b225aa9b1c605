"""The values that cross the borders inside the application; frozen, in SI units, frame and order in the name.

All times are seconds of one monotonic clock, ours. NED is north, east, down; FRD is forward, right, down.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum, auto

from mscf import Box, TrackStatus
from mscf.arrays import Image

Vector = tuple[float, float, float]


# ---------------------------------------------------------------------------------------- camera -> vision
@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A picture as captured: (H, W, 3) uint8 BGR, read-only, its number and the time of capture."""

    image: Image
    seq: int
    captured_s: float


# ------------------------------------------------------------------------------------ vision <-> the loop
@dataclass(frozen=True, slots=True)
class Selection:
    """What vision shall track; every new wish has a new number."""

    number: int
    box: Box | None  # in pixels of the frame; None: nothing
    is_point: bool = False  # whether the box only surrounds a point, and is to be grown around what is there


@dataclass(frozen=True, slots=True)
class TrackSample:
    """What vision says of one frame.

    `box` and what follows are those of selection `selection`; where `status` is None nothing is tracked.
    Only where `is_measured` has the target been seen in this frame.
    """

    seq: int
    captured_s: float
    finished_s: float
    size_hw: tuple[int, int]  # of the frame, px
    selection: int  # number of the selection in force, 0 before the first
    status: TrackStatus | None = None
    is_measured: bool = False
    box: Box | None = None
    confidence: float = 0.0
    peak: float = 0.0
    threat: float = 0.0
    fault: str = ""  # why the selection was refused, or what the tracker raised


# ------------------------------------------------------------------------------------ autopilot -> the loop
class Autopilot(Enum):
    """Kinds of autopilot, as far as they differ for us."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class FlightMode(Enum):
    """Flight modes by what they mean for us; `Heartbeat.mode_name` is the autopilot's own word."""

    EXTERNAL = "obeys our setpoints"  # ArduCopter GUIDED, PX4 OFFBOARD
    HOLD = "stands still by itself"  # ArduCopter BRAKE, PX4 Hold
    PILOT = "the sticks fly, position held at centre"  # ArduCopter LOITER, PX4 Position
    RTL = "returns to launch"
    LAND = "lands"
    OTHER = "any other"


class Landed(Enum):
    """Whether the vehicle flies, as it says."""

    UNKNOWN = auto()
    ON_GROUND = auto()
    TAKING_OFF = auto()
    IN_AIR = auto()
    LANDING = auto()


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The autopilot lives, and how it is."""

    time_s: float
    autopilot: Autopilot
    is_multicopter: bool
    mode: FlightMode
    mode_name: str
    is_armed: bool
    has_failsafe: bool  # it says CRITICAL or EMERGENCY


@dataclass(frozen=True, slots=True)
class Attitude:
    """Aerospace angles, yaw from north to east, and the yaw rate about the vertical."""

    time_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class LocalState:
    """Position in the autopilot's local frame, and velocity."""

    time_s: float
    pos_ned_m: Vector
    velocity_ned_mps: Vector


@dataclass(frozen=True, slots=True)
class HeightReading:
    """Height above the place of take-off."""

    time_s: float
    height_m: float


@dataclass(frozen=True, slots=True)
class GlobalPosition:
    """Where the vehicle is on the globe; altitude above mean sea level."""

    time_s: float
    lat_deg: float
    lon_deg: float
    amsl_m: float


@dataclass(frozen=True, slots=True)
class LandedReading:
    """Whether the vehicle flies."""

    time_s: float
    landed: Landed


class Direction(Enum):
    """Where a rangefinder looks."""

    FORWARD = auto()
    DOWN = auto()


@dataclass(frozen=True, slots=True)
class RangeReading:
    """A rangefinder's distance, within its own limits."""

    time_s: float
    direction: Direction
    distance_m: float


@dataclass(frozen=True, slots=True)
class RcChannels:
    """Pulse widths of the pilot's channels, the first one first; 0 where there is none. Empty: no receiver."""

    time_s: float
    pwm_us: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the autopilot."""

    name: str
    value: float


@dataclass(frozen=True, slots=True)
class Battery:
    """What is left of the charge, per cent."""

    remaining_pct: int


@dataclass(frozen=True, slots=True)
class SetpointInForce:
    """The velocity that the autopilot is steering by: the only sign that it has taken ours."""

    time_s: float
    velocity_ned_mps: Vector


@dataclass(frozen=True, slots=True)
class AutopilotText:
    """A line that the autopilot tells its operator."""

    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class ModeAnswer:
    """The autopilot's answer to a request for a mode; the heartbeat alone says whether it changed."""

    is_accepted: bool


@dataclass(frozen=True, slots=True)
class GimbalAttitude:
    """Where the camera on the gimbal looks, by the horizon; the yaw is from north, or from the vehicle's nose."""

    time_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    is_yaw_on_earth: bool


@dataclass(frozen=True, slots=True)
class GimbalManager:
    """What a gimbal can do: its ends, low and high, and whether it can keep its yaw while the vehicle turns."""

    pitch_range_rad: tuple[float, float]
    yaw_range_rad: tuple[float, float] | None  # from the nose; None: it turns all round
    can_lock_yaw: bool


class Holder(Enum):
    """Who has the primary control of the gimbal."""

    NOBODY = auto()
    US = auto()
    OTHER = auto()


@dataclass(frozen=True, slots=True)
class GimbalControl:
    """The gimbal manager says who controls it."""

    time_s: float
    holder: Holder


@dataclass(frozen=True, slots=True)
class Rebooted:
    """The autopilot's clock went back: it forgot what it was asked for."""

    time_s: float


LinkEvent = (
    Heartbeat
    | Attitude
    | LocalState
    | HeightReading
    | GlobalPosition
    | LandedReading
    | RangeReading
    | RcChannels
    | Parameter
    | Battery
    | SetpointInForce
    | AutopilotText
    | ModeAnswer
    | GimbalAttitude
    | GimbalManager
    | GimbalControl
    | Rebooted
)


# ------------------------------------------------------------------------------------- operator -> the loop
@dataclass(frozen=True, slots=True)
class Select:
    """Track what is in this box, px of the frame; None: a box in the middle of the frame.

    `is_point`: the box surrounds the point that was meant, as far as it could have been missed; what is there tells the
    size.
    """

    box: Box | None
    is_point: bool = False


@dataclass(frozen=True, slots=True)
class Deselect:
    """Track nothing."""


@dataclass(frozen=True, slots=True)
class Engage:
    """Follow the tracked target; confirms, too, that a target found again is the right one."""


@dataclass(frozen=True, slots=True)
class Disengage:
    """Stop following."""


OperatorCommand = Select | Deselect | Engage | Disengage


# -------------------------------------------------------------------------------------------- the controller
class Severity(IntEnum):
    """As MAV_SEVERITY."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True, slots=True)
class Text:
    """A line for the operator: at most 50 characters fit into one status text."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class ControlInput:
    """All that a step of the controller depends on: same inputs, same outputs."""

    now_s: float
    track: TrackSample | None  # the newest there is, new or not
    events: tuple[LinkEvent, ...] = ()  # since the last step
    commands: tuple[OperatorCommand, ...] = ()  # since the last step
    is_sent: bool = True  # whether the port has taken what the last step wanted to send


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A velocity and a yaw rate that guidance wishes; only `safety.limit` makes one of it that may be sent."""

    velocity_ned_mps: Vector
    yaw_rate_radps: float


ZERO = Setpoint((0.0, 0.0, 0.0), 0.0)


# ----------------------------------------------------------------------------- the loop -> gimbal and autopilot
class Claim(Enum):
    """What to ask of the gimbal manager."""

    TAKE = auto()
    RELEASE = auto()


@dataclass(frozen=True, slots=True)
class GimbalAim:
    """Where the camera is to look, by the horizon: pitch upwards, yaw from north or from the vehicle's nose."""

    pitch_rad: float
    yaw_rad: float
    is_yaw_on_earth: bool


@dataclass(frozen=True, slots=True)
class GimbalOrder:
    """For the gimbal manager, now; None where nothing is."""

    claim: Claim | None
    aim: GimbalAim | None


@dataclass(frozen=True, slots=True)
class LandingTarget:
    """Where a target below was seen, for the autopilot's own precision landing; its mode decides what comes of it.

    ray_frd : unit vector towards it, in the body's axes when the frame was exposed.
    distance_m : along the ray; None where no height is known.
    place_ned_m : in the autopilot's local frame; None where the vehicle's own is not known.
    size_rad : of its box, across and down the picture.
    """

    time_s: float
    ray_frd: Vector
    distance_m: float | None
    place_ned_m: Vector | None
    size_rad: tuple[float, float]
