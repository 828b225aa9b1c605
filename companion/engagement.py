"""When following may begin, and why it may not or has ended: all reasons, as data."""

from enum import Enum

from companion.config import MIN_RANGE_M, Config
from companion.modes import Mode
from companion.target import MIN_BOX_PX, TargetEstimate, is_speck
from companion.types import FlightMode, Selection, TrackSample
from companion.vehicle_state import VehicleState

MAX_CLIMB_AT_ENGAGE_MPS = 0.7  # faster is still a take-off or a landing
MAX_LANDED_AGE_S = 3.0  # of the word that it flies: six messages at the rate that is asked for


class Reason(Enum):
    """Why an engagement is refused or has ended, or why the vehicle stands; the values are for the operator."""

    NO_TARGET = "no target"
    TARGET_UNSURE = "target not sure"
    TARGET_SMALL = f"target smaller than {MIN_BOX_PX:g} px"
    LOW_CONFIDENCE = "confidence too low"
    NO_HEARTBEAT = "no autopilot"
    UNSUPPORTED_VEHICLE = "not a multicopter"
    NOT_ARMED = "not armed"
    NOT_AIRBORNE = "not airborne"
    CHANGING_HEIGHT = "still climbing or sinking"
    WRONG_MODE = "flight mode is not GUIDED/OFFBOARD"
    RESUME_GUARD = "PX4 may have left OFFBOARD by failsafe: select Hold first"
    NO_POSITION = "no position"
    NO_ATTITUDE = "attitude too old"
    FAILSAFE = "autopilot failsafe"
    STICKS = "sticks moved"
    TOO_LOW = "below limits.floor_m"
    TOO_HIGH = "above limits.ceiling_m"
    RANGE_UNKNOWN = "no range to the target"
    RANGE_CONFLICT = "range sources disagree"
    TOO_NEAR = "target nearer than 3 m"
    LEAVING = "still leaving"
    MODE_LEFT = "flight mode left"
    DISARMED = "disarmed"
    LANDED = "landed"
    REBOOTED = "autopilot restarted"
    LINK_SILENT = "autopilot silent"
    STALLED = "control loop stalled"
    NOT_OBEYED = "autopilot stands though told to move"
    OPERATOR = "operator"
    DESELECTED = "target deselected"
    LOST_TOO_LONG = "target lost too long"
    NOT_CONFIRMED = "target not confirmed"
    OFFBOARD_NOT_SELECTED = "OFFBOARD not selected in time"
    SHUTDOWN = "shutting down"


def refusals(
    mode: Mode,
    selection: Selection,
    sample: TrackSample | None,
    target: TargetEstimate | None,
    vehicle: VehicleState,
    config: Config,
    now_s: float,
    *,
    is_stick_moved: bool,
    has_resume_guard: bool,
) -> tuple[Reason, ...]:
    """All reasons against an engagement now; none: it may begin.

    Parameters
    ----------
    target : None, too, where the estimate is too old to steer by.
    """
    limits, heartbeat = config.limits, vehicle.heartbeat
    local, height_m = vehicle.fresh_local(now_s), vehicle.height_m(now_s)
    is_seen = mode in {Mode.TRACKING, Mode.READY, Mode.AWAITING, Mode.FOLLOWING}
    confidence = sample.confidence if sample is not None else 0.0
    is_small = sample is not None and sample.is_measured and sample.box is not None and is_speck(sample.box)
    says_it_flies = vehicle.landed is not None and now_s - vehicle.landed.time_s <= MAX_LANDED_AGE_S
    is_above, is_behind = config.follow.mode == "overhead", config.follow.mode == "follow"
    fix = target.fix if target is not None else None
    has_target, is_known = selection.box is not None, heartbeat is not None
    checks = (
        (not has_target, Reason.NO_TARGET),
        (has_target and not is_seen, Reason.TARGET_UNSURE),
        (is_small, Reason.TARGET_SMALL),
        (is_seen and not confidence >= config.engage.min_confidence, Reason.LOW_CONFIDENCE),  # nan refuses
        (not vehicle.is_alive(now_s), Reason.NO_HEARTBEAT),
        (heartbeat is not None and not heartbeat.is_multicopter, Reason.UNSUPPORTED_VEHICLE),
        (heartbeat is not None and not heartbeat.is_armed, Reason.NOT_ARMED),
        (is_known and not (says_it_flies and vehicle.is_flying()), Reason.NOT_AIRBORNE),
        (local is not None and abs(local.velocity_ned_mps[2]) > MAX_CLIMB_AT_ENGAGE_MPS, Reason.CHANGING_HEIGHT),
        (heartbeat is not None and heartbeat.mode is not FlightMode.EXTERNAL, Reason.WRONG_MODE),
        (has_resume_guard, Reason.RESUME_GUARD),
        (local is None or height_m is None, Reason.NO_POSITION),
        # no estimate without an attitude at the frame's time
        (vehicle.fresh_attitude(now_s) is None or (is_seen and target is None), Reason.NO_ATTITUDE),
        (heartbeat is not None and heartbeat.has_failsafe, Reason.FAILSAFE),
        (is_stick_moved, Reason.STICKS),
        (height_m is not None and height_m < limits.floor_m, Reason.TOO_LOW),
        (height_m is not None and height_m > limits.ceiling_m, Reason.TOO_HIGH),
        (is_above and target is not None and fix is None, Reason.RANGE_UNKNOWN),
        # what engagement takes for the range to keep
        (fix is not None and is_behind and fix.is_conflicting, Reason.RANGE_CONFLICT),
        (fix is not None and is_behind and fix.range_m < MIN_RANGE_M, Reason.TOO_NEAR),
        (mode is Mode.LEAVING, Reason.LEAVING),
    )
    return tuple(reason for is_against, reason in checks if is_against)
