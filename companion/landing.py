"""The landing target: what a camera that looks down tells the autopilot's own precision landing."""

import math

from companion.camera_model import CameraModel, direction
from companion.target import Measurement
from companion.types import Attitude, LandingTarget, LocalState

MIN_DEPRESSION_RAD = math.radians(70.0)  # of the optical axis: a camera that looks down
MIN_HEIGHT_M = 0.3  # below, the camera's own place in the airframe is as far as the target


def landing_target(
    camera: CameraModel, seen: Measurement, attitude: Attitude, local: LocalState | None, height_m: float | None
) -> LandingTarget | None:
    """The measured target as the autopilot is told; None where the camera does not look down.

    Parameters
    ----------
    camera : as mounted when the frame was exposed.
    attitude : of the vehicle then.
    local : position of the vehicle, moved on to then by its velocity.
    height_m : over the target's ground.
    """
    height_px, width_px = camera.size_hw
    axis_frd = camera.ray_frd(((width_px - 1) / 2, (height_px - 1) / 2))
    if direction(axis_frd, attitude).depression_rad < MIN_DEPRESSION_RAD:
        return None
    box = seen.box
    ray_frd = camera.ray_frd((box.x + box.w / 2 - 0.5, box.y + box.h / 2 - 0.5))
    down = float(seen.ray_ned[2])
    distance_m = height_m / down if height_m is not None and height_m >= MIN_HEIGHT_M and down > 0 else None
    place_ned_m = None
    if distance_m is not None and local is not None:
        gap_s = seen.time_s - local.time_s
        north_m, east_m, down_m = (
            local.pos_ned_m[k] + local.velocity_ned_mps[k] * gap_s + distance_m * float(seen.ray_ned[k])
            for k in range(3)
        )
        place_ned_m = (north_m, east_m, down_m)
    return LandingTarget(
        seen.time_s,
        (float(ray_frd[0]), float(ray_frd[1]), float(ray_frd[2])),
        distance_m,
        place_ned_m,
        (math.atan(box.w / camera.focal_px), math.atan(box.h / camera.focal_px)),
    )
