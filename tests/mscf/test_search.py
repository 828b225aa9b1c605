import cv2
import numpy as np
import pytest

from mscf.arrays import Image
from mscf.geometry import Box
from mscf.kernels import Kernels
from mscf.search import RANKS, Looks, place_around

BOX = Box(140, 100, 40, 30)
SHAPE = (240, 320)


def textured(rng: np.random.Generator, rows: int, cols: int) -> Image:
    coarse = rng.integers(0, 256, (max(rows // 6, 2), max(cols // 6, 2), 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.uint8)


@pytest.fixture
def frame(rng: np.random.Generator) -> Image:
    return textured(rng, 240, 320)


def test_a_target_is_like_itself_and_not_like_its_surroundings(frame: Image, kernels: Kernels) -> None:
    looks = Looks.of(frame, BOX, kernels)
    assert looks.similarity(frame, BOX) == pytest.approx(1)
    assert looks.similarity(frame, Box(20, 20, 40, 30)) < 0.3
    assert looks.similarity(np.full_like(frame, 90), BOX) == 0


def test_looks_follow_the_target_slowly(frame: Image, kernels: Kernels) -> None:
    other = np.ascontiguousarray(frame[:, ::-1])
    first = Looks.of(frame, BOX, kernels)
    after = first.after(other, BOX)
    assert first.similarity(other, BOX) < after.similarity(other, BOX) < after.similarity(frame, BOX)
    for _ in range(40):
        after = after.after(other, BOX)
    assert after.similarity(other, BOX) > 0.95


def test_looks_keep_nothing_of_the_frame(frame: Image, kernels: Kernels) -> None:
    looks, kept = Looks.of(frame, BOX, kernels), frame.copy()
    frame[:] = 0
    assert looks.similarity(kept, BOX) == pytest.approx(1)
    assert looks.best_match(kept, 0) is not None


@pytest.mark.parametrize(("x", "y"), [(140, 100), (5, 8), (270, 200)])
def test_the_best_match_is_the_target_wherever_it_is(
    rng: np.random.Generator, x: int, y: int, kernels: Kernels
) -> None:
    ground, target = textured(rng, 240, 320) // 3, textured(rng, 30, 40)
    first, now = ground.copy(), ground.copy()
    first[100:130, 140:180] = target
    now[y : y + 30, x : x + 40] = target
    found = Looks.of(first, BOX, kernels).best_match(now, 0)
    assert found == pytest.approx((x + 20, y + 15), abs=4)


def test_further_matches_are_elsewhere(frame: Image, kernels: Kernels) -> None:
    looks = Looks.of(frame, BOX, kernels)
    places = [looks.best_match(frame, rank) for rank in range(RANKS)]
    for index, place in enumerate(places):
        assert place is not None
        for other in places[:index]:
            assert other is not None
            assert abs(place[0] - other[0]) >= BOX.w / 2 or abs(place[1] - other[1]) >= BOX.h / 2


def test_a_target_as_large_as_the_frame_has_no_match(frame: Image, kernels: Kernels) -> None:
    assert Looks.of(frame, Box(-10, -10, 340, 260), kernels).best_match(frame, 0) is None


def test_a_frame_without_texture_has_a_match_somewhere(frame: Image, kernels: Kernels) -> None:
    flat = np.zeros_like(frame)
    for looks in (Looks.of(frame, BOX, kernels), Looks.of(flat, BOX, kernels)):
        place = looks.best_match(flat, RANKS - 1)
        assert place is not None
        assert 0 <= place[0] <= 320
        assert 0 <= place[1] <= 240


def test_every_other_look_is_at_the_origin() -> None:
    assert {place_around(SHAPE, BOX, (160, 115), turn) for turn in range(0, 40, 2)} == {(160.0, 115.0)}


def test_the_search_grows_from_the_origin_over_the_whole_frame_and_begins_anew() -> None:
    origin = np.array([60.0, 50.0])
    places = [place_around(SHAPE, BOX, (60, 50), turn) for turn in range(1, 200, 2)]
    period = places.index(places[0], 1)
    assert places[period : 2 * period] == places[:period]
    seen = np.array([*places[:period], origin])
    reach_px = 1.75 * np.sqrt(BOX.w * BOX.h)
    for x in range(20, 301, 10):
        for y in range(15, 226, 10):
            assert np.abs(seen - (x, y)).max(axis=1).min() <= reach_px
    distance = np.abs(seen[:8] - origin).max(axis=1)
    assert distance.max() <= reach_px + 1  # the nearest eight come first


@pytest.mark.parametrize("origin", [(160, 120), (-500, 120), (400, 300), (0, 0)])
def test_no_place_leaves_the_box_outside_the_frame(origin: tuple[float, float]) -> None:
    for turn in range(120):
        x, y = place_around(SHAPE, BOX, origin, turn)
        assert BOX.w / 2 <= x <= 320 - BOX.w / 2
        assert BOX.h / 2 <= y <= 240 - BOX.h / 2


def test_the_borders_are_looked_at() -> None:
    places = [place_around(SHAPE, BOX, (160, 120), turn) for turn in range(200)]
    assert {BOX.w / 2, 320 - BOX.w / 2} <= {x for x, _ in places}
    assert {BOX.h / 2, 240 - BOX.h / 2} <= {y for _, y in places}


@pytest.mark.parametrize("box", [Box(-100, -100, 700, 500), Box(0, 0, 320, 240)])
def test_a_target_larger_than_the_frame_is_looked_for_in_its_middle(box: Box) -> None:
    assert {place_around(SHAPE, box, (10, 10), turn) for turn in range(9)} == {(160.0, 120.0)}
