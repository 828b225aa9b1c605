"""Vision: a selection takes effect on the next frame, and whatever the tracker does is a sample, not an exception."""

import math

import numpy as np
import pytest
from mover import FIRST, moving_target

from companion.types import Frame, Selection, TrackSample
from companion.vision import FROZEN, Vision
from mscf import Box, LongTermTracker, TrackStatus

FRAMES = moving_target()
NOTHING, TARGET = Selection(0, None), Selection(1, FIRST)


def frame(index: int, *, picture: int | None = None, period_s: float = 1 / 30) -> Frame:
    image = FRAMES[index % len(FRAMES) if picture is None else picture]
    return Frame(image, index, 10.0 + index * period_s)


def tracked(vision: Vision, count: int) -> list[TrackSample]:
    return [vision.see(frame(index), TARGET, None) for index in range(count)]


def test_without_a_selection_a_sample_says_that_and_the_frames_size() -> None:
    assert Vision().see(frame(3), NOTHING, None) == TrackSample(3, 10.1, 10.1, (96, 128), 0)


def test_a_selection_is_tracked_from_its_frame_on() -> None:
    for index, sample in enumerate(tracked(Vision(), 8)):
        assert (sample.seq, sample.selection, sample.fault) == (index, 1, "")
        assert sample.captured_s == pytest.approx(10.0 + index / 30)
        assert sample.status is TrackStatus.TRACKING
        assert sample.is_measured
        assert sample.box is not None
        assert sample.box.iou(Box(40 + 3 * index, 30 + 2 * index, 24, 18)) > 0.6


def test_nothing_selected_again_ends_the_tracking() -> None:
    vision = Vision()
    tracked(vision, 3)
    sample = vision.see(frame(3), Selection(2, None), None)
    assert (sample.selection, sample.status, sample.box, sample.fault) == (2, None, None, "")


def test_another_selection_begins_anew() -> None:
    vision = Vision()
    tracked(vision, 2)
    other = Box(10, 60, 20, 20)
    sample = vision.see(frame(2), Selection(2, other), None)
    assert sample.box is not None
    assert sample.box.iou(other) > 0.5


def test_of_a_point_the_box_is_grown_on_the_frame_that_it_takes_effect_on() -> None:
    """The picture of a bright car on dull ground, clicked beside its middle: no box of that size was given."""
    image = np.random.default_rng(5).integers(90, 110, (240, 320, 3), np.uint8)
    image[100:124, 140:190] = (40, 60, 230)
    sample = Vision().see(Frame(image, 0, 1.0), Selection(1, Box(158 - 16, 109 - 16, 32, 32), is_point=True), None)
    assert (sample.selection, sample.fault) == (1, "")
    assert sample.box is not None
    assert sample.box.iou(Box(140, 100, 50, 24)) > 0.8


@pytest.mark.parametrize("at", [math.nan, math.inf, -1e9])
def test_a_point_that_is_nowhere_is_no_exception(at: float) -> None:
    sample = Vision().see(frame(0), Selection(1, Box(at, 10, 20, 20), is_point=True), None)
    assert sample.selection == 1


@pytest.mark.parametrize("box", [Box(500, 500, 20, 20), Box(0, 0, 0, 0), Box(float("nan"), 0, 20, 20)])
def test_a_box_that_the_tracker_refuses_is_a_fault_of_every_sample_until_the_next_selection(box: Box) -> None:
    """The command loop may not see each of them."""
    vision = Vision()
    samples = [vision.see(frame(index), Selection(1, box), None) for index in range(3)]
    assert all(sample.fault for sample in samples)
    assert not any(sample.is_measured for sample in samples)
    assert vision.see(frame(3), Selection(2, Box(49, 36, 24, 18)), None).fault == ""


def test_a_camera_that_changes_its_size_is_a_fault_not_an_exception() -> None:
    vision = Vision()
    tracked(vision, 2)
    sample = vision.see(Frame(np.zeros((48, 64, 3), np.uint8), 2, 10.1), TARGET, None)
    assert "64" in sample.fault
    assert not sample.is_measured
    assert vision.see(frame(3), TARGET, None).fault == sample.fault


class _Broken(LongTermTracker):
    """A tracker with a mistake."""

    def update(self, *_: object) -> None:
        raise ZeroDivisionError("division by zero")


def test_a_tracker_that_breaks_is_a_fault_and_the_application_stays_up() -> None:
    vision = Vision()
    tracked(vision, 2)
    vision._tracker = _Broken()
    samples = [vision.see(frame(index), TARGET, None) for index in (2, 3)]
    assert [sample.fault for sample in samples] == ["ZeroDivisionError: division by zero"] * 2
    assert not any(sample.is_measured for sample in samples)


def test_a_picture_that_repeats_itself_is_no_measurement_after_half_a_second_until_it_moves_again() -> None:
    vision = Vision()
    vision.see(frame(0, period_s=0.1), TARGET, None)
    repeated = [vision.see(frame(index, picture=1, period_s=0.1), TARGET, None) for index in range(1, 9)]
    assert [sample.fault for sample in repeated] == [""] * 5 + [FROZEN] * 3
    assert [sample.is_measured for sample in repeated] == [True] * 5 + [False] * 3
    moved = [vision.see(frame(index, picture=index - 7, period_s=0.1), TARGET, None) for index in (9, 10)]
    assert [(sample.fault, sample.is_measured) for sample in moved] == [("", True)] * 2


def test_the_frame_is_not_written_to_nor_kept() -> None:
    image = FRAMES[0].copy()
    image.setflags(write=False)
    vision = Vision()
    vision.see(Frame(image, 0, 10.0), TARGET, None)
    assert vision._last is not None
    assert not np.shares_memory(vision._last, image)
