import numpy as np
import pytest

from mscf.geometry import Box
from mscf.overlay import COLORS_BGR, Shown, draw

RESPONSE = np.random.default_rng(0).standard_normal((50, 50)).astype(np.float32)


@pytest.mark.parametrize("shape", [(720, 1280, 3), (720, 1280), (96, 128, 3), (4000, 75, 3), (30, 2000), (5, 5, 3)])
@pytest.mark.parametrize("box", [Box(20, 20, 40, 30), Box(-1e7, -1e7, 3e7, 3e7), Box(1e9, 5, 4, 4)])
def test_any_frame_and_box_can_be_drawn(shape: tuple[int, ...], box: Box) -> None:
    frame = np.full(shape, 100, np.uint8)
    before = frame.copy()
    shown = [Shown("mscf", box, [np.nan, 0.5, 1.5]), Shown("bacf", box, [])]
    picture = draw(frame, shown, response=RESPONSE, truth=box, caption="x" * 50)
    assert picture.shape == (*shape[:2], 3)
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(frame, before)


def test_each_tracker_has_its_colour_at_its_box() -> None:
    frame = np.zeros((720, 1280, 3), np.uint8)
    shown = [Shown("mscf", Box(300, 200, 60, 40), []), Shown("bacf", Box(600, 300, 60, 40), [])]
    picture = draw(frame, shown, response=None, truth=None, caption="")
    assert tuple(picture[200, 330]) == COLORS_BGR[0]
    assert tuple(picture[300, 630]) == COLORS_BGR[1]
    assert not picture[240:290, 400:560].any()


def test_the_response_has_its_centre_in_the_middle_of_its_panel() -> None:
    response = np.zeros((50, 50), np.float32)
    response[0, 0] = 1
    picture = draw(np.zeros((720, 1280, 3), np.uint8), [], response=response, truth=None, caption="")
    panel = picture[566:710, 10:154].sum(axis=2).astype(int)
    row, col = np.unravel_index(panel[20:-2, 2:-2].argmax(), panel[20:-2, 2:-2].shape)
    assert abs(row + 20 - 72) < 6
    assert abs(col + 2 - 72) < 6
