"""Places on the globe by construction: a vehicle and a target a known way apart."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo_place import (
    HEADING_SIGMA_RAD,
    MAX_PLACE_AGE_S,
    METRES_PER_DEG,
    VEHICLE_HEIGHT_SIGMA_M,
    VEHICLE_SIGMA_M,
    GeoPlace,
    geo_place,
)
from companion.target import Measurement, RangeFix, Rate, TargetEstimate
from companion.types import Direction, GlobalPosition, LocalState, RangeReading
from companion.vehicle_state import VehicleState
from mscf import Box

NOW_S = 50.0
HEIGHT_M = 14.0
HOVERING = LocalState(NOW_S, (30.0, -20.0, -HEIGHT_M), (0.0, 0.0, 0.0))
VEHICLE = VehicleState(local=HOVERING, place=GlobalPosition(NOW_S, 47.0, 8.0, 514.0))


def target_at(offset_ne_m: tuple[float, float], sigma_m: float = 2.0, vehicle: LocalState = HOVERING) -> TargetEstimate:
    """A target on the ground, so far from a vehicle at `HEIGHT_M`, seen now."""
    range_m, bearing_rad = math.hypot(*offset_ne_m), math.atan2(offset_ne_m[1], offset_ne_m[0])
    depression_rad = math.atan2(HEIGHT_M, range_m)
    ray = np.array([*offset_ne_m, HEIGHT_M])
    seen = Measurement(
        NOW_S,
        Box(0, 0, 20, 20),
        bearing_rad=bearing_rad,
        azimuth_rad=bearing_rad,
        depression_rad=depression_rad,
        foot_depression_rad=depression_rad,
        head_room_rad=0.2,
        ray_ned=ray / np.linalg.norm(ray),
        is_size_valid=True,
        off_nose_rad=0.0,
    )
    north, east = (Rate(place + way, 1.5) for place, way in zip(vehicle.pos_ned_m, offset_ne_m, strict=False))
    fix = RangeFix(range_m, is_conflicting=False, sigma_m=sigma_m)
    return TargetEstimate(seen, Rate(bearing_rad), Rate(3.0), fix, north, east)


def offset_ne_m(place: GeoPlace | None, lat_deg: float = 47.0) -> tuple[float, float]:
    """From the vehicle to a place."""
    assert place is not None
    east_m = (place.lon_deg - 8) * METRES_PER_DEG * math.cos(math.radians(lat_deg))
    return (place.lat_deg - lat_deg) * METRES_PER_DEG, east_m


@pytest.mark.parametrize("lat_deg", [0.0, 47.0, -33.0, 70.0])
@pytest.mark.parametrize("way_ne_m", [(20.0, 0.0), (0.0, 20.0), (-12.0, -30.0), (3.0, -4.0)])
def test_a_target_is_as_far_from_the_vehicle_on_the_globe_as_in_the_local_frame(
    way_ne_m: tuple[float, float], lat_deg: float
) -> None:
    vehicle = replace(VEHICLE, place=GlobalPosition(NOW_S, lat_deg, 8.0, 514.0))
    place = geo_place(target_at(way_ne_m), vehicle, NOW_S)
    assert offset_ne_m(place, lat_deg) == pytest.approx(way_ne_m, abs=1e-5)
    assert place is not None
    assert place.amsl_m == pytest.approx(514 - HEIGHT_M)
    assert place.distance_m == pytest.approx(math.hypot(*way_ne_m, HEIGHT_M))
    assert place.bearing_rad == pytest.approx(math.atan2(way_ne_m[1], way_ne_m[0]))
    assert place.velocity_ne_mps == (1.5, 1.5)


def test_a_late_place_on_the_globe_is_that_of_where_the_vehicle_was_then() -> None:
    """It flew to the north and east and rose since it said where on the globe it is."""
    local = replace(HOVERING, velocity_ned_mps=(4.0, 3.0, -0.5))
    vehicle = VehicleState(local=local, place=GlobalPosition(NOW_S - 0.4, 47.0, 8.0, 514.0))
    place = geo_place(target_at((20.0, 5.0)), vehicle, NOW_S)
    assert offset_ne_m(place) == pytest.approx((20.0 + 1.6, 5.0 + 1.2), abs=1e-5)
    assert place is not None
    assert place.amsl_m == pytest.approx(514 + 0.2 - HEIGHT_M)


@pytest.mark.parametrize(
    ("vehicle", "is_known"),
    [
        (VEHICLE, True),
        (replace(VEHICLE, place=None), False),
        (replace(VEHICLE, local=None), False),
        (replace(VEHICLE, local=replace(HOVERING, time_s=NOW_S - 0.6)), False),
        (replace(VEHICLE, place=GlobalPosition(NOW_S - MAX_PLACE_AGE_S, 47.0, 8.0, 514.0)), True),
        (replace(VEHICLE, place=GlobalPosition(NOW_S - MAX_PLACE_AGE_S - 0.01, 47.0, 8.0, 514.0)), False),
    ],
)
def test_without_a_fresh_pose_of_the_vehicle_no_place_is_known(vehicle: VehicleState, *, is_known: bool) -> None:
    assert (geo_place(target_at((20.0, 0.0)), vehicle, NOW_S) is not None) == is_known


@pytest.mark.parametrize("unknown", [{"fix": None}, {"north": None}, {"east": None}])
def test_without_a_range_no_place_is_known(unknown: dict[str, None]) -> None:
    assert geo_place(replace(target_at((20.0, 0.0)), **unknown), VEHICLE, NOW_S) is None
    assert geo_place(target_at((20.0, 0.0), sigma_m=math.inf), VEHICLE, NOW_S) is None


def test_right_underneath_the_height_over_the_ground_is_the_distance() -> None:
    target = target_at((0.05, 0.0), sigma_m=0.3)
    place = geo_place(target, VEHICLE, NOW_S)
    assert place is not None
    assert (place.distance_m, place.amsl_m) == pytest.approx((HEIGHT_M, 514 - HEIGHT_M), abs=0.01)
    # a rangefinder that looks down knows better than the place of take-off
    low = replace(VEHICLE, down_range=RangeReading(NOW_S, Direction.DOWN, 9.0))
    place = geo_place(target, low, NOW_S)
    assert place is not None
    assert (place.distance_m, place.amsl_m) == pytest.approx((9.0, 505.0), abs=0.01)


def test_the_accuracy_is_made_of_range_heading_and_the_vehicles_own() -> None:
    exact = geo_place(target_at((20.0, 0.0), sigma_m=0.0), VEHICLE, NOW_S)
    assert exact is not None
    assert exact.horizontal_sigma_m == pytest.approx(math.hypot(20 * HEADING_SIGMA_RAD, VEHICLE_SIGMA_M))
    assert exact.vertical_sigma_m > VEHICLE_HEIGHT_SIGMA_M
    vague = geo_place(target_at((20.0, 0.0), sigma_m=30.0), VEHICLE, NOW_S)
    assert vague is not None
    assert vague.horizontal_sigma_m > 30
    assert vague.vertical_sigma_m > 30 * HEIGHT_M / 20
    assert vague.velocity_sigma_mps > exact.velocity_sigma_mps > 0
