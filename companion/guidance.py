"""The law: from where the target is to the velocity and yaw rate that are wished; no limits, no modes, no clock.

`spotlight` turns the nose only, `follow` holds the horizontal range as well, `overhead` keeps above the target.
Deviation from the design: `follow` moves along the line of sight, not along the nose: the range changes along that
line alone, and backing off then leads away from the target wherever the nose points.
"""

import math
from dataclasses import dataclass
from enum import Enum

from companion.camera_model import CameraModel, wrapped
from companion.config import FollowConfig
from companion.target import SIZE_TAU_S, TargetEstimate
from companion.types import ZERO, Attitude, LocalState, Setpoint

MAX_PREDICTION_S = 0.5  # what was seen longer ago moves and turns nothing
MAX_APPROACH_AZIMUTH_RAD = math.radians(30.0)  # beyond: turn first
MIN_TIME_TO_CONTACT_S = 2.5
MAX_HEIGHT_SHARE = 0.7  # of the box in the frame
MAX_FOOT_SHARE = 0.9  # of the box's lower edge, down a frame taken at level attitude
MAX_FOOT_DEPRESSION_RAD = math.radians(80.0)  # the same for a camera so steep that its frame reaches past the nadir
BACK_OFF_MPS = 1.5
NOTED_EXCESS_MPS = 1.0  # of a wish; less is not worth a word
HEAD_RESERVE_RAD = math.radians(3.0)  # of the frame above the target's box
LEAN_MPS2_PER_RAD = 0.5 * 9.81  # half of what leaning by an angle gives: the rest is for wind and drag


class Caution(Enum):
    """Why guidance wishes less than the law says; the values are for the operator."""

    LEANING = "leaning, keeping the target in view"
    TURN_FIRST = "target aside, turning first"
    RANGE_CONFLICT = "range sources disagree, no approach"
    RANGE_UNKNOWN = "no range, keeping the size"
    TOO_CLOSE = "too close, backing off"
    CLOSING_FAST = "closing fast, backing off"
    TOO_OLD = "target seen too long ago"


@dataclass(frozen=True, slots=True)
class Aim:
    """What to keep, taken at engagement: horizontal range in m (None: the size alone) and height of the box."""

    range_m: float | None
    height_px: float
    height_m: float | None  # of the vehicle
    depression_rad: float
    is_over_ground: bool = False  # whether a rangefinder said that height


@dataclass(frozen=True, slots=True)
class Moving:
    """Which of the dead zones has been left: it is entered again at half its width."""

    yaw: bool = False
    range: bool = False


@dataclass(frozen=True, slots=True)
class Guided:
    """What guidance wishes, and why not more."""

    wish: Setpoint
    moving: Moving
    cautions: tuple[Caution, ...] = ()


def turn(
    target: TargetEstimate, attitude: Attitude, mount_yaw_rad: float, now_s: float, moving: Moving, follow: FollowConfig
) -> tuple[float, bool]:
    """Yaw rate in rad/s that brings the boresight to the target, and whether the dead zone is left.

    The error is the target's bearing on earth, predicted to now, less the heading now: the vehicle's own turning
    is not in the delayed loop. A prediction is worth nothing after 0.5 s: the rate is 0 then.
    """
    if _is_too_old(target, now_s):
        return 0.0, False
    bearing_rad = target.bearing_at(now_s, follow.yaw_feed_forward)
    error_rad = wrapped(bearing_rad - attitude.yaw_rad - mount_yaw_rad)
    zone_rad = math.radians(follow.yaw_dead_zone_deg) * (0.5 if moving.yaw else 1.0)
    is_moving = abs(error_rad) > zone_rad
    rate_radps = follow.yaw_feed_forward * target.bearing.rate
    return rate_radps + (follow.yaw_gain_per_s * error_rad if is_moving else 0.0), is_moving


def spotlight(
    target: TargetEstimate, attitude: Attitude, mount_yaw_rad: float, now_s: float, moving: Moving, follow: FollowConfig
) -> Guided:
    """Turn the nose, stay in place."""
    yaw_rate_radps, is_turning = turn(target, attitude, mount_yaw_rad, now_s, moving, follow)
    return Guided(Setpoint((0.0, 0.0, 0.0), yaw_rate_radps), Moving(yaw=is_turning))


def follow_target(
    target: TargetEstimate,
    aim: Aim,
    attitude: Attitude,
    local: LocalState,
    camera: CameraModel,
    now_s: float,
    moving: Moving,
    follow: FollowConfig,
) -> Guided:
    """Turn the nose and hold the horizontal range along the line of sight; height as configured."""
    if _is_too_old(target, now_s):
        return Guided(ZERO, Moving(), (Caution.TOO_OLD,))
    mount_yaw_rad = camera.mount_rpy_rad[2]
    yaw_rate_radps, is_turning = turn(target, attitude, mount_yaw_rad, now_s, moving, follow)
    bearing_rad = target.bearing_at(now_s, follow.yaw_feed_forward)
    ahead = math.cos(bearing_rad), math.sin(bearing_rad)
    azimuth_rad = wrapped(bearing_rad - attitude.yaw_rad - mount_yaw_rad)
    cautions: list[Caution] = []

    error_m, scale_m = _range_error(target, aim, local, ahead, now_s, follow)
    if target.fix is None or aim.range_m is None:
        cautions.append(Caution.RANGE_UNKNOWN)
    zone_m = follow.size_dead_zone_share * scale_m * (0.5 if moving.range else 1.0)
    is_ranging = abs(error_m) > zone_m
    gain_per_s = follow.approach_gain_per_s if error_m > 0 else follow.retreat_gain_per_s
    speed_mps = gain_per_s * error_m if is_ranging else 0.0
    velocity_ne = target.velocity_ne_mps
    if velocity_ne is not None and aim.range_m is not None:
        speed_mps += follow.speed_feed_forward * (velocity_ne[0] * ahead[0] + velocity_ne[1] * ahead[1])

    if speed_mps > 0:
        if abs(azimuth_rad) > MAX_APPROACH_AZIMUTH_RAD:
            cautions.append(Caution.TURN_FIRST)
            speed_mps = 0.0
        speed_mps *= math.cos(azimuth_rad)
    if target.fix is not None and target.fix.is_conflicting:
        cautions.append(Caution.RANGE_CONFLICT)
        speed_mps = min(speed_mps, 0.0)
    if _is_too_close(target, camera):
        cautions.append(Caution.TOO_CLOSE)
        speed_mps = min(speed_mps, -BACK_OFF_MPS)
    elif target.log_height.rate > 1 / (MIN_TIME_TO_CONTACT_S + 2 * SIZE_TAU_S):  # the filtered rate is so old
        cautions.append(Caution.CLOSING_FAST)
        speed_mps = min(speed_mps, -BACK_OFF_MPS)

    down_mps = 0.0
    if follow.vertical_gain_per_s and target.fix is not None:
        # how much too high the vehicle is for the depression it had at engagement
        rise_m = target.fix.range_m * (math.tan(target.seen.depression_rad) - math.tan(aim.depression_rad))
        down_mps = follow.vertical_gain_per_s * rise_m
    if not {Caution.RANGE_CONFLICT, Caution.TOO_CLOSE, Caution.CLOSING_FAST}.isdisjoint(cautions):
        down_mps = min(down_mps, 0.0)  # sinking is an approach, too
    wish = Setpoint((speed_mps * ahead[0], speed_mps * ahead[1], down_mps), yaw_rate_radps)
    return Guided(wish, Moving(is_turning, is_ranging), tuple(cautions))


def kept_in_view(
    guided: Guided,
    target: TargetEstimate,
    before_ne_mps: tuple[float, float],
    now_s: float,
    dt_s: float,
    follow: FollowConfig,
) -> Guided:
    """The wish with a speed ahead that grows only while there is room in the frame above the target.

    A vehicle leans forward to gain speed and to keep it, and a fixed camera with it: a target that leaves the frame is
    lost, and braking for it and catching up again would go on for ever.

    Parameters
    ----------
    before_ne_mps : the last setpoint's. dt_s : since then.
    """
    north_mps, east_mps, down_mps = guided.wish.velocity_ned_mps
    bearing_rad = target.bearing_at(now_s, follow.yaw_feed_forward)
    ahead = math.cos(bearing_rad), math.sin(bearing_rad)
    along_mps = north_mps * ahead[0] + east_mps * ahead[1]
    before_mps = before_ne_mps[0] * ahead[0] + before_ne_mps[1] * ahead[1]
    gain_mps = LEAN_MPS2_PER_RAD * (target.seen.head_room_rad - HEAD_RESERVE_RAD) * dt_s
    excess_mps = along_mps - max(before_mps + gain_mps, 0.0)
    if along_mps <= 0 or excess_mps <= 0:
        return guided
    wish = Setpoint(
        (north_mps - excess_mps * ahead[0], east_mps - excess_mps * ahead[1], down_mps), guided.wish.yaw_rate_radps
    )
    cautions = (*guided.cautions, Caution.LEANING) if excess_mps > NOTED_EXCESS_MPS else guided.cautions
    return Guided(wish, guided.moving, cautions)


def overhead(
    target: TargetEstimate,
    aim: Aim,
    local: LocalState,
    height_m: float,
    now_s: float,
    moving: Moving,
    follow: FollowConfig,
) -> Guided:
    """Stay above the target; the heading is held, the height as configured."""
    if _is_too_old(target, now_s):
        return Guided(ZERO, Moving(), (Caution.TOO_OLD,))
    place = target.place_ne_m(now_s)
    if place is None:
        return Guided(ZERO, Moving(), (Caution.RANGE_UNKNOWN,))
    gap_s = now_s - local.time_s
    off_m = [place[k] - (local.pos_ned_m[k] + local.velocity_ned_mps[k] * gap_s) for k in (0, 1)]
    zone_m = follow.size_dead_zone_share * height_m * (0.5 if moving.range else 1.0)
    is_ranging = math.hypot(*off_m) > zone_m
    velocity_ne = target.velocity_ne_mps or (0.0, 0.0)
    north_mps, east_mps = (
        (follow.approach_gain_per_s * off if is_ranging else 0.0) + follow.speed_feed_forward * speed
        for off, speed in zip(off_m, velocity_ne, strict=True)
    )
    down_mps = follow.vertical_gain_per_s * (height_m - aim.height_m) if aim.height_m is not None else 0.0
    return Guided(Setpoint((north_mps, east_mps, down_mps), 0.0), Moving(range=is_ranging))


def _is_too_old(target: TargetEstimate, now_s: float) -> bool:
    return now_s - target.seen.time_s > MAX_PREDICTION_S + 1e-9  # a step of the loop may fall on the limit


def _range_error(
    target: TargetEstimate,
    aim: Aim,
    local: LocalState,
    ahead: tuple[float, float],
    now_s: float,
    follow: FollowConfig,
) -> tuple[float, float]:
    """How much too far away the target is along the line of sight, and the range it is measured by, in m."""
    if target.fix is None or aim.range_m is None:
        scale_m = aim.range_m or follow.nominal_range_m
        error_m = scale_m * (math.log(aim.height_px) - target.log_height.value)
        return error_m if target.seen.is_size_valid else min(error_m, 0.0), scale_m  # cut off, it only looks smaller
    place = target.place_ne_m(now_s)
    if place is None:
        return target.fix.range_m - aim.range_m, aim.range_m
    gap_s = now_s - local.time_s
    north_m, east_m = (local.pos_ned_m[k] + local.velocity_ned_mps[k] * gap_s for k in (0, 1))
    return (place[0] - north_m) * ahead[0] + (place[1] - east_m) * ahead[1] - aim.range_m, aim.range_m


def _is_too_close(target: TargetEstimate, camera: CameraModel) -> bool:
    """Whether the box is too high in the frame, or its foot too low in a frame taken at level attitude.

    The attitude is taken out, because braking raises the nose and lowers every foot: backing off would feed itself.
    """
    box, height_px = target.seen.box, camera.size_hw[0]
    if box.h > MAX_HEIGHT_SHARE * height_px:
        return True
    below_rad = math.atan((MAX_FOOT_SHARE - 0.5) * height_px / camera.focal_px)
    lowest_rad = min(-camera.mount_rpy_rad[1] + below_rad, MAX_FOOT_DEPRESSION_RAD)
    return target.seen.foot_depression_rad > lowest_rad
