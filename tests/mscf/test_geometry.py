import pytest

from mscf.geometry import Box, round_half_away


def test_a_box_of_odd_size_has_its_centre_on_a_pixel() -> None:
    assert Box(10, 20, 5, 3).to_pos_size() == ((21, 12), (3, 5))


@pytest.mark.parametrize("box", [Box(0, 0, 4, 4), Box(10.5, -3.25, 17, 9.5), Box(1e4, 1e4, 1, 1)])
def test_centre_and_size_give_the_box_back(box: Box) -> None:
    assert Box.from_pos_size(*box.to_pos_size()) == box


def test_the_first_pixel_of_a_ground_truth_file_is_our_origin() -> None:
    assert Box.from_one_based(1, 1, 8, 6) == Box(0, 0, 8, 6)
    assert Box(0, 0, 8, 6).to_one_based() == (1, 1, 8, 6)


@pytest.mark.parametrize(
    ("other", "iou"),
    [
        (Box(0, 0, 10, 10), 1.0),
        (Box(5, 0, 10, 10), 1 / 3),
        (Box(10, 0, 10, 10), 0.0),
        (Box(2, 2, 5, 4), 0.2),
        (Box(50, 50, 1, 1), 0.0),
    ],
)
def test_overlap_of_known_boxes(other: Box, iou: float) -> None:
    assert Box(0, 0, 10, 10).iou(other) == pytest.approx(iou)
    assert other.iou(Box(0, 0, 10, 10)) == pytest.approx(iou)


def test_two_empty_boxes_do_not_overlap() -> None:
    assert Box(3, 3, 0, 0).iou(Box(3, 3, 0, 0)) == 0


@pytest.mark.parametrize(("value", "rounded"), [(0.5, 1), (1.5, 2), (2.5, 3), (-0.5, -1), (-2.5, -3), (2.49, 2)])
def test_halves_are_rounded_away_from_zero(value: float, rounded: int) -> None:
    assert round_half_away(value) == rounded
