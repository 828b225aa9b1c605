import math
from dataclasses import replace

import numpy as np
import pytest

from companion.modes import Mode
from mscf import Box
from mscf.arrays import Image
from sim.film import (
    HEAD_PX,
    MODE_COLORS_BGR,
    SETPOINT_BGR,
    SIDE_PX,
    TARGET_BGR,
    TEXT_S,
    UNKNOWN_BGR,
    VEHICLE_BGR,
    Film,
    footprint_ne_m,
    mode_color,
)
from sim.scenery import VIADUCT
from sim.stages import FORWARD_CAMERA, NADIR_CAMERA, stage
from sim.trace import Moment
from sim.view import Camera
from sim.wind import Wind
from sim.world import Pose

STAGE = stage("occluder", 7)
BLACK = np.zeros((480, 640, 3), np.uint8)
AMBER = (80, 200, 255)
NAN = math.nan
HALF_M = 40.0  # from the middle of the map to its edges where vehicle and target are near each other
MOMENT = Moment(
    time_s=10.0,
    mode="following",
    flight_mode="GUIDED",
    is_armed=True,
    pose=Pose((0.0, 0.0, -14.0)),
    velocity_ned_mps=(4.0, 0.0, 0.0),
    target_ned_m=(20.0, 0.0, 0.0),
    box=None,
    truth=None,
    visible_share=1.0,
    status="tracking",
    confidence=0.9,
    threat=0.2,
    frame_age_s=0.04,
    setpoint_ned_mps=None,
    yaw_rate_radps=None,
    range_m=20.0,
)


def film(camera: Camera = FORWARD_CAMERA, wind: Wind | None = None, radius_m: float | None = None) -> Film:
    return Film(STAGE, "occlusion", "ardupilot", camera, wind or Wind(), radius_m=radius_m)


def view_of(picture: Image) -> Image:
    return picture[HEAD_PX:, :-SIDE_PX]


def map_of(picture: Image) -> Image:
    return picture[HEAD_PX:, -SIDE_PX:]


def places_ne_m(picture: Image, color: tuple[int, int, int], half_m: float = HALF_M) -> np.ndarray:
    """North and east of the map's pixels of a colour, from its middle, the legend left out."""
    mask = (np.abs(map_of(picture).astype(int) - color) <= 8).all(axis=2)  # a thin line is smoothed a little
    mask[:100, :220] = False
    rows, cols = np.nonzero(mask)
    middle = (SIDE_PX - 1) / 2
    return np.stack([middle - rows, cols - middle], axis=1) * 2 * half_m / SIDE_PX


@pytest.mark.parametrize("mode", [mode.value for mode in Mode])
def test_the_box_is_drawn_where_it_is_in_the_colour_of_the_mode(mode: str) -> None:
    view = view_of(film().frame(replace(MOMENT, mode=mode, box=Box(300, 200, 60, 40)), BLACK))
    for row, col in ((200, 330), (239, 330), (220, 300), (220, 359)):
        assert tuple(view[row, col]) == MODE_COLORS_BGR[mode]
    assert not view[205:235, 335:355].any()
    assert not view[260:400, 280:380].any()


def test_every_mode_has_a_colour_of_its_own() -> None:
    assert set(MODE_COLORS_BGR) == {mode.value for mode in Mode}
    assert len({*MODE_COLORS_BGR.values(), UNKNOWN_BGR}) == len(Mode) + 1
    assert mode_color("what is this") == UNKNOWN_BGR


def test_the_true_box_is_white_and_thin() -> None:
    view = view_of(film().frame(replace(MOMENT, truth=Box(300, 200, 60, 40)), BLACK))
    assert view[200, 330].min() > 220
    assert not view[202:204, 330].any()


@pytest.mark.parametrize("size_hw", [(720, 1280), (480, 640), (240, 320), (1080, 1080), (600, 801)])
def test_any_camera_fills_the_picture_and_its_boxes_stay_in_place(size_hw: tuple[int, int]) -> None:
    height, width = size_hw
    camera = replace(FORWARD_CAMERA, size_hw=size_hw)
    shown = film(camera)
    box = Box(width / 4, height / 4, width / 2, height / 2)
    picture = shown.frame(replace(MOMENT, box=box), np.zeros((height, width, 3), np.uint8))
    assert picture.shape == (*shown.size_hw, 3)
    assert picture.dtype == np.uint8
    assert not any(side % 2 for side in shown.size_hw)
    view = view_of(picture)
    rows, cols = view.shape[:2]
    assert abs(cols / rows - width / height) < 0.01
    assert tuple(view[rows // 4, cols // 3]) == MODE_COLORS_BGR["following"]
    assert tuple(view[rows // 3, cols // 4]) == MODE_COLORS_BGR["following"]


def test_a_gray_image_is_shown_as_it_is_and_no_image_is_changed() -> None:
    gray = np.arange(480 * 640, dtype=np.uint32).astype(np.uint8).reshape(480, 640)
    color = np.repeat(gray[..., None], 3, axis=2)
    before = gray.copy()
    box = replace(MOMENT, box=Box(300, 200, 60, 40), notes=("a note",))
    np.testing.assert_array_equal(film().frame(box, gray), film().frame(box, color))
    np.testing.assert_array_equal(gray, before)
    np.testing.assert_array_equal(view_of(film().frame(MOMENT, gray))[100:200, 100:200], color[100:200, 100:200])


def test_without_an_image_the_boxes_are_shown_all_the_same() -> None:
    view = view_of(film().frame(replace(MOMENT, box=Box(300, 200, 60, 40)), None))
    assert tuple(view[200, 330]) == MODE_COLORS_BGR["following"]


@pytest.mark.parametrize("yaw_deg", range(-180, 180, 45))
def test_the_footprint_points_along_the_yaw_and_ends_at_the_reach(yaw_deg: int) -> None:
    yaw_rad = math.radians(yaw_deg)
    pose = Pose((30.0, -20.0, -14.0), yaw_rad=yaw_rad)
    offsets_m = footprint_ne_m(FORWARD_CAMERA, pose, reach_m=50.0) - (30.0, -20.0)
    along, across = (np.array([math.cos(a), math.sin(a)]) for a in (yaw_rad, yaw_rad + math.pi / 2))
    assert (offsets_m @ along > 0).all()
    assert (offsets_m @ across).sum() == pytest.approx(0.0, abs=1e-6)
    assert np.hypot(*offsets_m.T).max() == pytest.approx(50.0)
    # the lower edge of the picture looks down by the mount's pitch and half the field of view
    lower_rad = -FORWARD_CAMERA.mount_pitch_rad + math.atan(239.5 / FORWARD_CAMERA.focal_px)
    assert (offsets_m @ along).min() == pytest.approx(14.0 / math.tan(lower_rad))


def test_a_camera_that_looks_down_sees_a_rectangle_around_the_place_below() -> None:
    outline_m = footprint_ne_m(NADIR_CAMERA, Pose((30.0, -20.0, -25.0)))
    half_m = 25.0 / NADIR_CAMERA.focal_px * np.array([239.5, 319.5])
    np.testing.assert_allclose(outline_m.max(axis=0), np.add((30.0, -20.0), half_m))
    np.testing.assert_allclose(outline_m.min(axis=0), (30.0, -20.0) - half_m)


@pytest.mark.parametrize("target_ne_m", [(20.0, 0.0), (0.0, 20.0), (-20.0, 0.0), (0.0, -20.0), (15.0, -10.0)])
def test_the_map_is_north_up_with_vehicle_and_target_on_both_sides_of_its_middle(
    target_ne_m: tuple[float, float],
) -> None:
    north_m, east_m = target_ne_m
    yaw_rad = math.atan2(east_m, north_m)
    moment = replace(MOMENT, target_ned_m=(north_m, east_m, 0.0), pose=Pose((0.0, 0.0, -14.0), yaw_rad=yaw_rad))
    picture = film().frame(replace(moment, mode="tracking"), BLACK)
    half = np.array(target_ne_m) / 2
    np.testing.assert_allclose(places_ne_m(picture, TARGET_BGR).mean(axis=0), half, atol=0.3)
    vehicle = places_ne_m(picture, VEHICLE_BGR) + half
    np.testing.assert_allclose(vehicle.mean(axis=0), 0.0, atol=0.5)
    along, across = vehicle @ (math.cos(yaw_rad), math.sin(yaw_rad)), vehicle @ (-math.sin(yaw_rad), math.cos(yaw_rad))
    assert np.ptp(across[along > 0.7]) < 1.0  # pointed ahead, broad behind
    assert np.ptp(across[along < -0.7]) > 1.5


def test_the_map_shows_the_viaduct_where_it_stands() -> None:
    middle_m = VIADUCT.north_m - 15.0
    pose = Pose((middle_m - 10.0, 30.0, -14.0))
    picture = film().frame(replace(MOMENT, pose=pose, target_ned_m=(middle_m + 10.0, 30.0, 0.0)), BLACK)
    bridge = STAGE.world.scenery.bridges[0]
    deck_bgr = np.rint(np.multiply((150, 150, 146), 0.55))
    strip = map_of(picture)[:, 20:30].mean(axis=1)
    rows = np.flatnonzero((np.abs(strip - deck_bgr) < 1.5).all(axis=1))
    norths_m = ((SIDE_PX - 1) / 2 - rows) * 2 * HALF_M / SIDE_PX
    assert norths_m.mean() == pytest.approx(15.0, abs=0.3)
    assert np.ptp(norths_m) == pytest.approx(bridge.width_m, abs=1.0)


def test_the_map_widens_until_both_are_on_it() -> None:
    picture = film().frame(replace(MOMENT, target_ned_m=(200.0, 0.0, 0.0)), BLACK)
    assert places_ne_m(picture, TARGET_BGR, half_m=140.0).mean(axis=0) == pytest.approx((100.0, 0.0), abs=1.0)


def test_a_hidden_target_is_a_ring() -> None:
    seen, hidden = (map_of(film().frame(replace(MOMENT, visible_share=share), BLACK)) for share in (1.0, 0.0))
    row, col = round((SIDE_PX - 1) / 2 - 10.0 * SIDE_PX / (2 * HALF_M)), SIDE_PX // 2
    assert tuple(seen[row, col]) == TARGET_BGR
    assert tuple(hidden[row, col]) != TARGET_BGR


@pytest.mark.parametrize("setpoint_ne_mps", [(6.0, 0.0), (0.0, 6.0), (-4.0, -4.0)])
def test_an_arrow_leads_from_the_vehicle_along_the_setpoint(setpoint_ne_mps: tuple[float, float]) -> None:
    moment = replace(MOMENT, setpoint_ned_mps=(*setpoint_ne_mps, 0.0))
    offsets_m = places_ne_m(film().frame(moment, BLACK), SETPOINT_BGR) - (-10.0, 0.0)
    along = offsets_m @ np.array(setpoint_ne_mps) / math.hypot(*setpoint_ne_mps)
    assert (along > 0).all()
    assert along.max() == pytest.approx(3.0 * math.hypot(*setpoint_ne_mps), abs=1.0)


def test_a_setpoint_of_nothing_is_no_arrow() -> None:
    picture = film().frame(replace(MOMENT, setpoint_ned_mps=(0.0, 0.0, 0.0)), BLACK)
    assert not len(places_ne_m(picture, SETPOINT_BGR))


def test_the_vehicle_leaves_a_trail() -> None:
    shown = film()
    for east_m in range(21):
        moment = replace(MOMENT, pose=Pose((0.0, float(east_m), -14.0)), target_ned_m=(20.0, 20.0, 0.0), mode="idle")
        picture = shown.frame(moment, BLACK)
    places_m = np.add(places_ne_m(picture, VEHICLE_BGR), (10.0, 20.0))
    assert places_m[:, 1].min() == pytest.approx(0.0, abs=1.0)
    assert np.abs(places_m[places_m[:, 1] < 15.0, 0]).max() < 0.5


def test_the_place_of_engagement_stays_marked_with_its_radius() -> None:
    shown = film(radius_m=25.0)
    shown.frame(replace(MOMENT, mode="tracking"), BLACK)
    shown.frame(MOMENT, BLACK)
    moved = replace(MOMENT, pose=Pose((10.0, 0.0, -14.0)), target_ned_m=(30.0, 0.0, 0.0))
    picture = shown.frame(moved, BLACK)
    places_m = np.add(places_ne_m(picture, AMBER), (20.0, 0.0))  # the circle, around where it was engaged: 0, 0
    assert len(places_m) > 40
    np.testing.assert_allclose(np.hypot(*places_m.T), 25.0, atol=0.4)
    crossed = np.add(places_ne_m(picture, VEHICLE_BGR), (20.0, 0.0))
    assert np.hypot(*crossed.T).min() < 0.3


def test_a_message_to_the_operator_stays_for_its_time_and_a_note_as_long_as_it_holds() -> None:
    talkative, silent = film(), film()
    for time_s, is_shown in ((10.0, True), (10.0 + TEXT_S - 0.1, True), (10.0 + TEXT_S + 0.1, False)):
        texts = ("Following",) if time_s == 10.0 else ()
        with_text = talkative.frame(replace(MOMENT, time_s=time_s, texts=texts), BLACK)
        without = silent.frame(replace(MOMENT, time_s=time_s), BLACK)
        assert (with_text != without).any() == is_shown
    assert (film().frame(replace(MOMENT, notes=("speed limited",)), BLACK) != film().frame(MOMENT, BLACK)).any()


def test_a_picture_that_is_not_of_now_says_so() -> None:
    fresh, old = (view_of(film().frame(replace(MOMENT, frame_age_s=age_s), BLACK)) for age_s in (0.05, 1.5))
    assert (fresh[440:] != old[440:]).any()
    np.testing.assert_array_equal(fresh[:440], old[:440])


def test_the_wind_is_shown_where_there_is_one() -> None:
    calm, windy = (map_of(film(wind=wind).frame(MOMENT, BLACK)) for wind in (Wind(), Wind((0.0, 6.0))))
    changed = np.argwhere((calm != windy).any(axis=2))
    assert len(changed)
    assert changed.min() > SIDE_PX - 110


@pytest.mark.parametrize(
    "missing",
    [
        {"mode": "", "flight_mode": ""},
        {"pose": Pose((NAN, NAN, NAN), NAN, NAN, NAN), "velocity_ned_mps": (NAN, NAN, NAN)},
        {"pose": Pose((0.0, 0.0, -14.0), yaw_rad=NAN)},
        {"pose": Pose((0.0, 0.0, -14.0), roll_rad=NAN)},
        {"pose": Pose((0.0, 0.0, NAN))},
        {"pose": Pose((0.0, 0.0, 0.0))},
        {"pose": Pose((1e7, -1e7, -14.0))},
        {"target_ned_m": (NAN, NAN, NAN)},
        {"pose": Pose((NAN, NAN, NAN)), "target_ned_m": (NAN, NAN, NAN)},
        {"box": Box(NAN, 0, 10, 10), "confidence": NAN, "threat": NAN, "visible_share": NAN},
        {"box": Box(-1e9, 1e9, 3e9, 1), "truth": Box(1e12, 5, 4, 4)},
        {"truth": Box(NAN, NAN, NAN, NAN)},
        {"range_m": None, "frame_age_s": None},
        {"range_m": math.inf, "frame_age_s": NAN, "setpoint_ned_mps": (NAN, NAN, NAN)},
        {"texts": ("Überhöht <b>" * 30,), "notes": tuple("abcdefghijklmnopqrstuvwxyz0123456789")},
    ],
)
def test_what_is_not_known_is_left_out(missing: dict[str, object]) -> None:
    shown = film()
    shown.frame(MOMENT, BLACK)
    for image in (BLACK, None):
        picture = shown.frame(replace(MOMENT, **missing), image)  # type: ignore[arg-type]
        assert picture.shape == (*shown.size_hw, 3)


def test_the_same_moments_give_the_same_pictures() -> None:
    moments = [replace(MOMENT, time_s=float(t), pose=Pose((3.0 * t, 0.0, -14.0)), texts=(f"{t}",)) for t in range(3)]
    first, second = film(), film()
    for moment in moments:
        np.testing.assert_array_equal(first.frame(moment, BLACK), second.frame(moment, BLACK))
