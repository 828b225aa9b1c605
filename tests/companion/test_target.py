import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.camera_model import CameraModel, ray_to, wrapped
from companion.target import (
    MAX_GAP_S,
    MAX_SPEED_MPS,
    RELEARN_TAU_S,
    SIZE_TAU_S,
    Measurement,
    RangeFix,
    RangeReference,
    Rate,
    TargetEstimate,
    estimate,
    measure,
    range_fix,
    range_from_above,
    relearned,
)
from companion.types import Attitude, LocalState
from mscf import Box

steady = settings(max_examples=100, deadline=None, database=None, derandomize=True)

SIZE_HW = (720, 1280)
FOCAL_PX = 900.0
LEVEL = Attitude(0.0, 0.0, 0.0, 0.0, 0.0)
BOX = Box(600.0, 300.0, 80.0, 120.0)
STILL = LocalState(0.0, (0.0, 0.0, -20.0), (0.0, 0.0, 0.0))


def camera(pitch_deg: float = 0.0, roll_deg: float = 0.0, yaw_deg: float = 0.0) -> CameraModel:
    return CameraModel(SIZE_HW, FOCAL_PX, (), (math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg)))


def upright(range_m: float, height_m: float, bearing_rad: float, model: CameraModel, state: Attitude) -> Box:
    """Box of a person of 1.7 m who stands on the ground, `height_m` below the camera."""
    north, east = range_m * math.cos(bearing_rad), range_m * math.sin(bearing_rad)
    foot = model.pixel(ray_to(np.array([north, east, height_m]), state))
    head = model.pixel(ray_to(np.array([north, east, height_m - 1.7]), state))
    assert foot is not None
    assert head is not None
    top, bottom = sorted((foot[1], head[1]))
    width = 0.4 * (bottom - top)
    return Box((foot[0] + head[0]) / 2 - width / 2 + 0.5, top + 0.5, width, bottom - top)


def seen(box: Box = BOX, depression_deg: float = 0.0, time_s: float = 0.0, yaw_deg: float = 0.0) -> Measurement:
    """A box in the frame of a camera whose middle row has this depression."""
    return measure(camera(-depression_deg), box, Attitude(time_s, 0.0, 0.0, math.radians(yaw_deg), 0.0), time_s)


def centred(height_px: float = 120.0) -> Box:
    """A box around the middle of the frame."""
    return Box(640 - 0.2 * height_px, 360 - height_px / 2, 0.4 * height_px, height_px)


# ------------------------------------------------------------------------------------------- measuring
def test_a_box_around_the_frames_middle_is_straight_ahead_of_the_camera() -> None:
    found = seen(Box(540, 260, 200, 200), depression_deg=20, yaw_deg=100)
    angles_deg = np.degrees([found.azimuth_rad, found.depression_rad, found.bearing_rad, found.off_nose_rad])
    assert angles_deg == pytest.approx([0, 20, 100, 20])
    below_rad = math.atan(100 / FOCAL_PX)
    assert found.foot_depression_rad == pytest.approx(math.radians(20) + below_rad)


def test_the_ray_on_earth_is_a_unit_vector_towards_bearing_and_depression() -> None:
    found = seen(Box(900, 500, 40, 60), depression_deg=30, yaw_deg=-120)
    north, east, down = found.ray_ned
    assert np.linalg.norm(found.ray_ned) == pytest.approx(1)
    assert math.atan2(east, north) == pytest.approx(found.bearing_rad)
    assert math.asin(down) == pytest.approx(found.depression_rad)


@pytest.mark.parametrize("roll_deg", [0, 180])
def test_the_foot_is_the_edge_that_is_lower_on_earth_even_if_the_camera_hangs_upside_down(roll_deg: float) -> None:
    model = camera(-25, roll_deg)
    found = measure(model, upright(20, 10, 0.1, model, LEVEL), LEVEL, 0.0)
    assert found.foot_depression_rad == pytest.approx(math.atan2(10, 20), abs=0.002)


@pytest.mark.parametrize(
    ("box", "is_valid"),
    [
        (BOX, True),
        (Box(1, 300, 80, 120), True),
        (Box(600, -30, 80, 120), True),
        (Box(1220, 300, 80, 120), True),
        (Box(600, 640, 80, 120), True),
        (Box(1, 1, 80, 120), False),
        (Box(1.6, 1, 80, 120), True),
        (Box(1, 598.5, 80, 120), False),
        (Box(1, 598.4, 80, 120), True),
        (Box(1198.5, 1, 80, 120), False),
        (Box(600, 1, 80, 718), False),
        (Box(0, 0, 1280, 720), False),
    ],
)
def test_a_box_that_touches_two_edges_of_the_frame_has_no_size(box: Box, is_valid: bool) -> None:  # noqa: FBT001
    assert seen(box).is_size_valid is is_valid


# ------------------------------------------------------------------------------------------- range
@pytest.mark.parametrize(("height_px", "slant_m"), [(60, 40), (120, 20), (240, 10), (0.5, 2400), (1e-320, 2400)])
def test_by_size_the_range_is_that_of_the_reference_times_the_ratio_of_heights(
    height_px: float, slant_m: float
) -> None:
    fix = range_fix(seen(centred(height_px), depression_deg=30), None, RangeReference(20.0, 120.0), None)
    assert fix is not None
    assert fix.range_m == pytest.approx(slant_m * math.cos(math.radians(30)))
    assert not fix.is_conflicting


@steady
@given(
    st.floats(5, 40),
    st.floats(-3.1, 3.1),
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
)
def test_by_depression_the_range_to_the_foot_on_the_ground_is_right_at_every_attitude(
    range_m: float, bearing_rad: float, pitch_rad: float, roll_rad: float
) -> None:
    model, state = camera(-30), Attitude(0.0, roll_rad, pitch_rad, bearing_rad, 0.0)
    foot = model.pixel(
        ray_to(10 * np.array([range_m / 10 * math.cos(bearing_rad), range_m / 10 * math.sin(bearing_rad), 1.0]), state)
    )
    assert foot is not None
    fix = range_fix(measure(model, Box(foot[0] - 9.5, foot[1] - 59.5, 20, 60), state, 0.0), 10.0, None, None)
    assert fix is not None
    # an upright box seen by a rolled camera: of its lower edge only the middle is at the foot
    assert fix.range_m == pytest.approx(range_m, rel=1e-6)


@pytest.mark.parametrize(
    ("height_m", "depression_deg", "is_known"),
    [
        (10.0, 12.1, True),
        (10.0, 11.9, False),
        (10.0, -20, False),
        (10.0, 88.9, True),
        (10.0, 89.1, False),
        (0.5, 30, False),
        (-4.0, 30, False),
        (None, 30, False),
    ],
)
def test_depression_tells_the_range_from_twelve_degrees_and_some_height(
    height_m: float | None,
    depression_deg: float,
    is_known: bool,  # noqa: FBT001
) -> None:
    box = Box(630, 340, 20, 20)  # its foot is in the middle row
    fix = range_fix(seen(box, depression_deg), height_m, None, None)
    assert (fix is not None) is is_known


@pytest.mark.parametrize(
    ("model", "state", "is_known"),
    [
        (camera(), LEVEL, True),
        (camera(yaw_deg=3.9), LEVEL, True),
        (camera(yaw_deg=4.1), LEVEL, False),  # the target is beside the beam
        (camera(-4.1), LEVEL, False),  # below it
        (camera(-20), LEVEL, False),
        (camera(-20), Attitude(0.0, 0.0, math.radians(20), 0.0, 0.0), False),  # level with it, but the nose is up
        (camera(), Attitude(0.0, 0.3, math.radians(-20), 2.0, 0.0), True),  # the nose points at it, wherever that is
    ],
)
def test_a_forward_rangefinder_counts_only_where_the_nose_points_at_the_target(
    model: CameraModel,
    state: Attitude,
    is_known: bool,  # noqa: FBT001
) -> None:
    found = measure(model, centred(), state, 0.0)
    fix = range_fix(found, None, None, 15.0)
    assert (fix is not None) is is_known
    if fix is not None:
        assert fix.range_m == pytest.approx(15 * math.cos(found.depression_rad))


def test_a_rangefinder_without_a_distance_and_a_size_at_the_nadir_tell_nothing() -> None:
    assert range_fix(seen(centred()), None, None, 0.0) is None
    assert range_fix(seen(centred()), None, None, None) is None
    assert range_fix(seen(centred(), depression_deg=88), None, RangeReference(20.0, 120.0), None) is None
    assert range_fix(seen(Box(0, 0, 50, 720)), None, RangeReference(20.0, 120.0), None) is None


def test_sources_are_weighted_by_their_inverse_variance() -> None:
    found = seen(Box(630, 300, 20, 120), depression_deg=20)
    by_size = range_fix(found, None, RangeReference(25.0, 120.0), None)
    by_depression = range_fix(found, 8.0, None, None)
    both = range_fix(found, 8.0, RangeReference(25.0, 120.0), None)
    assert by_size is not None
    assert by_depression is not None
    assert both is not None
    foot_rad = found.foot_depression_rad
    variances = 0.15**2, 0.05**2 + (math.radians(1) / (math.sin(foot_rad) * math.cos(foot_rad))) ** 2
    size_share = (1 / variances[0]) / (1 / variances[0] + 1 / variances[1])
    expected = size_share * math.log(by_size.range_m) + (1 - size_share) * math.log(by_depression.range_m)
    assert math.log(both.range_m) == pytest.approx(expected)
    assert 0.1 < size_share < 0.3


def test_from_a_flatter_view_the_depression_weighs_less() -> None:
    shares = []
    for depression_deg in (14.0, 25.0, 45.0):
        found = seen(Box(630, 350, 20, 20), depression_deg)
        true_m = 10 / math.tan(found.foot_depression_rad)
        slant_m = 1.3 * true_m / math.cos(found.depression_rad)
        fix = range_fix(found, 10.0, RangeReference(slant_m, 20.0), None)
        assert fix is not None
        shares.append(math.log(fix.range_m / true_m) / math.log(1.3))
    assert shares == sorted(shares, reverse=True)
    assert 0 < shares[-1] < shares[0] < 0.5


@pytest.mark.parametrize(
    ("ratio", "is_conflicting"), [(1.39, False), (1.41, True), (1 / 1.39, False), (1 / 1.41, True)]
)
def test_sources_that_disagree_by_more_than_forty_per_cent_are_in_conflict(
    ratio: float,
    is_conflicting: bool,  # noqa: FBT001
) -> None:
    fix = range_fix(seen(centred()), None, RangeReference(20.0, 120.0), 20.0 * ratio)
    assert fix is not None
    assert fix.is_conflicting is is_conflicting
    assert min(1, ratio) * 20 < fix.range_m < max(1, ratio) * 20


# ------------------------------------------------------------------------------------------- the reference
def worth(reference: RangeReference) -> float:
    """Slant range times height, which is all that a reference is: m px."""
    return reference.slant_m * reference.height_px


def seen_on_the_ground(slant_m: float = 20.0, height_px: float = 60.0) -> tuple[Measurement, float]:
    """A box whose foot is 30 degrees below the horizon, and the height from which its middle is so far away."""
    found = seen(Box(630, 360 - height_px, 20, height_px), depression_deg=30)
    return found, slant_m * math.cos(found.depression_rad) * math.tan(found.foot_depression_rad)


def test_a_reference_moves_towards_what_the_depression_says_with_its_time_constant() -> None:
    found, height_m = seen_on_the_ground(20.0, 60.0)
    reference = RangeReference(30.0, 60.0)
    for _ in range(40):
        reference = relearned(reference, found, height_m, RELEARN_TAU_S / 40)
    assert worth(reference) == pytest.approx(1200 * 1.5 ** math.exp(-1))
    for _ in range(400):
        reference = relearned(reference, found, height_m, RELEARN_TAU_S / 40)
    assert worth(reference) == pytest.approx(1200, rel=1e-3)


def test_a_reference_stays_where_the_depression_says_nothing_or_the_size_is_cut_off() -> None:
    reference = RangeReference(30.0, 60.0)
    found, height_m = seen_on_the_ground()
    assert relearned(reference, found, None, 0.1) is reference
    assert relearned(reference, seen(centred()), height_m, 0.1) is reference
    assert relearned(reference, replace(found, is_size_valid=False), height_m, 0.1) is reference


@pytest.mark.parametrize("dt_s", [0.0, -5.0])
def test_no_time_teaches_nothing(dt_s: float) -> None:
    found, height_m = seen_on_the_ground()
    assert worth(relearned(RangeReference(30.0, 60.0), found, height_m, dt_s)) == pytest.approx(1800)


def test_after_a_loss_what_comes_back_is_not_learned_at_once() -> None:
    found, height_m = seen_on_the_ground()
    after = relearned(RangeReference(60.0, 60.0), found, height_m, 30.0)
    assert worth(after) == pytest.approx(worth(relearned(RangeReference(60.0, 60.0), found, height_m, MAX_GAP_S)))
    fix = range_fix(found, height_m, after, None)
    assert fix is not None
    assert fix.is_conflicting


# ------------------------------------------------------------------------------------------- from above
@pytest.mark.parametrize(("azimuth_deg", "off_deg"), [(0, 0), (0, 20), (90, 10), (-135, 30)])
def test_from_above_the_range_is_that_on_the_ground(azimuth_deg: float, off_deg: float) -> None:
    state, model = Attitude(0.0, 0.1, -0.2, 1.0, 0.0), camera(-90)
    off_m = 30 * math.tan(math.radians(off_deg))
    ned = np.array([off_m * math.cos(math.radians(azimuth_deg)), off_m * math.sin(math.radians(azimuth_deg)), 30.0])
    uv = model.pixel(ray_to(ned, state))
    assert uv is not None
    found = measure(model, Box(uv[0] - 9.5, uv[1] - 9.5, 20, 20), state, 0.0)
    fix = range_from_above(found, 30.0)
    assert fix is not None
    assert fix.range_m == pytest.approx(off_m, abs=1e-6)
    place = estimate(found, fix, STILL, None).place_ne_m(0.0)
    assert place == pytest.approx((ned[0], ned[1]), abs=1e-6)


def test_from_above_nothing_is_known_without_height_or_near_the_horizon() -> None:
    assert range_from_above(seen(centred(), 90), None) is None
    assert range_from_above(seen(centred(), 90), 0.5) is None
    assert range_from_above(seen(centred(), 11), 30.0) is None
    assert range_from_above(seen(centred(), 13), 30.0) is not None


# ------------------------------------------------------------------------------------------- the filter
@pytest.mark.parametrize("dt_s", [0.02, 0.1, 0.3])
def test_a_filter_follows_a_constant_rate_without_lag(dt_s: float) -> None:
    rate, tau_s = Rate(5.0), 0.3
    for k in range(1, round(10 * tau_s / dt_s) + 1):
        rate = rate.after(5 + 2 * k * dt_s, dt_s, tau_s)
    assert rate.value == pytest.approx(5 + 2 * k * dt_s, abs=0.01)
    assert rate.rate == pytest.approx(2.0, abs=0.01)


def test_a_filter_takes_its_time_constant_whatever_the_rate_of_frames() -> None:
    after_a_second = []
    for dt_s in (0.01, 0.05, 0.1):
        rate = Rate(0.0)
        for k in range(1, round(1 / dt_s) + 1):
            rate = rate.after(k * dt_s, dt_s, 0.5)
        after_a_second.append(rate.rate)
    assert max(after_a_second) - min(after_a_second) < 0.1
    # critically damped: 1 - (1 + t/tau) exp(-t/tau) of the rate
    assert after_a_second[0] == pytest.approx(1 - 3 * math.exp(-2), abs=0.02)


def test_a_filter_is_calmer_than_what_it_is_given(rng: np.random.Generator) -> None:
    noise, rate, values = rng.normal(0, 1, 4000), Rate(0.0), []
    for value in noise:
        rate = rate.after(float(value), 0.05, 0.5)
        values.append(rate.value)
    assert np.std(values[100:]) < 0.45


def test_a_filter_bears_two_measurements_at_almost_one_time() -> None:
    after = Rate(1.0, 2.0).after(7.0, 1e-12, 0.3)
    assert (after.value, after.rate) == pytest.approx((1.0, 2.0), abs=1e-9)


# ------------------------------------------------------------------------------------------- the estimate
def fed(times_s: list[float], bearings_deg: list[float], fix: RangeFix | None = None) -> TargetEstimate:
    """Estimate after boxes in the middle of the frame of a nose that points at these bearings."""
    target = None
    for time_s, bearing_deg in zip(times_s, bearings_deg, strict=True):
        local = LocalState(time_s, (0.0, 0.0, -20.0), (0.0, 0.0, 0.0))
        target = estimate(seen(centred(), 0, time_s, bearing_deg), fix, local, target)
    assert target is not None
    return target


def test_the_first_measurement_is_the_estimate_and_nothing_moves() -> None:
    target = fed([1.0], [30.0], RangeFix(10.0, is_conflicting=False))
    assert target.bearing.value == pytest.approx(math.radians(30))
    assert target.log_height.value == pytest.approx(math.log(120))
    assert (target.bearing.rate, target.log_height.rate) == (0, 0)
    assert target.place_ne_m(1.0) == pytest.approx((10 * math.cos(math.pi / 6), 5.0))
    assert target.velocity_ne_mps == (0, 0)


@pytest.mark.parametrize("turn_dps", [20.0, -20.0])
def test_a_bearing_that_turns_across_south_turns_on(turn_dps: float) -> None:
    times_s = [0.05 * k for k in range(60)]
    target = fed(times_s, [170 + turn_dps * time_s for time_s in times_s])
    assert math.degrees(target.bearing.rate) == pytest.approx(turn_dps, rel=0.01)
    ahead_rad = math.radians(170 + turn_dps * (times_s[-1] + 0.2))
    assert wrapped(target.bearing_at(times_s[-1] + 0.2) - ahead_rad) == pytest.approx(0, abs=0.002)
    half_rad = wrapped(target.bearing_at(times_s[-1] + 0.2, share=0.5) - target.bearing_at(times_s[-1]))
    assert math.degrees(half_rad) == pytest.approx(0.1 * turn_dps, rel=0.01)


@pytest.mark.parametrize(
    ("gap_s", "starts_anew"),
    [(0.05, False), (MAX_GAP_S - 0.01, False), (MAX_GAP_S + 0.01, True), (0.0, True), (-0.1, True)],
)
def test_after_a_gap_or_out_of_order_the_filters_start_anew(gap_s: float, starts_anew: bool) -> None:  # noqa: FBT001
    times_s = [0.05 * k for k in range(40)]
    fix = RangeFix(10.0, is_conflicting=False)
    target = fed([*times_s, times_s[-1] + gap_s], [*(20 * time_s for time_s in times_s), 90.0], fix)
    assert (target.bearing.rate == 0) is starts_anew
    assert target.north is not None
    assert (target.north.rate == 0) is starts_anew
    if starts_anew:
        assert math.degrees(target.bearing.value) == pytest.approx(90)


def test_a_box_that_grows_tells_the_time_to_contact_of_two_time_constants_ago() -> None:
    target = None
    for k in range(80):  # closing at 2 m/s from 20 m: at 12 m there are 6 s left
        range_m = 20 - 2 * 0.05 * k
        target = estimate(seen(centred(1530 / range_m), time_s=0.05 * k), None, None, target)
    assert target is not None
    assert 1 / target.log_height.rate == pytest.approx(range_m / 2 + 2 * SIZE_TAU_S, rel=0.02)


def test_the_velocity_of_a_walking_target_is_seen_from_a_vehicle_that_moves_and_turns() -> None:
    target, model = None, camera(-20)
    for k in range(140):
        time_s = k / 30
        state = Attitude(time_s, 0.1, -0.1, wrapped(3.0 + 0.1 * math.sin(time_s)), 0.0)
        vehicle = np.array([1.0 * time_s, -0.5 * time_s, -10.0])
        walker = np.array([-25.0 + 1.5 * time_s, -0.8 * time_s, 0.0])
        offset = walker - vehicle
        box = upright(math.hypot(*offset[:2]), 10.0, math.atan2(offset[1], offset[0]), model, state)
        found = measure(model, box, state, time_s)
        late = 0.04  # the position is older than the frame
        local = LocalState(time_s - late, (time_s - late, -0.5 * (time_s - late), -10.0), (1.0, -0.5, 0.0))
        target = estimate(found, range_fix(found, 10.0, None, None), local, target)
    assert target is not None
    assert target.velocity_ne_mps == pytest.approx((1.5, -0.8), abs=0.1)
    assert target.place_ne_m(time_s) == pytest.approx((walker[0], walker[1]), abs=0.3)
    ahead = target.place_ne_m(time_s + 1)
    assert ahead == pytest.approx((walker[0] + 1.5, walker[1] - 0.8), abs=0.4)


def test_a_position_is_moved_to_the_time_of_the_frame_by_its_velocity() -> None:
    local = LocalState(0.8, (100.0, 50.0, -20.0), (4.0, -2.0, 0.0))
    target = estimate(seen(centred(), time_s=1.0), RangeFix(10.0, is_conflicting=False), local, None)
    assert target.place_ne_m(1.0) == pytest.approx((100 + 4 * 0.2 + 10, 50 - 2 * 0.2))


def test_without_range_or_position_there_is_a_bearing_but_no_place() -> None:
    for fix, local in ((None, STILL), (RangeFix(10.0, is_conflicting=False), None)):
        target = estimate(seen(centred()), fix, local, None)
        assert (target.north, target.east, target.place_ne_m(1.0), target.velocity_ne_mps) == (None, None, None, None)
        assert target.bearing_at(0.0) == pytest.approx(0)


def test_a_range_that_comes_late_starts_a_place_at_rest_and_one_that_is_lost_ends_it() -> None:
    fix = RangeFix(10.0, is_conflicting=False)
    without = estimate(seen(centred(), time_s=0.0), None, STILL, None)
    with_it = estimate(seen(centred(), time_s=0.1), fix, STILL, without)
    assert with_it.place_ne_m(0.1) == pytest.approx((10, 0))
    assert with_it.velocity_ne_mps == (0, 0)
    assert estimate(seen(centred(), time_s=0.2), None, STILL, with_it).place_ne_m(0.2) is None


def test_a_range_that_jumps_makes_no_target_faster_than_any() -> None:
    target = None
    for k, range_m in enumerate([10.0] * 5 + [9000.0] * 5):
        target = estimate(seen(centred(), time_s=0.05 * k), RangeFix(range_m, is_conflicting=False), STILL, target)
    assert target is not None
    assert target.velocity_ne_mps == pytest.approx((MAX_SPEED_MPS, 0))


coordinates = st.floats(-1e4, 1e4)
boxes = st.builds(Box, coordinates, coordinates, st.floats(1e-3, 1e4), st.floats(1e-3, 1e4))
attitudes = st.builds(
    Attitude,
    st.floats(0, 10),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi / 2, math.pi / 2),
    st.floats(-math.pi, math.pi),
    st.floats(-10, 10),
)
lenses = st.sampled_from([(), (-0.28, 0.07, 0.0005, -0.0005)])


@steady
@given(
    st.lists(st.tuples(boxes, attitudes), min_size=1, max_size=4),
    lenses,
    st.none() | coordinates,
    st.none() | coordinates,
    st.booleans(),
)
def test_no_box_at_any_attitude_gives_an_estimate_that_is_not_finite(
    frames: list[tuple[Box, Attitude]],
    lens: tuple[float, ...],
    height_m: float | None,
    finder_m: float | None,
    is_above: bool,  # noqa: FBT001
) -> None:
    model, target = CameraModel(SIZE_HW, FOCAL_PX, lens, (0.0, -1.0, 0.3)), None
    for box, state in frames:
        found = measure(model, box, state, state.time_s)
        reference = RangeReference(20.0, 100.0)
        fix = range_from_above(found, height_m) if is_above else range_fix(found, height_m, reference, finder_m)
        target = estimate(found, fix, STILL, target)
        angles = (found.bearing_rad, found.azimuth_rad, found.depression_rad, found.foot_depression_rad)
        assert np.isfinite([*angles, found.off_nose_rad, *found.ray_ned]).all()
        assert fix is None or (math.isfinite(fix.range_m) and fix.range_m >= 0)
        filters = [target.bearing, target.log_height, target.north, target.east]
        assert np.isfinite([(one.value, one.rate) for one in filters if one is not None]).all()
