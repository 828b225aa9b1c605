import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.camera_model import (
    HISTORY_S,
    AttitudeHistory,
    CameraModel,
    Quaternion,
    direction,
    on_the_way,
    product,
    quaternion,
    ray_to,
    rotation,
    rotation_of,
    turn_between_rad,
    wrapped,
)
from companion.config import parse
from companion.types import Attitude

steady = settings(max_examples=100, deadline=None, database=None, derandomize=True)

SIZE_HW = (720, 1280)
MIDDLE = (639.5, 359.5)
LENS = (-0.28, 0.07, 0.0005, -0.0005)  # a wide lens as OpenCV's calibration gives it
LEVEL = Attitude(0.0, 0.0, 0.0, 0.0, 0.0)

tilts = st.floats(-0.7, 0.7)
headings = st.floats(-math.pi, math.pi)
rolls = st.floats(-math.pi, math.pi)
pixels = st.tuples(st.floats(0, 1279), st.floats(0, 719))
mounts = st.tuples(rolls, st.floats(-math.pi / 2, math.pi / 4), headings)


def camera(
    roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0, lens: tuple[float, ...] = ()
) -> CameraModel:
    mount = math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg)
    return CameraModel(SIZE_HW, 900.0, lens, mount)


def attitude(roll_rad: float, pitch_rad: float, yaw_rad: float, time_s: float = 0.0) -> Attitude:
    return Attitude(time_s, roll_rad, pitch_rad, yaw_rad, 0.0)


# ------------------------------------------------------------------------------------------- angles
@steady
@given(st.floats(-50, 50))
def test_a_wrapped_angle_is_the_same_angle_between_minus_and_plus_half_a_turn(angle_rad: float) -> None:
    assert abs(wrapped(angle_rad)) <= math.pi
    assert math.cos(wrapped(angle_rad)) == pytest.approx(math.cos(angle_rad), abs=1e-9)
    assert math.sin(wrapped(angle_rad)) == pytest.approx(math.sin(angle_rad), abs=1e-9)


def turned(first: Quaternion, angle_rad: float) -> Quaternion:
    """After a turn about an axis that is none of the three."""
    axis = (0.48, 0.6, 0.64)
    return product(first, (math.cos(angle_rad / 2), *(math.sin(angle_rad / 2) * a for a in axis)))  # type: ignore[arg-type]


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0, 3.0, 5.0, 9.0])
@pytest.mark.parametrize("angle_rad", [1e-6, 0.3, math.pi / 2, 3.1])
@pytest.mark.parametrize("sign", [1, -1])  # of the second one, which is the same rotation
def test_a_turn_goes_on_at_its_rate_by_more_than_a_full_turn_too(share: float, angle_rad: float, sign: int) -> None:
    first = quaternion(0.2, -1.1, 2.0)
    w, x, y, z = turned(first, angle_rad)
    second = (sign * w, sign * x, sign * y, sign * z)
    found, wanted = rotation_of(on_the_way(first, second, share)), rotation_of(turned(first, share * angle_rad))
    assert found is not None
    assert wanted is not None
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert turn_between_rad(first, second) == pytest.approx(angle_rad)


@steady
@given(rolls, tilts, headings)
def test_a_rotation_keeps_lengths_angles_and_handedness(roll_rad: float, pitch_rad: float, yaw_rad: float) -> None:
    matrix = rotation(roll_rad, pitch_rad, yaw_rad)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("angles_deg", "axis", "goes_to"),
    [
        ((90, 0, 0), (0, 1, 0), (0, 0, 1)),  # roll right: the right side goes down
        ((0, 90, 0), (1, 0, 0), (0, 0, -1)),  # pitch up: the nose goes up
        ((0, 0, 90), (1, 0, 0), (0, 1, 0)),  # yaw right: the nose goes east
        ((90, 0, 90), (0, 1, 0), (0, 0, 1)),  # first roll, then yaw
        ((0, -90, 90), (0, 0, 1), (0, -1, 0)),  # looking down and turned: the camera's down is backwards, now west
    ],
)
def test_each_angle_turns_as_in_aerospace(
    angles_deg: tuple[float, float, float], axis: tuple[float, ...], goes_to: tuple[float, ...]
) -> None:
    turned = rotation(*(math.radians(angle) for angle in angles_deg)) @ np.array(axis, dtype=np.float64)
    np.testing.assert_allclose(turned, goes_to, atol=1e-12)


# ------------------------------------------------------------------------------------------- pixel and ray
@steady
@given(pixels, mounts)
def test_a_pixel_comes_back_through_its_ray(uv: tuple[float, float], mount: tuple[float, float, float]) -> None:
    model = CameraModel(SIZE_HW, 900.0, (), mount)
    ray = model.ray_frd(uv)
    assert np.linalg.norm(ray) == pytest.approx(1.0)
    assert model.pixel(ray) == pytest.approx(uv, abs=1e-6)


@steady
@given(pixels, mounts)
def test_a_pixel_comes_back_through_a_lens_to_less_than_a_pixel(
    uv: tuple[float, float], mount: tuple[float, float, float]
) -> None:
    # OpenCV inverts its polynomial in five steps, which are 0.04 degrees short in the corners
    model = CameraModel(SIZE_HW, 900.0, LENS, mount)
    assert model.pixel(model.ray_frd(uv)) == pytest.approx(uv, abs=0.7)


@pytest.mark.parametrize("lens", [LENS, (*LENS, 0.01), (*LENS, 0.01, 0.001, 0.0, 0.0)], ids=len)
def test_a_lens_that_shrinks_the_corners_sees_farther_to_the_side(lens: tuple[float, ...]) -> None:
    bent, straight = camera(lens=lens).ray_frd((1279, 359.5)), camera().ray_frd((1279, 359.5))
    assert bent[1] > straight[1] + 0.02
    np.testing.assert_allclose(camera(lens=lens).ray_frd(MIDDLE), camera().ray_frd(MIDDLE), atol=1e-9)


@pytest.mark.parametrize("uv", [(-4000, 300), (5000, 300), (600, -3000), (600, 5000), (-900, 4000)])
def test_beyond_the_frame_a_lens_is_not_trusted_to_turn_back(uv: tuple[float, float]) -> None:
    inside = min(max(uv[0], 0), 1279), min(max(uv[1], 0), 719)
    np.testing.assert_array_equal(camera(lens=LENS).ray_frd(uv), camera(lens=LENS).ray_frd(inside))


def test_what_is_behind_the_camera_has_no_pixel() -> None:
    for lens in ((), LENS):
        assert camera(lens=lens).pixel(np.array([-1.0, 0.1, 0.1])) is None
        assert camera(lens=lens).pixel(np.array([0.0, 1.0, 0.0])) is None
        assert camera(yaw_deg=180, lens=lens).pixel(np.array([-1.0, 0.0, 0.0])) == pytest.approx(MIDDLE)


@pytest.mark.parametrize(
    ("mount_deg", "uv", "to"),  # to: what the pixel looks at, in body forward, right, down
    [
        ((0, 0, 0), MIDDLE, (1, 0, 0)),
        ((0, 0, 0), (639.5 + 900, 359.5), (1, 1, 0)),  # right of the middle is to the right
        ((0, 0, 0), (639.5, 359.5 + 900), (1, 0, 1)),  # below the middle is below
        ((0, -45, 0), MIDDLE, (1, 0, 1)),  # pitched down
        ((0, 30, 0), (639.5, 359.5 + 900 * math.tan(math.radians(30))), (1, 0, 0)),  # pitched up
        ((0, 0, 90), MIDDLE, (0, 1, 0)),  # to the right
        ((0, 0, -90), (639.5 + 900, 359.5), (1, -1, 0)),  # to the left: the right of the frame is ahead
        ((0, -90, 0), MIDDLE, (0, 0, 1)),  # nadir
        ((0, -90, 0), (639.5, 359.5 - 900), (1, 0, 1)),  # nadir: the top of the frame is ahead
        ((0, -90, 0), (639.5 + 900, 359.5), (0, 1, 1)),  # nadir: the right of the frame is to the right
        ((0, -90, 180), (639.5, 359.5 - 900), (-1, 0, 1)),  # nadir, turned round: the top is behind
        ((180, 0, 0), (639.5 + 900, 359.5), (1, -1, 0)),  # upside down
        ((180, -45, 0), MIDDLE, (1, 0, 1)),
        ((90, 0, 0), (639.5 + 900, 359.5), (1, 0, 1)),  # rolled right: the right of the frame is below
    ],
)
def test_the_mount_turns_the_view(
    mount_deg: tuple[float, float, float], uv: tuple[float, float], to: tuple[float, float, float]
) -> None:
    expected = np.array(to, dtype=np.float64)
    np.testing.assert_allclose(camera(*mount_deg).ray_frd(uv), expected / np.linalg.norm(expected), atol=1e-9)


def test_the_model_is_that_of_the_configuration_scaled_to_the_frames_that_come() -> None:
    config = parse("[camera]\nfocal_px = 900\nmount_pitch_deg = -20\nmount_yaw_deg = 5\nmount_roll_deg = 1")
    model = CameraModel.of(config, (360, 640))
    assert (model.size_hw, model.focal_px) == ((360, 640), 450)
    assert np.degrees(model.mount_rpy_rad) == pytest.approx((1, -20, 5))
    same = CameraModel.of(config, (720, 1280))
    np.testing.assert_allclose(model.ray_frd((0 * 2 + 79.5, 44.5)), same.ray_frd((159.5, 89.5)), atol=1e-12)


# ------------------------------------------------------------------------------------------- directions
@steady
@given(rolls, tilts, headings, headings, st.floats(-1.4, 1.4))
def test_a_fixed_point_has_the_same_bearing_and_depression_at_every_attitude(
    roll_rad: float, pitch_rad: float, yaw_rad: float, bearing_rad: float, depression_rad: float
) -> None:
    flat = math.cos(depression_rad)
    ned = 30 * np.array([flat * math.cos(bearing_rad), flat * math.sin(bearing_rad), math.sin(depression_rad)])
    state = attitude(roll_rad, pitch_rad, yaw_rad)
    seen = direction(ray_to(ned, state), state)
    assert wrapped(seen.bearing_rad - bearing_rad) == pytest.approx(0, abs=1e-9)
    assert seen.depression_rad == pytest.approx(depression_rad, abs=1e-9)
    assert wrapped(seen.azimuth_rad - (bearing_rad - yaw_rad)) == pytest.approx(0, abs=1e-9)


@steady
@given(tilts, tilts, headings, mounts)
def test_through_the_camera_and_back_a_fixed_point_stays_where_it_is(
    roll_rad: float, pitch_rad: float, yaw_rad: float, mount: tuple[float, float, float]
) -> None:
    model, state = CameraModel(SIZE_HW, 900.0, (), mount), attitude(roll_rad, pitch_rad, yaw_rad)
    ned = np.array([12.0, -5.0, 8.0])
    uv = model.pixel(ray_to(ned, state))
    if uv is None or max(map(abs, uv)) > 1e5:  # behind the camera or beside it
        return
    seen = direction(model.ray_frd(uv), state)
    assert seen.bearing_rad == pytest.approx(math.atan2(-5, 12), abs=1e-6)
    assert seen.depression_rad == pytest.approx(math.atan2(8, 13), abs=1e-6)


@pytest.mark.parametrize(
    ("state", "azimuth_deg", "depression_deg", "bearing_deg"),
    [
        (attitude(0, 0, 0), 0, 0, 0),
        (attitude(0, math.radians(-10), 0), 0, 10, 0),  # nose down: the same pixel lies lower
        (attitude(0, math.radians(10), 0), 0, -10, 0),
        (attitude(0, 0, math.radians(90)), 0, 0, 90),
        (attitude(0, 0, math.radians(-170)), 0, 0, -170),
        (attitude(math.radians(30), 0, 0), 0, 0, 0),  # rolling about the view moves nothing in the middle
    ],
)
def test_the_middle_of_the_frame_is_where_the_nose_points(
    state: Attitude, azimuth_deg: float, depression_deg: float, bearing_deg: float
) -> None:
    seen = direction(camera().ray_frd(MIDDLE), state)
    angles_deg = np.degrees([seen.azimuth_rad, seen.depression_rad, seen.bearing_rad])
    assert angles_deg == pytest.approx([azimuth_deg, depression_deg, bearing_deg], abs=1e-9)


@pytest.mark.parametrize(("roll_deg", "sign"), [(20, 1), (-20, -1)])
def test_rolled_right_the_right_of_the_frame_lies_lower(roll_deg: float, sign: int) -> None:
    seen = direction(camera().ray_frd((1279, 359.5)), attitude(math.radians(roll_deg), 0, 0))
    assert seen.depression_rad * sign > 0.1
    assert seen.azimuth_rad > 0


def test_across_north_and_south_a_bearing_is_wrapped() -> None:
    seen = direction(camera(yaw_deg=20).ray_frd(MIDDLE), attitude(0, 0, math.radians(170)))
    assert math.degrees(seen.bearing_rad) == pytest.approx(-170)
    assert math.degrees(seen.azimuth_rad) == pytest.approx(20)


def test_right_underneath_the_depression_is_a_right_angle_and_nothing_divides_by_zero() -> None:
    seen = direction(camera(pitch_deg=-90).ray_frd(MIDDLE), LEVEL)
    assert math.degrees(seen.depression_rad) == pytest.approx(90)
    assert np.isfinite(ray_to(np.zeros(3), LEVEL)).all()


# ------------------------------------------------------------------------------------------- history
def history(*rows: tuple[float, float, float, float, float]) -> AttitudeHistory:
    """Of rows time, roll, pitch, yaw and yaw rate; angles in degrees."""
    made = AttitudeHistory()
    for time_s, *angles_deg in rows:
        made.add(Attitude(time_s, *map(math.radians, angles_deg)))
    return made


def yaw_deg(found: Attitude | None) -> float:
    assert found is not None
    return math.degrees(found.yaw_rad)


def test_between_two_attitudes_every_angle_is_interpolated() -> None:
    found = history((1.0, 0, 10, 80, 0), (1.2, 10, -10, 100, 40)).at(1.05)
    assert found is not None
    assert found.time_s == 1.05
    angles_deg = np.degrees([found.roll_rad, found.pitch_rad, found.yaw_rad, found.yaw_rate_radps])
    assert angles_deg == pytest.approx([2.5, 5, 85, 10])


@pytest.mark.parametrize(
    ("first_deg", "second_deg", "half_deg"), [(170, -170, 180), (-178, 176, 179), (179, -177, -179)]
)
def test_interpolation_takes_the_short_way_across_south(first_deg: float, second_deg: float, half_deg: float) -> None:
    found = history((1.0, first_deg, 0, first_deg, 0), (1.1, second_deg, 0, second_deg, 0)).at(1.05)
    assert found is not None
    for angle_rad in (found.roll_rad, found.yaw_rad):
        assert math.degrees(wrapped(angle_rad - math.radians(half_deg))) == pytest.approx(0, abs=1e-9)
        assert abs(angle_rad) <= math.pi


def test_at_the_time_of_an_attitude_it_is_that_one() -> None:
    past = history((1.0, 0, 0, 10, 90), (1.1, 0, 0, 20, 90), (1.2, 0, 0, 30, 90))
    assert [yaw_deg(past.at(time_s)) for time_s in (1.0, 1.1, 1.2)] == pytest.approx([10, 20, 30])


def test_over_a_gap_nothing_is_interpolated() -> None:
    past = history((1.0, 0, 0, 0, 0), (1.28, 0, 0, 28, 0), (1.61, 0, 0, 60, 0))
    assert yaw_deg(past.at(1.14)) == pytest.approx(14)
    assert past.at(1.45) is None
    assert yaw_deg(past.at(1.61)) == pytest.approx(60)


def test_beyond_the_newest_one_the_yaw_turns_on_for_so_long_and_no_longer() -> None:
    past = history((1.0, 3, 4, 175, 40))
    found = past.at(1.25)
    assert found is not None
    assert np.degrees([found.roll_rad, found.pitch_rad, found.yaw_rad]) == pytest.approx([3, 4, -175])
    assert past.at(1.31) is None


def test_before_the_oldest_one_and_without_any_nothing_is_known() -> None:
    assert history((1.0, 0, 0, 0, 0)).at(0.99) is None
    assert AttitudeHistory().at(1.0) is None
    assert AttitudeHistory().newest is None
    assert history((1.0, 0, 0, 0, 0)).at(math.nan) is None


def test_an_attitude_that_comes_late_or_twice_is_dropped() -> None:
    past = history((1.0, 0, 0, 0, 0), (1.2, 0, 0, 20, 0), (1.1, 0, 0, 99, 0), (1.2, 0, 0, 99, 0))
    assert yaw_deg(past.at(1.1)) == pytest.approx(10)
    assert yaw_deg(past.newest) == pytest.approx(20)


def test_the_history_is_as_long_as_said_and_can_be_forgotten() -> None:
    past = history(*((0.1 * k, 0.0, 0.0, float(k), 0.0) for k in range(50)))
    assert yaw_deg(past.at(4.9 - HISTORY_S + 0.01)) == pytest.approx(29.1)
    assert past.at(4.9 - HISTORY_S - 0.01) is None
    past.clear()
    assert (past.newest, past.at(4.9)) == (None, None)
    past.add(LEVEL)  # the clock of an autopilot that restarted may begin before
    assert past.newest is LEVEL


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.2])
def test_attitudes_that_arrive_late_do_not_move_the_earth_bearing_when_they_are_stamped_right(delay_s: float) -> None:
    def state_at(time_s: float) -> Attitude:
        swing = math.sin(3 * time_s)
        return Attitude(time_s, 0.3 * swing, -0.2 * swing, wrapped(3.0 + 0.8 * swing), 2.4 * math.cos(3 * time_s))

    ned = np.array([-20.0, 1.0, 6.0])
    model, past, worst_rad, sent = camera(pitch_deg=-15), AttitudeHistory(), 0.0, 0
    for frame_s in np.arange(1.0, 5.0, 1 / 30):
        while (stamp_s := sent * 0.02) <= frame_s - delay_s:  # 50 Hz on the link
            past.add(state_at(stamp_s))
            sent += 1
        taken_s = float(frame_s) - 0.22  # as old as a frame is when the tracker has finished
        then, found = state_at(taken_s), past.at(taken_s)
        uv = model.pixel(ray_to(ned, then))
        assert found is not None
        if uv is not None:
            error_rad = wrapped(direction(model.ray_frd(uv), found).bearing_rad - math.atan2(1, -20))
            worst_rad = max(worst_rad, abs(error_rad))
    assert math.degrees(worst_rad) < 0.1  # what a straight line between two attitudes is short of a swing
