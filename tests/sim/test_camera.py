"""Projection, truth and pictures of small worlds on an empty tile."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mscf.geometry import Box
from sim.camera import Camera, observe, render
from sim.cover import _LARGEST_CROWN_PX, MeshSight, _magnified, silhouette
from sim.foliage import crowns
from sim.scenery import village
from sim.shapes import bridge_meshes
from sim.view import NEAREST_M, View, Window
from sim.world import Bridge, House, Kind, Motion, Mover, Pose, Scenery, Tree, World

BARE = Scenery(3, tile_m=40.0)
BLUE = (112, 70, 52)
CAR = Mover(Motion((0.0, 0.0), 0.4), BLUE)
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
    ((u, v),), _ = camera.project(Pose((0, 0, -9), roll_rad=0.2), [(10.0, 1.0, -9.0)])
    assert (u, v) == pytest.approx((159.5 + 40 * math.cos(0.2), 119.5 - 40 * math.sin(0.2)))


def test_ground_homography_agrees_with_the_projection() -> None:
    pose = Pose((-20.0, 3.0, -25.0), 0.05, -0.02, 0.3)
    points = np.array([(4.0, 8.0, 0.0), (-3.0, 1.0, 0.0), (15.0, 20.0, 0.0)])
    pixels = np.column_stack([CAMERA.project(pose, points)[0], np.ones(3)])
    mapped = pixels @ View(CAMERA, pose).ground_from_image().T
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], points[:, :2])


@pytest.mark.parametrize(
    ("mount", "point_ned_m", "pixel"),
    [
        ({"mount_pitch_rad": -math.pi / 2}, (1.0, 0.0, 10.0), (159.5, 119.5 - 40)),  # nadir: north is up
        ({"mount_pitch_rad": -math.pi / 2}, (0.0, 1.0, 10.0), (159.5 + 40, 119.5)),
        ({"mount_pitch_rad": 0.0, "mount_yaw_rad": math.pi / 2}, (-1.0, 10.0, 0.0), (159.5 + 40, 119.5)),
        ({"mount_pitch_rad": 0.0, "mount_roll_rad": math.pi / 2}, (10.0, 0.0, 1.0), (159.5 + 40, 119.5)),
    ],
)
def test_mount_turns_the_camera_on_its_vehicle(
    mount: dict[str, float], point_ned_m: tuple[float, float, float], pixel: tuple[float, float]
) -> None:
    camera = Camera((240, 320), focal_px=400.0, **mount)
    ((u, v),), _ = camera.project(Pose((0, 0, -50)), [np.add(point_ned_m, (0, 0, -50))])
    assert (u, v) == pytest.approx(pixel)


def test_angles_of_the_mount_are_those_of_a_pose() -> None:
    """A camera turned on a level vehicle looks where an unturned one looks on a vehicle turned likewise."""
    on_mount = Camera(mount_roll_rad=0.2, mount_pitch_rad=-0.5, mount_yaw_rad=1.1)
    on_nose = Camera(mount_pitch_rad=0.0)
    np.testing.assert_allclose(
        on_mount.optical_from_ned(Pose((0, 0, 0))), on_nose.optical_from_ned(Pose((0, 0, 0), 0.2, -0.5, 1.1))
    )


@pytest.mark.parametrize("kind", list(Kind))
def test_box_counts_area_so_its_edges_lie_half_a_pixel_outside(kind: Kind) -> None:
    """Straight above, at the focal length's scale: the target is symmetric about the middle of the frame.

    Its size to 5 %, as its widest parts are up to a metre and a half nearer than the ground.
    """
    camera = Camera((240, 320), focal_px=400.0, mount_pitch_rad=-math.pi / 2)
    target = Mover(Motion((0.0, 0.0)), BLUE, kind)
    box = observe(World(BARE, target), camera, Pose((0.0, 0.0, -40.0)), 0.0).box
    length_m, width_m, _ = kind.value
    assert box is not None
    assert box.center_xy[0] == pytest.approx(160.0)
    assert box.w == pytest.approx(width_m * 400 / 40, rel=0.05)
    assert box.h == pytest.approx(length_m * 400 / 40, rel=0.05)


@pytest.mark.parametrize("kind", list(Kind))
def test_box_is_as_high_as_its_target(kind: Kind) -> None:
    """Level camera at half the target's height, 40 m before it: the nearest parts are at most 3 m nearer."""
    camera = Camera((240, 320), focal_px=400.0, mount_pitch_rad=0.0)
    height_m = kind.value[2]
    target = Mover(Motion((40.0, 0.0)), BLUE, kind)
    box = observe(World(BARE, target), camera, Pose((0.0, 0.0, -height_m / 2)), 0.0).box
    assert box is not None
    assert box.h == pytest.approx(height_m * 400 / 40, rel=0.08)


def test_box_size_goes_with_one_over_distance() -> None:
    """Within 4 %: the car itself is not small against the distance."""
    near, far = (observe(World(BARE, CAR), CAMERA, looking_at_origin(d), 0.0).box for d in (40.0, 80.0))
    assert near is not None
    assert far is not None
    assert (near.w / far.w, near.h / far.h) == pytest.approx((2.0, 2.0), rel=0.04)


def test_box_is_clipped_to_the_frame_and_none_outside() -> None:
    def observed(east_m: float) -> tuple[Box | None, float]:
        truth = observe(
            World(BARE, Mover(Motion((0.0, east_m), math.pi / 2), BLUE)), CAMERA, looking_at_origin(30.0), 0.0
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
    target, rival = Mover(Motion((0.0, 0.0), math.pi / 2), BLUE), Mover(Motion((north_m, 0.0), math.pi / 2), BLUE)
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


@pytest.mark.parametrize("tiles", [10, 5000])
def test_scenery_repeats_with_the_tile(tiles: int) -> None:
    scenery = Scenery(3, tile_m=40.0, trees=(Tree((2.0, 3.0), 3.0, 2.0),))
    home = looking_at_origin(20.0)
    north_m, east_m, down_m = home.pos_ned_m
    away = Pose((north_m + 40.0 * tiles, east_m - 80.0 * tiles, down_m), pitch_rad=home.pitch_rad)
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


@pytest.mark.parametrize("roll_deg", [0, 10, 35, 90, 180, -60])
@pytest.mark.parametrize("pitch_deg", [0, 20, -25])
def test_sky_is_where_a_pixel_looks_up_and_ground_where_it_looks_down(roll_deg: float, pitch_deg: float) -> None:
    camera = Camera((120, 160), focal_px=140.0, mount_pitch_rad=0.0, noise_std=0.0)
    pose = Pose((0.0, 0.0, -8.0), math.radians(roll_deg), math.radians(pitch_deg))
    frame = render(World(BARE, None), camera, pose, 0.0)[0].astype(int)
    v, u = np.mgrid[:120, :160]
    down = np.tensordot(View(camera, pose).ned_from_image[2], np.stack([u, v, np.ones_like(u)]), axes=1)
    is_blue = frame[..., 0] > frame[..., 2]  # the ground of this tile is green and brown
    assert is_blue[down < -0.02].all()
    assert not is_blue[down > 0.15].any()


def turned_on_its_axis(turn_deg: float) -> np.ndarray:
    """A square picture of the village by a camera that is turned to the right on its optical axis."""
    angles_rad = {"mount_pitch_rad": math.radians(-25.0), "mount_roll_rad": math.radians(turn_deg)}
    camera = Camera((201, 201), focal_px=230.0, noise_std=0.0, **angles_rad)
    return render(World(village(7), None), camera, Pose((0.0, 0.0, -12.0)), 0.0)[0]


@pytest.mark.parametrize("turn_deg", [12, 35])
def test_turned_camera_sees_the_upright_picture_turned(turn_deg: float) -> None:
    to_turned = cv2.getRotationMatrix2D((100, 100), turn_deg, 1.0)
    expected = np.asarray(cv2.warpAffine(turned_on_its_axis(0), to_turned, (201, 201)), np.uint8)
    inside = np.hypot(*np.mgrid[-100:101, -100:101]) < 95
    assert np.abs(expected.astype(int) - turned_on_its_axis(turn_deg))[inside].mean() < 4.0


def test_level_of_detail_goes_by_distance_however_the_horizon_is_tilted() -> None:
    """By rows alone the mean difference is 3.3 gray levels, from what is too fine in the distance."""
    difference = np.rot90(turned_on_its_axis(0)).astype(int) - turned_on_its_axis(90)
    assert np.abs(difference).mean() < 2.5


@given(
    place=st.tuples(st.floats(-400, 400), st.floats(-400, 400), st.floats(-60, 2)),
    attitude=st.tuples(*[st.floats(-math.pi, math.pi)] * 3),
    mount=st.tuples(*[st.floats(-math.pi, math.pi)] * 3),
    motion=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)
@settings(max_examples=150, deadline=None, database=None, derandomize=True)
def test_any_pose_gives_a_picture_and_a_truth(
    place: tuple[float, float, float],
    attitude: tuple[float, float, float],
    mount: tuple[float, float, float],
    motion: tuple[float, float, float],
) -> None:
    """Also with the camera in a tree, in a house, in the target, on the ground or upside down."""
    roll_rad, pitch_rad, yaw_rad = mount
    camera = Camera(
        (24, 32), 28.0, mount_roll_rad=roll_rad, mount_pitch_rad=pitch_rad, mount_yaw_rad=yaw_rad, noise_std=0.0
    )
    world = World(village(7), Mover(Motion((0.0, 0.0)), BLUE), (Mover(Motion((3.0, 3.0)), BLUE, Kind.PEDESTRIAN),))
    at_close = Pose(place, *np.add(attitude, motion))
    frame, truth = render(world, camera, Pose(place, *attitude), 0.0, pose_at_close=at_close)
    assert frame.shape == (24, 32, 3)
    assert 0.0 <= truth.visible_share <= 1.0
    assert (truth.box is not None) or truth.visible_share == 0.0
    if truth.box is not None:
        box = truth.box
        assert (min(box.x, box.y) >= 0, box.x + box.w <= 32, box.y + box.h <= 24) == (True, True, True)


def test_eye_in_the_plane_of_a_deck_is_no_error() -> None:
    scenery = Scenery(3, tile_m=40.0, bridges=(Bridge(0.0, 6.0, 5.2, 1.1, 0.0),))
    for height_m in (5.2, 6.3, 5.2 + 1.1, 7.2):
        frame, _ = render(World(scenery, None), CAMERA, Pose((-20.0, 0.0, -height_m), pitch_rad=0.4), 0.0)
        assert frame.std() > 5


def test_outline_ends_at_the_nearest_plane() -> None:
    """A floor from 5 m behind the camera to 20 m before it: what is left begins at the plane."""
    view = View(Camera((240, 320), focal_px=400.0, mount_pitch_rad=0.0), Pose((0.0, 0.0, -2.0)))
    floor_m = np.array([(-5.0, -1.0, 0.0), (-5.0, 1.0, 0.0), (20.0, 1.0, 0.0), (20.0, -1.0, 0.0)])
    corners = {tuple(np.round(corner, 6)) for corner in view.outline(floor_m)}
    u, v, near, far = 159.5, 119.5, 400 / NEAREST_M, 400 / 20
    assert corners == {
        (u - near, v + 2 * near),
        (u + near, v + 2 * near),
        (u + far, v + 2 * far),
        (u - far, v + 2 * far),
    }
    assert len(view.outline(floor_m - (21.0, 0.0, 0.0))) == 0


def test_thing_that_reaches_behind_the_camera_is_drawn_and_hides_what_is_behind_it() -> None:
    """Over a viaduct, along it: its pieces begin behind the camera; a car below it is hidden."""
    scenery = Scenery(3, tile_m=40.0, bridges=(Bridge(0.0, 12.0, 5.0, 1.0, 0.0),))
    camera = Camera((240, 320), focal_px=200.0, mount_pitch_rad=math.radians(-50.0), noise_std=0.0)
    pose = Pose((0.0, -18.0, -9.0), yaw_rad=math.pi / 2)
    world = World(scenery, Mover(Motion((0.0, -12.0)), BLUE))
    truth = observe(world, camera, pose, 0.0)
    assert truth.box is not None
    assert truth.visible_share == 0.0
    on_deck, on_ground = (render(World(place, None), camera, pose, 0.0)[0].astype(int) for place in (scenery, BARE))
    assert np.abs(on_deck - on_ground)[120:].mean() > 10


@pytest.mark.parametrize(("east_m", "yaw_rad"), [(4.0, 0.8), (-4.0, 1.9), (0.0, 1.3), (-8.0, 2.8)])
def test_silhouette_of_a_thing_that_reaches_behind_the_camera_is_where_rays_meet_it(
    east_m: float, yaw_rad: float
) -> None:
    """Over a piece of a deck; its parapets rise 0.9 m above it along two sides."""
    piece = bridge_meshes(Bridge(0.0, 6.0, 5.0, 1.0, 0.0), 20.0)[0]  # 20 m long, 6 m wide, its top 6 m high
    view = View(Camera((120, 160), focal_px=90.0), Pose((-2.0, east_m, -10.0), yaw_rad=yaw_rad))
    v, u = np.mgrid[:120, :160]
    rays = np.tensordot(view.ned_from_image, np.stack([u, v, np.ones_like(u)]), axes=1)  # (3, H, W)
    assert rays[2].min() > 0

    def meets(half_north_m: float, half_east_m: float, top_m: float, bottom_m: float) -> np.ndarray:
        """Which rays meet a box: their ways through its three slabs, in m of descent, overlap."""
        enter_m, leave_m = np.full(u.shape, 10.0 - top_m), np.full(u.shape, 10.0 - bottom_m)
        for axis, half_m in ((0, half_north_m), (1, half_east_m)):
            ways_m = [(side_m - view.eye_ned_m[axis]) * rays[2] / rays[axis] for side_m in (-half_m, half_m)]
            enter_m, leave_m = np.maximum(enter_m, np.minimum(*ways_m)), np.minimum(leave_m, np.maximum(*ways_m))
        return enter_m < leave_m

    sight = MeshSight.of(view, piece)
    is_hit = silhouette(sight, view.frame()) > 0
    assert sight.is_cut
    assert is_hit[meets(2.9, 9.9, 5.9, 5.1)].all()
    assert not is_hit[~meets(3.2, 10.2, 7.1, 4.9)].any()


def test_part_of_a_crown_just_before_the_camera_is_that_part_of_the_whole() -> None:
    side, part = _LARGEST_CROWN_PX + 88, Window(150, 210, 90, 70)
    image = crowns(7)[0].image
    whole = cv2.resize(image, (side, side), interpolation=cv2.INTER_LINEAR)
    assert np.abs(part.of(np.asarray(whole, np.uint8)).astype(int) - _magnified(image, side, part)).mean() < 1.0
