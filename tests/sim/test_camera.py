"""Projection, truth and pictures of small worlds on an empty tile."""

import math

import numpy as np
import pytest

from mscf.geometry import Box
from sim.camera import Camera, observe, render
from sim.world import Bridge, Car, House, Motion, Pose, Scenery, Tree, World

BARE = Scenery(3, tile_m=40.0)
BLUE = (112, 70, 52)
CAR = Car(Motion((0.0, 0.0), 0.4), BLUE)
CAMERA = Camera((240, 320), focal_px=400.0, mount_pitch_rad=math.radians(-35.0), noise_std=0.0)


def looking_at_origin(distance_m: float, down_rad: float = math.radians(35.0)) -> Pose:
    """South of the origin, which lies on the optical axis of `CAMERA`."""
    position = (-distance_m * math.cos(down_rad), 0.0, -distance_m * math.sin(down_rad))
    return Pose(position, pitch_rad=-down_rad - CAMERA.mount_pitch_rad)


def test_point_on_the_optical_axis_falls_on_the_middle_of_the_frame() -> None:
    ((u, v),), (depth_m,) = CAMERA.project(looking_at_origin(30.0), [(0.0, 0.0, 0.0)])
    assert (u, v, depth_m) == pytest.approx((159.5, 119.5, 30.0))


def test_point_projects_to_the_analytic_pixel() -> None:
    """Level camera looking east from 10 m height: east is depth, south is right, down is down."""
    camera = Camera((240, 320), focal_px=400.0, mount_pitch_rad=0.0)
    pose = Pose((5.0, 7.0, -10.0), yaw_rad=math.pi / 2)
    ((u, v),), (depth_m,) = camera.project(pose, [(5.0 - 3.0, 7.0 + 40.0, -6.0)])
    assert (u, v, depth_m) == pytest.approx((159.5 + 400 * 3 / 40, 119.5 + 400 * 4 / 40, 40.0))


def test_rolling_right_turns_the_picture_left() -> None:
    camera = Camera((240, 320), focal_px=400.0, mount_pitch_rad=0.0)
    ((u, v),), _ = camera.project(Pose((0, 0, 0), roll_rad=0.2), [(10.0, 1.0, 0.0)])
    assert (u, v) == pytest.approx((159.5 + 40 * math.cos(0.2), 119.5 - 40 * math.sin(0.2)))


def test_ground_homography_agrees_with_the_projection() -> None:
    pose = Pose((-20.0, 3.0, -25.0), 0.05, -0.02, 0.3)
    points = np.array([(4.0, 8.0, 0.0), (-3.0, 1.0, 0.0), (15.0, 20.0, 0.0)])
    mapped = np.column_stack([points[:, :2], np.ones(3)]) @ CAMERA.image_from_ground(pose).T
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], CAMERA.project(pose, points)[0])


def test_box_counts_area_so_its_edges_lie_half_a_pixel_outside() -> None:
    """Straight above, at the focal length's scale: the car is symmetric about the middle of the frame.

    Its size to 4 %, as its widest parts are some decimetres nearer than the ground.
    """
    camera = Camera((240, 320), focal_px=400.0, mount_pitch_rad=-math.pi / 2)
    box = observe(World(BARE, Car(Motion((0.0, 0.0)), BLUE)), camera, Pose((0.0, 0.0, -40.0)), 0.0).box
    assert box is not None
    assert box.center_xy[0] == pytest.approx(160.0)
    assert box.w == pytest.approx(1.8 * 400 / 40, rel=0.04)
    assert box.h == pytest.approx(4.4 * 400 / 40, rel=0.04)


def test_box_size_goes_with_one_over_distance() -> None:
    """Within 4 %: the car itself is not small against the distance."""
    near, far = (observe(World(BARE, CAR), CAMERA, looking_at_origin(d), 0.0).box for d in (40.0, 80.0))
    assert near is not None
    assert far is not None
    assert (near.w / far.w, near.h / far.h) == pytest.approx((2.0, 2.0), rel=0.04)


def test_box_is_clipped_to_the_frame_and_none_outside() -> None:
    def observed(east_m: float) -> tuple[Box | None, float]:
        truth = observe(
            World(BARE, Car(Motion((0.0, east_m), math.pi / 2), BLUE)), CAMERA, looking_at_origin(30.0), 0.0
        )
        return truth.box, truth.visible_share

    box, share = observed(12.0)  # the frame's edge is at 12 m
    assert box is not None
    assert box.x + box.w == 320.0
    assert 0.3 < share < 0.7
    assert observed(20.0) == (None, 0.0)


def test_target_behind_the_camera_has_no_box() -> None:
    assert observe(World(BARE, CAR), CAMERA, Pose((20.0, 0.0, -10.0)), 0.0).box is None


def test_world_without_a_target_has_no_truth() -> None:
    _, truth = render(World(BARE, None), CAMERA, looking_at_origin(30.0), 0.0)
    assert truth.box is None


@pytest.mark.parametrize("distance_m", [25.0, 60.0])
def test_drawn_target_lies_in_the_true_box(distance_m: float) -> None:
    """All that differs from the empty street is the body, in the box, and its shadow on the ground."""
    pose = looking_at_origin(distance_m)
    with_car, truth = render(World(BARE, CAR), CAMERA, pose, 0.0)
    without_car, _ = render(World(BARE, None), CAMERA, pose, 0.0)
    assert truth.box is not None
    rows, cols = np.nonzero(np.abs(with_car.astype(int) - without_car).max(axis=2) > 3)
    blur_px = 4  # lens, soft shadow under the sills
    shadow_px = 1.45 * 400 / distance_m  # the sun stands at 47 degrees: shadows as long as things are high
    assert cols.min() >= truth.box.x - blur_px
    assert cols.max() <= truth.box.x + truth.box.w + blur_px + shadow_px
    assert rows.min() >= truth.box.y - blur_px
    assert rows.max() <= truth.box.y + truth.box.h + blur_px
    # And it fills the box: its left and its lower edge are body, not shadow.
    assert cols.min() <= truth.box.x + blur_px
    assert rows.max() >= truth.box.y + truth.box.h - blur_px


def test_truth_with_rendering_equals_truth_without() -> None:
    world = World(Scenery(3, tile_m=40.0, trees=(Tree((-1.5, 1.0), 3.0, 2.0),)), CAR)
    pose = looking_at_origin(30.0)
    assert render(world, CAMERA, pose, 0.0)[1] == observe(world, CAMERA, pose, 0.0)


def test_unhidden_target_is_wholly_visible() -> None:
    assert observe(World(BARE, CAR), CAMERA, looking_at_origin(30.0), 0.0).visible_share == 1.0


@pytest.mark.parametrize(
    "scenery",
    [
        Scenery(3, tile_m=40.0, trees=(Tree((-7.0, 0.0), 5.0, 4.5),)),
        Scenery(3, tile_m=40.0, bridges=(Bridge(-8.0, 9.0, 5.0, 1.0, -8.0),)),
        Scenery(
            3,
            tile_m=40.0,
            houses=(House((-7.0, 0.0), math.pi / 2, 12.0, 7.0, 6.0, 8.0, (200,) * 3, (90,) * 3),),
        ),
    ],
    ids=["tree", "bridge", "house"],
)
def test_target_behind_a_thing_is_flagged_hidden_and_not_drawn(scenery: Scenery) -> None:
    pose = looking_at_origin(30.0)
    picture, truth = render(World(scenery, CAR), CAMERA, pose, 0.0)
    assert truth.box is not None
    assert truth.visible_share < 0.02
    empty, _ = render(World(scenery, None), CAMERA, pose, 0.0)
    assert np.mean(np.abs(picture.astype(int) - empty).max(axis=2) > 3) < 1e-3


def test_things_behind_the_target_hide_nothing() -> None:
    scenery = Scenery(3, tile_m=40.0, trees=(Tree((7.0, 0.0), 3.0, 2.0),))
    assert observe(World(scenery, CAR), CAMERA, looking_at_origin(30.0), 0.0).visible_share == 1.0


@pytest.mark.parametrize(("north_m", "is_hiding"), [(-2.2, True), (2.2, False)])
def test_of_two_cars_the_nearer_one_hides_the_other(north_m: float, *, is_hiding: bool) -> None:
    target, rival = Car(Motion((0.0, 0.0), math.pi / 2), BLUE), Car(Motion((north_m, 0.0), math.pi / 2), BLUE)
    share = observe(World(BARE, target, (rival,)), CAMERA, looking_at_origin(30.0), 0.0).visible_share
    assert (share < 0.95) is is_hiding


def test_frame_is_bgr_bytes_of_the_asked_size_and_does_not_depend_on_history() -> None:
    camera = Camera((90, 160), focal_px=200.0)
    pose = looking_at_origin(30.0)
    frame, _ = render(World(BARE, CAR), camera, pose, 0.5)
    render(World(BARE, CAR), camera, pose, 0.7)
    again, _ = render(World(BARE, CAR), camera, pose, 0.5)
    assert frame.shape == (90, 160, 3)
    assert frame.dtype == np.dtype(np.uint8)
    np.testing.assert_array_equal(frame, again)


def test_scenery_repeats_with_the_tile() -> None:
    scenery = Scenery(3, tile_m=40.0, trees=(Tree((2.0, 3.0), 3.0, 2.0),))
    home = looking_at_origin(20.0)
    north_m, east_m, down_m = home.pos_ned_m
    away = Pose((north_m + 400.0, east_m - 800.0, down_m), pitch_rad=home.pitch_rad)
    frames = [render(World(scenery, None), CAMERA, pose, 0.0)[0].astype(int) for pose in (home, away)]
    assert np.abs(frames[0] - frames[1]).mean() < 0.5  # the warp rounds to 1/32 pixel


def test_exposure_gain_scales_the_brightness() -> None:
    pose = looking_at_origin(30.0)
    normal, dark = (render(World(BARE, CAR), CAMERA, pose, 0.0, exposure_gain=gain)[0] for gain in (1.0, 0.5))
    assert dark.mean() / normal.mean() == pytest.approx(0.5, abs=0.02)


def test_motion_during_the_exposure_smears_the_ground_along_it() -> None:
    pose = looking_at_origin(30.0)
    sideways = Pose(pose.pos_ned_m, yaw_rad=0.015, pitch_rad=pose.pitch_rad)  # 5 px or so
    still, smeared = (
        render(World(BARE, None), CAMERA, pose, 0.0, pose_at_close=close)[0].astype(int) for close in (pose, sideways)
    )
    loss_across, loss_along = (
        np.abs(np.diff(smeared, axis=axis)).mean() / np.abs(np.diff(still, axis=axis)).mean() for axis in (0, 1)
    )
    assert loss_along < 0.6
    assert loss_along < 0.75 * loss_across


def test_noise_has_the_asked_deviation() -> None:
    pose = looking_at_origin(30.0)
    clean, _ = render(World(BARE, None), CAMERA, pose, 0.0)
    noisy, _ = render(World(BARE, None), Camera((240, 320), focal_px=400.0, noise_std=3.0), pose, 0.0)
    noise = noisy.astype(float) - clean
    assert abs(noise.mean()) < 0.2
    assert noise.std() == pytest.approx(3.0, rel=0.15)


def test_camera_that_sees_the_horizon_sees_sky_above_it() -> None:
    frame, _ = render(World(BARE, None), CAMERA, Pose((0.0, 0.0, -30.0), pitch_rad=-CAMERA.mount_pitch_rad), 0.0)
    assert frame[:60].mean() > frame[-60:].mean() + 30
