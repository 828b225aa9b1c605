"""Poses and scripted motions."""

import math

import numpy as np
import pytest

from sim.world import Motion, Pose, Scenery

TURN = Motion(
    (10.0, 20.0),
    segments=((30.0, 0.0), (8.0 * math.pi / 2, 1 / 8.0)),
    speeds=((0.0, 10.0), (2.0, 10.0), (4.0, 0.0), (5.0, 0.0), (6.0, 5.0)),
)


def test_yaw_turns_the_nose_from_north_to_east() -> None:
    np.testing.assert_allclose(Pose((0, 0, 0), yaw_rad=math.pi / 2).ned_from_body() @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_positive_pitch_lifts_the_nose() -> None:
    assert (Pose((0, 0, 0), pitch_rad=0.3).ned_from_body() @ [1, 0, 0])[2] < 0


def test_positive_roll_lowers_the_right_side() -> None:
    assert (Pose((0, 0, 0), roll_rad=0.3).ned_from_body() @ [0, 1, 0])[2] > 0


def test_rotation_is_orthonormal_and_right_handed() -> None:
    rotation = Pose((1, 2, 3), 0.4, -0.7, 2.1).ned_from_body()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("time_s", "way_m"),
    [(-1.0, -10.0), (0.0, 0.0), (2.0, 20.0), (3.0, 27.5), (4.5, 30.0), (6.0, 32.5), (8.0, 42.5)],
)
def test_way_is_the_integral_of_the_speed(time_s: float, way_m: float) -> None:
    assert TURN.distance_m(time_s) == pytest.approx(way_m)


def test_way_is_zero_at_time_zero_wherever_the_knots_are() -> None:
    motion = Motion((0, 0), speeds=((-2.0, 4.0), (2.0, 8.0)))
    assert motion.distance_m(0.0) == 0.0
    assert motion.distance_m(2.0) == pytest.approx(14.0)


@pytest.mark.parametrize("time_s", [-1.0, 0.5, 2.5, 3.1, 4.5, 5.5, 9.0])
def test_velocity_is_the_slope_of_the_position(time_s: float) -> None:
    step_s = 1e-5
    before, after = (TURN.pose(time_s + dt_s).pos_ned_m for dt_s in (-step_s, step_s))
    velocity_ned_mps = TURN.velocity_ned_mps(time_s)
    np.testing.assert_allclose(velocity_ned_mps, np.subtract(after, before) / (2 * step_s), atol=1e-4)
    assert TURN.speed_mps(time_s) == pytest.approx(np.linalg.norm(velocity_ned_mps))


def test_car_turns_right_on_a_quarter_circle() -> None:
    motion = Motion((10.0, 20.0), segments=TURN.segments, speeds=((0.0, 30.0 + 4.0 * math.pi),))
    pose = motion.pose(1.0)
    np.testing.assert_allclose(pose.pos_ned_m, (10 + 30 + 8, 20 + 8, 0), atol=1e-9)
    assert pose.yaw_rad == pytest.approx(math.pi / 2)


def test_path_goes_on_straight_before_and_after_its_segments() -> None:
    np.testing.assert_allclose(TURN.pose(-1.0).pos_ned_m, (0, 20, 0))
    late, later = TURN.pose(20.0), TURN.pose(21.0)
    np.testing.assert_allclose(np.subtract(later.pos_ned_m, late.pos_ned_m), (0, 5, 0), atol=1e-9)


def test_tile_that_noise_cells_do_not_fit_on_is_refused() -> None:
    with pytest.raises(ValueError, match=r"tile_m is 50\.0"):
        Scenery(1, tile_m=50.0)
