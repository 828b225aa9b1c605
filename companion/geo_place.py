"""Where on the globe the target is, of what is known in the vehicle's local frame; values in, values out."""

import math
from dataclasses import dataclass

from companion.target import ATTITUDE_SIGMA_RAD, HEIGHT_LOG_SIGMA, PLACE_TAU_S, TargetEstimate
from companion.vehicle_state import VehicleState

# as the autopilot does not tell: what a position of its receiver is worth, and a heading of its compass
VEHICLE_SIGMA_M, VEHICLE_HEIGHT_SIGMA_M = 2.5, 5.0
HEADING_SIGMA_RAD = math.radians(3.0)
MAX_PLACE_AGE_S = 1.0  # of the vehicle's place on the globe, which comes five times a second
MAX_AMSL_M = 1e5  # the message carries no more than twenty times that
METRES_PER_DEG = 111_319.5  # of WGS 84's equator, as both autopilots reckon
_STEEP = 0.05  # cosine of the depression from which on a range says nothing of the height


@dataclass(frozen=True, slots=True)
class GeoPlace:
    """Where the target is on the globe, at the time of the last measured frame; sigmas are standard deviations.

    velocity_ne_mps : over ground; None where it is not known yet.
    bearing_rad : from the camera to the target, from north to the east.
    """

    lat_deg: float
    lon_deg: float
    amsl_m: float
    horizontal_sigma_m: float
    vertical_sigma_m: float
    velocity_ne_mps: tuple[float, float] | None
    velocity_sigma_mps: float
    distance_m: float
    bearing_rad: float


def geo_place(target: TargetEstimate, vehicle: VehicleState, now_s: float) -> GeoPlace | None:
    """The target's place on the globe; None where range, position or height of the vehicle are not known.

    The target is known in the autopilot's local frame, the vehicle in both frames: at the time of its place on the
    globe, the one is as far from the other on the globe as in the local frame.
    """
    place, local, fix, seen = vehicle.place, vehicle.fresh_local(now_s), target.fix, target.seen
    if place is None or local is None or fix is None or target.north is None or target.east is None:
        return None
    if now_s - place.time_s > MAX_PLACE_AGE_S or not math.isfinite(fix.sigma_m):
        return None
    gap_s = place.time_s - local.time_s
    there_m = (target.north.value, target.east.value)
    north_m, east_m = (there_m[k] - local.pos_ned_m[k] - gap_s * local.velocity_ned_mps[k] for k in (0, 1))
    flat = math.cos(seen.depression_rad)
    if flat >= _STEEP:
        below_m = fix.range_m * math.tan(seen.depression_rad)
        below_sigma_m = math.hypot(
            math.tan(seen.depression_rad) * fix.sigma_m, fix.range_m / flat**2 * ATTITUDE_SIGMA_RAD
        )
    else:
        height_m = vehicle.height_over_ground_m(now_s)
        if height_m is None:
            return None
        below_m, below_sigma_m = height_m, height_m * HEIGHT_LOG_SIGMA
    amsl_m = place.amsl_m - local.velocity_ned_mps[2] * (seen.time_s - place.time_s)
    aside_m = math.hypot(fix.sigma_m, fix.range_m * HEADING_SIGMA_RAD)
    lat_deg = place.lat_deg + north_m / METRES_PER_DEG
    lon_deg = place.lon_deg + east_m / METRES_PER_DEG / max(math.cos(math.radians(place.lat_deg)), 1e-6)
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and abs(amsl_m - below_m) < MAX_AMSL_M):
        return None
    return GeoPlace(
        lat_deg,
        lon_deg,
        amsl_m - below_m,
        math.hypot(aside_m, VEHICLE_SIGMA_M),
        math.hypot(below_sigma_m, VEHICLE_HEIGHT_SIGMA_M),
        target.velocity_ne_mps,
        # of an error of the place that comes and goes within the filter's time
        aside_m / PLACE_TAU_S,
        math.hypot(fix.range_m, below_m),
        seen.bearing_rad,
    )
