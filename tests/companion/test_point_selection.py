import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.point_selection import MIN_EXPECTED_PX, box_around
from mscf import Box
from mscf.arrays import Image
from mscf.frame import MIN_BOX_PX, check_box
from sim.camera import render
from sim.stages import STAGE_NAMES, stage
from sim.world import Pose

steady = settings(max_examples=25, deadline=None, database=None, derandomize=True)

SIZE_HW = (480, 640)
RADIUS_PX = 20.0
RED = (40, 40, 200)
WHITE = (235, 235, 235)
DARK = (60, 45, 40)


def textured_ground(seed: int = 0, size_hw: tuple[int, int] = SIZE_HW) -> Image:
    """Something like grass: coarse and fine patches of green."""
    rng = np.random.default_rng(seed)
    rows, cols = size_hw
    coarse = cv2.GaussianBlur(rng.normal(0, 60, (rows, cols)), (0, 0), 5.0)
    light = coarse + rng.normal(0, 6, (rows, cols))
    return (np.array((70, 110, 90)) + light[..., None]).clip(0, 255).astype(np.uint8)


def noise(seed: int, mean: float, std: float) -> Image:
    return np.random.default_rng(seed).normal(mean, std, (*SIZE_HW, 3)).clip(0, 255).astype(np.uint8)


def with_rectangle(image: Image, box: Box, bgr: tuple[int, int, int]) -> Image:
    painted = image.copy()
    x, y, w, h = (round(value) for value in (box.x, box.y, box.w, box.h))
    painted[y : y + h, x : x + w] = bgr
    return painted


def with_ellipse(image: Image, box: Box, bgr: tuple[int, int, int]) -> Image:
    rows, cols = np.indices(image.shape[:2])
    x, y = box.center_xy
    is_inside = ((cols + 0.5 - x) * 2 / box.w) ** 2 + ((rows + 0.5 - y) * 2 / box.h) ** 2 <= 1
    painted = image.copy()
    painted[is_inside] = bgr
    return painted


def middle_uv(box: Box) -> tuple[float, float]:
    x, y = box.center_xy
    return x - 0.5, y - 0.5


def edges(box: Box) -> tuple[float, float, float, float]:
    return box.x, box.y, box.x + box.w, box.y + box.h


def square_around(uv: tuple[int, int], side_px: float) -> Box:
    return Box(uv[0] + 0.5 - side_px / 2, uv[1] + 0.5 - side_px / 2, side_px, side_px)


# ------------------------------------------------------------------------------------------- an object
@pytest.mark.parametrize("bgr", [RED, WHITE, DARK])
@pytest.mark.parametrize("size_wh", [(12, 12), (24, 24), (40, 40), (60, 30), (24, 60), (70, 90), (100, 100)])
def test_a_rectangle_is_found_to_an_eighth_of_its_sides(size_wh: tuple[int, int], bgr: tuple[int, int, int]) -> None:
    true = Box(300, 200, *size_wh)
    found = box_around(with_rectangle(textured_ground(), true, bgr), middle_uv(true), RADIUS_PX)
    within_px = 2 + np.array((*size_wh, *size_wh)) / 8
    assert (np.abs(np.subtract(edges(found), edges(true))) <= within_px).all(), found


@pytest.mark.parametrize("size_wh", [(20, 14), (40, 40), (80, 40), (30, 70)])
def test_the_box_of_an_ellipse_reaches_about_to_its_edges(size_wh: tuple[int, int]) -> None:
    true = Box(300, 200, *size_wh)
    found = box_around(with_ellipse(textured_ground(), true, RED), middle_uv(true), RADIUS_PX)
    assert found.iou(true) > 0.65


@pytest.mark.parametrize("offset", [(-0.25, 0.0), (0.25, 0.25), (0.0, -0.25), (-0.2, 0.2)])
@pytest.mark.parametrize("size_wh", [(30, 30), (60, 40), (40, 80)])
def test_a_click_beside_the_middle_finds_the_same_object(size_wh: tuple[int, int], offset: tuple[float, float]) -> None:
    true = Box(300, 200, *size_wh)
    u, v = middle_uv(true)
    click_uv = u + offset[0] * size_wh[0], v + offset[1] * size_wh[1]
    found = box_around(with_rectangle(textured_ground(), true, RED), click_uv, RADIUS_PX)
    assert found.iou(true) > 0.6


def test_an_object_of_two_colours_is_found_whole() -> None:
    true = Box(300, 200, 24, 56)
    image = with_rectangle(with_rectangle(textured_ground(), true, RED), replace(true, h=28), DARK)
    assert box_around(image, middle_uv(true), RADIUS_PX).iou(true) > 0.7


def test_the_object_at_the_click_is_found_not_the_one_beside_it() -> None:
    true, other = Box(300, 200, 40, 40), Box(352, 200, 40, 40)
    image = with_rectangle(with_rectangle(textured_ground(), true, RED), other, RED)
    found = box_around(image, middle_uv(true), RADIUS_PX)
    assert found.iou(true) > 0.6
    assert found.overlap_px2(other) == 0


def test_an_object_in_a_gray_picture_is_found_by_its_brightness() -> None:
    true = Box(300, 200, 44, 36)
    gray = with_rectangle(textured_ground(), true, WHITE)[..., :1]
    assert box_around(np.repeat(gray, 3, axis=2), middle_uv(true), RADIUS_PX).iou(true) > 0.7


@pytest.mark.parametrize("size_hw", [(480, 640), (720, 1280), (1080, 1920)])
def test_the_size_of_the_frame_does_not_change_what_is_found_with_a_small_radius(size_hw: tuple[int, int]) -> None:
    true = Box(300, 200, 50, 40)
    image = with_rectangle(textured_ground(size_hw=size_hw), true, RED)
    assert box_around(image, middle_uv(true), 1.0).iou(true) > 0.75


@pytest.mark.parametrize("size_wh", [(6, 6), (8, 5), (5, 9)])
def test_a_tiny_object_gets_a_box_of_its_order_of_size(size_wh: tuple[int, int]) -> None:
    true = Box(300, 200, *size_wh)
    found = box_around(with_rectangle(textured_ground(), true, WHITE), middle_uv(true), RADIUS_PX)
    assert max(found.w, found.h) <= 16


@pytest.mark.parametrize(
    "true",
    [Box(0, 200, 40, 40), Box(600, 200, 40, 40), Box(300, 0, 40, 30), Box(300, 450, 40, 30), Box(0, 0, 40, 40)],
)
def test_an_object_that_the_frame_cuts_is_found_to_the_edge(true: Box) -> None:
    found = box_around(with_rectangle(textured_ground(), true, RED), middle_uv(true), RADIUS_PX)
    assert found.iou(true) > 0.6


# ------------------------------------------------------------------------------------------- nothing to be found
def test_a_flat_picture_gives_the_square_around_the_point() -> None:
    flat = np.full((*SIZE_HW, 3), 90, np.uint8)
    assert box_around(flat, (320, 240), RADIUS_PX).iou(square_around((320, 240), MIN_EXPECTED_PX)) > 0.95


@pytest.mark.parametrize(
    ("rows", "radius_px", "side_px"), [(480, 60.0, 40), (1000, 10.0, 40), (1000, 25.0, 50), (1000, 99.0, 60)]
)
def test_the_square_is_twice_the_radius_within_bounds(rows: int, radius_px: float, side_px: int) -> None:
    flat = np.full((rows, 1200, 3), 90, np.uint8)
    found = box_around(flat, (320, 240), radius_px)
    assert (found.w, found.h) == (side_px, side_px)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("mean", "std"), [(120, 6), (120, 30), (40, 15), (128, 90)])
def test_noise_gives_the_square_too(seed: int, mean: float, std: float) -> None:
    found = box_around(noise(seed, mean, std), (320, 240), RADIUS_PX)
    assert (found.w, found.h) == (MIN_EXPECTED_PX, MIN_EXPECTED_PX)


def test_a_straight_edge_alone_is_no_object() -> None:
    horizon = np.full((*SIZE_HW, 3), 200, np.uint8)
    horizon[240:] = RED
    found = box_around(horizon, (320, 240), RADIUS_PX)
    assert (found.w, found.h) == (MIN_EXPECTED_PX, MIN_EXPECTED_PX)


@pytest.mark.parametrize("uv", [(0, 0), (639, 0), (0, 479), (639, 479), (0, 240), (320, 479)])
def test_in_a_corner_the_square_is_moved_into_the_frame(uv: tuple[int, int]) -> None:
    flat = np.full((*SIZE_HW, 3), 90, np.uint8)
    found = box_around(flat, uv, RADIUS_PX)
    assert (found.w, found.h) == (MIN_EXPECTED_PX, MIN_EXPECTED_PX)
    assert found.overlap_px2(Box(0, 0, 640, 480)) == MIN_EXPECTED_PX**2


# ------------------------------------------------------------------------------------------- promises
@steady
@given(
    arrays(np.uint8, st.tuples(st.integers(4, 40), st.integers(4, 40), st.just(3))),
    st.integers(1, 12),
    st.tuples(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300)) | st.tuples(st.floats(-9, 500), st.floats(-9, 500)),
    st.floats(-100, 1e9),
)
def test_any_picture_and_any_point_give_a_box_in_the_frame_around_the_point_that_the_tracker_takes(
    seed: Image, zoom: int, point_uv: tuple[float, float], radius_px: float
) -> None:
    image = np.repeat(np.repeat(seed, zoom, axis=0), zoom, axis=1)
    image.setflags(write=False)
    rows, cols = image.shape[:2]
    found = box_around(image, point_uv, radius_px)
    check_box(found, image)
    assert 0 <= found.x <= found.x + found.w <= cols
    assert 0 <= found.y <= found.y + found.h <= rows
    assert found.x - 0.5 <= min(max(point_uv[0], 0), cols - 1) <= found.x + found.w - 0.5
    assert found.y - 0.5 <= min(max(point_uv[1], 0), rows - 1) <= found.y + found.h - 0.5
    assert min(found.w, found.h) >= MIN_BOX_PX


@pytest.mark.parametrize("size_hw", [(1, 1), (3, 2), (1, 300), (300, 2)])
def test_a_frame_too_small_for_the_tracker_gives_no_more_than_itself(size_hw: tuple[int, int]) -> None:
    found = box_around(np.full((*size_hw, 3), 9, np.uint8), (1, 1), RADIUS_PX)
    assert found.overlap_px2(Box(0, 0, size_hw[1], size_hw[0])) == found.w * found.h > 0


@steady
@given(st.integers(0, 9), st.integers(-20, 20), st.integers(-20, 20))
def test_the_box_goes_with_the_picture(seed: int, right_px: int, down_px: int) -> None:
    image = with_rectangle(textured_ground(seed), Box(300, 200, 50, 34), RED)
    moved = np.roll(image, (down_px, right_px), axis=(0, 1))
    at_first = box_around(image, (324.0, 216.0), RADIUS_PX)
    later = box_around(moved, (324.0 + right_px, 216.0 + down_px), RADIUS_PX)
    assert later == Box(at_first.x + right_px, at_first.y + down_px, at_first.w, at_first.h)


def test_the_same_picture_gives_the_same_box_whatever_came_before_and_whatever_the_random_numbers() -> None:
    image = with_ellipse(textured_ground(), Box(300, 200, 50, 34), RED)
    np_state = np.random.get_state(legacy=False)["state"]["key"].copy()  # noqa: NPY002  # that it is left alone is what is tested
    cv2.setRNGSeed(1)
    first = box_around(image, (324.0, 216.0), RADIUS_PX)
    box_around(noise(1, 120, 60), (10, 10), 5.0)
    cv2.setRNGSeed(2)
    assert box_around(image.copy(), (324.0, 216.0), RADIUS_PX) == first
    assert (np.random.get_state(legacy=False)["state"]["key"] == np_state).all()  # noqa: NPY002


def test_the_picture_is_left_as_it_was() -> None:
    image = with_ellipse(textured_ground(), Box(300, 200, 50, 34), RED)
    before = image.copy()
    box_around(image, (5.0, 216.0), RADIUS_PX)
    box_around(image, (324.0, 216.0), RADIUS_PX)
    assert (image == before).all()


def test_a_part_of_a_larger_array_is_read_as_it_stands() -> None:
    image = with_ellipse(textured_ground(), Box(300, 200, 50, 34), RED)
    part = image[100:400, 150:550]
    assert box_around(part, (174.0, 116.0), RADIUS_PX) == box_around(part.copy(), (174.0, 116.0), RADIUS_PX)


# ------------------------------------------------------------------------------------------- the simulator
def sights() -> list[tuple[Image, Box]]:
    """Each stage's target from behind, twice, at two ranges and from two sides."""
    found = []
    for name in STAGE_NAMES:
        scene = stage(name, 7)
        for time_s, height_m, aside_rad in ((3.0, -scene.start.pos_ned_m[2], 0.5), (25.0, 18.0, -0.6)):
            place = scene.target.motion.pose(time_s)
            north_m, east_m, _ = place.pos_ned_m
            yaw_rad = place.yaw_rad + aside_rad
            reach_m = 0.0 if name == "overhead" else 1.7 * height_m
            position = north_m - reach_m * math.cos(yaw_rad), east_m - reach_m * math.sin(yaw_rad), -height_m
            image, truth = render(scene.world, scene.camera, Pose(position, yaw_rad=yaw_rad), time_s)
            if truth.box is not None and truth.visible_share > 0.8:
                found.append((image, truth.box))
    return found


def test_the_targets_of_the_simulator_are_found() -> None:
    seen = sights()
    overlaps = [box_around(image, middle_uv(true), RADIUS_PX).iou(true) for image, true in seen]
    squares = [square_around((round(u), round(v)), MIN_EXPECTED_PX) for u, v in (middle_uv(box) for _, box in seen)]
    assert len(overlaps) >= 20
    assert np.mean(overlaps) > 0.7
    assert np.mean(overlaps) > np.mean([square.iou(box) for square, (_, box) in zip(squares, seen, strict=True)]) + 0.15
    assert min(overlaps) > 0.2
