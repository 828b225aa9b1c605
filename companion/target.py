"""Where the target is and how it moves, estimated from the box at frame time and the vehicle's state then."""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.camera_model import CameraModel, direction, ray_to, wrapped
from companion.types import Attitude, LocalState
from mscf import Box, Expected
from mscf.arrays import Real64

MIN_BOX_PX = 9.0  # geometric mean of a box's sides: of a smaller one the tracker cannot tell the size any more
BEARING_TAU_S = 0.3  # time constants of the filters
PLACE_TAU_S = 0.8
SIZE_TAU_S = 0.5
MAX_GAP_S = 0.7  # without a measurement, after which a filter starts anew with rate 0
MIN_DEPRESSION_RAD = math.radians(12.0)  # of the box's foot: below, a degree of attitude is a tenth of the range
MAX_SOURCE_RATIO = 1.4  # sources of range that disagree by more are in conflict
MAX_SPEED_MPS = 30.0  # of a target; more is an error of measurement
RELEARN_TAU_S = 4.0
MAX_HIDDEN_S = 3.0  # for which a hidden target is looked for where its motion would have taken it
_EDGE_PX = 1.5
_SIZE_LOG_SIGMA = 0.15  # of a range by size: the box's scale steps by two per cent and its target turns
HEIGHT_LOG_SIGMA = 0.05  # of the height over the target's ground
ATTITUDE_SIGMA_RAD = math.radians(1.0)
_FINDER_LOG_SIGMA = 0.05
_FINDER_CONE_RAD = math.radians(4.0)  # a forward rangefinder hits the target only where the nose points at it


def is_speck(box: Box) -> bool:
    """Whether a box is too small to be followed: it would stay where the target was, at a size that it never had."""
    return box.w * box.h < MIN_BOX_PX**2


@dataclass(frozen=True, slots=True)
class Rate:
    """A critically damped alpha-beta filter: a value and its rate, with one time constant."""

    value: float
    rate: float = 0.0

    def after(self, measured: float, dt_s: float, tau_s: float) -> "Rate":
        """Filter with a measurement `dt_s` later; the value takes a share, the rate another."""
        forget = math.exp(-dt_s / tau_s)
        predicted = self.value + self.rate * dt_s
        residual = measured - predicted
        return Rate(predicted + (1 - forget**2) * residual, self.rate + (1 - forget) ** 2 / dt_s * residual)


@dataclass(frozen=True, slots=True)
class RangeReference:
    """What makes a size a range: a slant range in m at which the box was `height_px` high."""

    slant_m: float
    height_px: float


@dataclass(frozen=True, slots=True)
class RangeFix:
    """Horizontal range, fused; `is_conflicting` where two sources disagree by more than 40 per cent.

    sigma_m : standard deviation of the range; infinite where it is not known.
    """

    range_m: float
    is_conflicting: bool
    sigma_m: float = math.inf


@dataclass(frozen=True, slots=True)
class Measurement:
    """What one frame and the vehicle's state at its time say; angles in rad.

    bearing_rad : on earth. azimuth_rad, depression_rad : in the level frame, of the box's middle.
    foot_depression_rad : of the middle of the edge that is lower on earth: a camera may hang upside down.
    head_room_rad : from the other edge up to the border of the frame: what the vehicle may still lean towards it.
    ray_ned : unit vector towards the middle.
    is_size_valid : whether the box lies in the frame, but for one edge at most.
    off_nose_rad : from the body's forward axis to the middle.
    """

    time_s: float
    box: Box
    bearing_rad: float
    azimuth_rad: float
    depression_rad: float
    foot_depression_rad: float
    head_room_rad: float
    ray_ned: Real64
    is_size_valid: bool
    off_nose_rad: float


def measure(camera: CameraModel, box: Box, attitude: Attitude, time_s: float) -> Measurement:
    """Directions of a box, whose edges lie half a pixel outside the centres of its pixels."""
    center_u = box.x + box.w / 2 - 0.5
    ray_frd = camera.ray_frd((center_u, box.y + box.h / 2 - 0.5))
    middle = direction(ray_frd, attitude)
    height, width = camera.size_hw

    def depression_rad(v: float) -> float:
        return direction(camera.ray_frd((center_u, v)), attitude).depression_rad

    # each edge of the box with the border of the frame that it is next to, the upper one on earth first
    (head_rad, border_rad), (foot_rad, _) = sorted(
        (depression_rad(v), depression_rad(border_v))
        for v, border_v in ((box.y - 0.5, -0.5), (box.y + box.h - 0.5, height - 0.5))
    )
    edges = (
        box.x <= _EDGE_PX,
        box.y <= _EDGE_PX,
        box.x + box.w >= width - _EDGE_PX,
        box.y + box.h >= height - _EDGE_PX,
    )
    flat = math.cos(middle.depression_rad)
    ray_ned = np.array(
        [
            flat * math.cos(middle.bearing_rad),
            flat * math.sin(middle.bearing_rad),
            math.sin(middle.depression_rad),
        ]
    )
    return Measurement(
        time_s,
        box,
        middle.bearing_rad,
        middle.azimuth_rad,
        middle.depression_rad,
        foot_rad,
        head_rad - border_rad,
        ray_ned,
        sum(edges) < 2,
        math.acos(min(max(float(ray_frd[0]), -1.0), 1.0)),
    )


def range_fix(
    seen: Measurement, height_m: float | None, reference: RangeReference | None, finder_m: float | None
) -> RangeFix | None:
    """Horizontal range from all sources that are valid, weighted by inverse variance; None without any.

    By size: slant range of the reference times its height over the box's. By depression: height over the
    tangent of the foot's depression, from 12 degrees. By a forward rangefinder, where the nose points there.
    """
    logs: list[tuple[float, float]] = []  # ln of the horizontal range, variance
    flat = math.cos(seen.depression_rad)
    if reference is not None and seen.is_size_valid and flat > 0.05:
        slant_m = reference.slant_m * reference.height_px / max(seen.box.h, 1.0)
        logs.append((math.log(slant_m * flat), _SIZE_LOG_SIGMA**2))
    foot = seen.foot_depression_rad
    if height_m is not None and height_m > 0.5 and MIN_DEPRESSION_RAD <= foot < math.radians(89.0):
        sigma = ATTITUDE_SIGMA_RAD / (math.sin(foot) * math.cos(foot))  # d ln(1/tan) / d angle
        logs.append((math.log(height_m / math.tan(foot)), sigma**2 + HEIGHT_LOG_SIGMA**2))
    if finder_m is not None and finder_m > 0 and seen.off_nose_rad < _FINDER_CONE_RAD:
        logs.append((math.log(finder_m * flat), _FINDER_LOG_SIGMA**2))
    if not logs:
        return None
    weights = [1 / variance for _, variance in logs]
    mean = sum(w * value for w, (value, _) in zip(weights, logs, strict=True)) / sum(weights)
    spread = max(value for value, _ in logs) - min(value for value, _ in logs)
    # sources that disagree are no better than half of what is between them, whatever each one claims
    log_sigma = max(1 / math.sqrt(sum(weights)), spread / 2)
    return RangeFix(math.exp(mean), spread > math.log(MAX_SOURCE_RATIO), math.exp(mean) * log_sigma)


def range_from_above(seen: Measurement, height_m: float | None) -> RangeFix | None:
    """Horizontal range of what a camera that looks down sees, on the ground `height_m` below; 0 right underneath."""
    down = float(seen.ray_ned[2])
    if height_m is None or height_m <= 0.5 or down < math.sin(MIN_DEPRESSION_RAD):
        return None
    range_m = height_m * math.hypot(float(seen.ray_ned[0]), float(seen.ray_ned[1])) / down
    # d range / d angle is height / down^2, also right underneath, where the range itself is 0
    sigma_m = math.hypot(range_m * HEIGHT_LOG_SIGMA, height_m / down**2 * ATTITUDE_SIGMA_RAD)
    return RangeFix(range_m, is_conflicting=False, sigma_m=sigma_m)


def relearned(reference: RangeReference, seen: Measurement, height_m: float | None, dt_s: float) -> RangeReference:
    """Reference that has moved towards what the depression says now.

    A car is 1.4 times as high in the picture from 30 degrees above as from 15 at the same range: what size and
    range were worth together at engagement is not what they are worth later. Sudden changes remain a conflict.
    Where the depression says nothing, the reference stays.
    """
    fix = range_fix(seen, height_m, None, None)
    if fix is None or not seen.is_size_valid:
        return reference
    slant_m = fix.range_m / max(math.cos(seen.depression_rad), 0.05)
    # after a loss what comes back may be another target: its size must not be learned at once
    share = 1 - math.exp(-min(max(dt_s, 0.0), MAX_GAP_S) / RELEARN_TAU_S)
    before, now = reference.slant_m * reference.height_px, slant_m * seen.box.h
    return RangeReference(before * (now / before) ** share, 1.0)


@dataclass(frozen=True, slots=True)
class TargetEstimate:
    """Filtered state of the target at the time of the last measured frame.

    bearing : rad on earth, unwrapped near the last one, and rad/s.
    log_height : ln of the box's height in px, and 1/s: the inverse of the time to contact.
    north, east : of the target in the vehicle's local frame, m and m/s; None where no range is known.
    """

    seen: Measurement
    bearing: Rate
    log_height: Rate
    fix: RangeFix | None
    north: Rate | None
    east: Rate | None

    @property
    def velocity_ne_mps(self) -> tuple[float, float] | None:
        """Of the target, over ground."""
        if self.north is None or self.east is None:
            return None
        return self.north.rate, self.east.rate

    @property
    def slant_m(self) -> float:
        """Distance along the line of sight; 0 where no range is known."""
        return self.fix.range_m / max(math.cos(self.seen.depression_rad), 0.05) if self.fix is not None else 0.0

    def bearing_at(self, time_s: float, share: float = 1.0) -> float:
        """Predicted bearing on earth, rad, with a share of its rate."""
        return wrapped(self.bearing.value + share * self.bearing.rate * (time_s - self.seen.time_s))

    def place_ne_m(self, time_s: float) -> tuple[float, float] | None:
        """Predicted place in the local frame."""
        if self.north is None or self.east is None:
            return None
        gap_s = time_s - self.seen.time_s
        return self.north.value + self.north.rate * gap_s, self.east.value + self.east.rate * gap_s


def height_of_middle_m(target: TargetEstimate) -> float:
    """How high the middle of the box lies over the place of its foot, m; 0 where no range is known."""
    if target.fix is None:
        return 0.0
    seen = target.seen
    return target.fix.range_m * (math.tan(seen.foot_depression_rad) - math.tan(seen.depression_rad))


def estimate(
    seen: Measurement, fix: RangeFix | None, local: LocalState | None, before: TargetEstimate | None
) -> TargetEstimate:
    """Estimate with a measurement taken in.

    Parameters
    ----------
    local : position of the vehicle, moved on to the frame's time by its velocity.
    before : the last estimate of the same target; too old or None: the filters start here.
    """
    place = _place(seen, fix, local)
    log_height = math.log(max(seen.box.h, 1.0))
    dt_s = seen.time_s - before.seen.time_s if before is not None else 0.0
    if before is None or not 0 < dt_s <= MAX_GAP_S:
        north, east = (Rate(place[0]), Rate(place[1])) if place is not None else (None, None)
        return TargetEstimate(seen, Rate(seen.bearing_rad), Rate(log_height), fix, north, east)
    turned = before.bearing.value + wrapped(seen.bearing_rad - before.bearing.value)
    bearing = before.bearing.after(turned, dt_s, BEARING_TAU_S)
    size = before.log_height.after(log_height, dt_s, SIZE_TAU_S)
    north = east = None
    if place is not None:
        north = _moved(before.north, place[0], dt_s)
        east = _moved(before.east, place[1], dt_s)
    return TargetEstimate(seen, bearing, size, fix, north, east)


def expected(
    target: TargetEstimate,
    camera: CameraModel,
    attitude: Attitude,
    local: LocalState | None,
    height_m: float | None,
    now_s: float,
) -> Expected | None:
    """Where the target should be in a frame taken now, and how large over its last size; None: behind the camera.

    Where the vehicle's place or height is not known, it is where it was seen last, turned on by its bearing's rate.
    """
    # a target that hides is assumed to go on for a while, then to have stopped
    until_s = min(now_s, target.seen.time_s + MAX_HIDDEN_S)
    place = target.place_ne_m(until_s)
    if place is not None and local is not None and height_m is not None:
        gap_s = now_s - local.time_s
        north_m, east_m = (local.pos_ned_m[k] + local.velocity_ned_mps[k] * gap_s for k in (0, 1))
        # its foot is there; its middle is as much higher as it was last
        ned = np.array([place[0] - north_m, place[1] - east_m, height_m - height_of_middle_m(target)])
        growth = target.slant_m / max(float(np.linalg.norm(ned)), 1.0)
    else:
        bearing_rad, depression_rad = target.bearing_at(until_s), target.seen.depression_rad
        flat = math.cos(depression_rad)
        growth = 1.0
        ned = np.array([flat * math.cos(bearing_rad), flat * math.sin(bearing_rad), math.sin(depression_rad)])
    xy = camera.pixel(ray_to(ned, attitude))
    return Expected((xy[0] + 0.5, xy[1] + 0.5), growth) if xy is not None else None


def _place(seen: Measurement, fix: RangeFix | None, local: LocalState | None) -> tuple[float, float] | None:
    if fix is None or local is None:
        return None
    gap_s = seen.time_s - local.time_s
    north_m, east_m = (local.pos_ned_m[k] + local.velocity_ned_mps[k] * gap_s for k in (0, 1))
    return (
        north_m + fix.range_m * math.cos(seen.bearing_rad),
        east_m + fix.range_m * math.sin(seen.bearing_rad),
    )


def _moved(before: Rate | None, place_m: float, dt_s: float) -> Rate:
    if before is None:
        return Rate(place_m)
    after = before.after(place_m, dt_s, PLACE_TAU_S)
    return replace(after, rate=min(max(after.rate, -MAX_SPEED_MPS), MAX_SPEED_MPS))
