"""Metrics against values worked by hand, and against the published definitions written out."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mscf.evaluation.metrics import (
    ERROR_THRESHOLDS_PX,
    NORM_THRESHOLDS,
    OVERLAP_THRESHOLDS,
    Errors,
    Score,
    center_errors_px,
    errors_of,
    norm_precision_curve,
    overlaps,
    precision_curve,
    score,
    success_curve,
)
from mscf.geometry import Box

TRUE = Box(10, 10, 40, 20)
FAR = Box(500, 500, 9, 9)

places = st.floats(-50, 150)
sizes = st.floats(1, 80)
boxes_of_any_kind = st.builds(Box, places, places, sizes, sizes)
frames = st.lists(st.tuples(boxes_of_any_kind, st.none() | boxes_of_any_kind), min_size=1, max_size=12)


def scored(box: Box, true: Box | None = TRUE) -> Score:
    return score(errors_of([box], [true]))


def test_centre_error_is_the_distance_of_the_centres() -> None:
    boxes = [TRUE, Box(13, 14, 40, 20), Box(0, 0, 60, 40)]
    assert center_errors_px(boxes, [TRUE] * 3).tolist() == [0, 5, 0]


def test_normalised_error_is_in_widths_and_heights_of_the_true_box() -> None:
    boxes = [Box(10 + 12, 10 + 8, 40, 20), Box(10 - 40, 10, 40, 20), Box(20, 15, 20, 10)]
    assert errors_of(boxes, [TRUE] * 3).center_norm.tolist() == [0.5, 1, 0]


@pytest.mark.parametrize(("shift_px", "precision"), [(19.9, 1), (20.0, 1), (20.1, 0)])
def test_precision_counts_errors_up_to_20_px(shift_px: float, precision: float) -> None:
    assert scored(Box(10 + shift_px, 10, 40, 20)).precision == precision


@pytest.mark.parametrize(
    ("box", "op50"),
    [(Box(10, 10, 20, 20), 0), (Box(10, 10, 20.1, 20), 1), (TRUE, 1), (FAR, 0)],  # overlap 1/2, just over it, 1, 0
)
def test_success_at_a_half_needs_more_than_a_half(box: Box, op50: float) -> None:
    assert scored(box).op50 == op50


def test_auc_is_the_mean_success_over_21_thresholds() -> None:
    # overlap 1/3 exceeds the thresholds 0, 0.05 ... 0.30: 7 of 21
    assert scored(Box(10, 20, 40, 20)).auc == pytest.approx(7 / 21)
    # a perfect box exceeds all but 1.00
    assert scored(TRUE).auc == pytest.approx(20 / 21)
    assert scored(FAR).auc == 0
    assert score(errors_of([TRUE, FAR], [TRUE, TRUE])).auc == pytest.approx(10 / 21)


def test_no_box_overlaps_the_truth_by_more_than_all_of_it() -> None:
    odd = Box(0, 63, 1, 1.356310414795085)  # its height is not that of its edges, by rounding
    assert odd.iou(odd) > 1
    assert overlaps([odd], [odd]).tolist() == [1]
    assert scored(odd, odd).auc == pytest.approx(20 / 21)


def test_normalised_precision_is_the_mean_over_51_thresholds_up_to_a_half() -> None:
    # an error of 10 of 40 px is at most the thresholds 0.25, 0.26 ... 0.50: 26 of 51
    assert scored(Box(20, 10, 40, 20)).norm_precision == pytest.approx(26 / 51)
    assert scored(TRUE).norm_precision == 1
    assert scored(Box(10 + 21, 10, 40, 20)).norm_precision == 0


def test_frames_without_truth_do_not_count() -> None:
    boxes = [TRUE, FAR, TRUE]
    found = errors_of(boxes, [TRUE, None, TRUE])
    assert score(found) == score(errors_of([TRUE, TRUE], [TRUE, TRUE])) == Score(1, 1, pytest.approx(20 / 21), 1)
    for values in (found.overlap, found.center_px, found.center_norm, overlaps(boxes, [TRUE, None, TRUE])):
        assert np.isnan(values).tolist() == [False, True, False]


def test_without_any_truth_there_is_no_score() -> None:
    errors = errors_of([TRUE, TRUE], [None, None])
    found = score(errors)
    assert all(math.isnan(value) for value in (found.precision, found.norm_precision, found.auc, found.op50))
    for curve, count in ((precision_curve, 51), (norm_precision_curve, 51), (success_curve, 21)):
        assert np.isnan(curve(errors)).tolist() == [True] * count


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_a_box_that_is_not_finite_is_a_miss_and_not_a_frame_without_truth(value: float, place: int) -> None:
    numbers = [10.0, 10.0, 40.0, 20.0]
    numbers[place] = value
    assert scored(Box(*numbers)) == Score(0, 0, 0, 0)


@pytest.mark.parametrize(
    "box", [Box(10, 10, 0, 0), Box(10, 10, -40, -20), Box(10, 10, -40, 20), Box(1e308, 0, 1e308, 1)]
)
def test_a_box_without_area_or_out_of_the_world_overlaps_nothing(box: Box) -> None:
    assert scored(box).auc == 0


def test_boxes_and_truth_of_different_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        errors_of([TRUE], [TRUE, TRUE])


def test_scores_change_no_errors() -> None:
    kept = [np.array([0.5, np.nan, 0.2]), np.array([3.0, np.nan, 30.0]), np.array([0.1, np.nan, 1.0])]
    errors = Errors(*(values.copy() for values in kept))
    for values in (errors.overlap, errors.center_px, errors.center_norm):
        values.setflags(write=False)
    score(errors)
    for before, after in zip(kept, (errors.overlap, errors.center_px, errors.center_norm), strict=True):
        np.testing.assert_array_equal(before, after)


def share(values: list[float], is_hit: list[bool]) -> float:
    return sum(is_hit) / len(values)


def published(boxes: list[Box], truth: list[Box | None]) -> dict[str, list[float]]:
    """Curves by the published definitions, over corners and one frame at a time.

    OTB: the overlap is the shared area of both boxes by the area of their union, the error the distance of their
    centres; curves over overlaps > 0, 0.05 ... 1 and errors <= 0, 1 ... 50 px. TrackingNet: both components of the
    distance by the true box's sides; a curve over 0, 0.01 ... 0.5.
    """
    shared, distances, norms = [], [], []
    for box, true in zip(boxes, truth, strict=True):
        if true is None:
            continue
        left, right = sorted((box.x, box.x + box.w, true.x, true.x + true.w))[1:3]
        top, bottom = sorted((box.y, box.y + box.h, true.y, true.y + true.h))[1:3]
        is_apart_x = box.x + box.w < true.x or true.x + true.w < box.x
        is_apart_y = box.y + box.h < true.y or true.y + true.h < box.y
        inner = 0.0 if is_apart_x or is_apart_y else (right - left) * (bottom - top)
        shared.append(inner / (box.w * box.h + true.w * true.h - inner))
        dx = (box.x + (box.w - 1) / 2) - (true.x + (true.w - 1) / 2)
        dy = (box.y + (box.h - 1) / 2) - (true.y + (true.h - 1) / 2)
        distances.append((dx**2 + dy**2) ** 0.5)
        norms.append(((dx / true.w) ** 2 + (dy / true.h) ** 2) ** 0.5)
    return {
        "success": [share(shared, [value > step / 20 for value in shared]) for step in range(21)],
        "precision": [share(distances, [value <= px for value in distances]) for px in range(51)],
        "norm": [share(norms, [value <= step / 100 for value in norms]) for step in range(51)],
    }


def test_curves_and_scores_are_those_of_the_published_definitions(rng: np.random.Generator) -> None:
    for _ in range(60):
        known = [Box(*rng.uniform(0, 200, 2), *rng.uniform(4, 90, 2)) for _ in range(40)]
        boxes = [
            Box(true.x + rng.normal(0, 15), true.y + rng.normal(0, 15), true.w * rng.uniform(0.4, 2), true.h)
            for true in known
        ]
        truth: list[Box | None] = [*known]
        for hidden in rng.choice(40, 6, replace=False):
            truth[hidden] = None
        errors, expected = errors_of(boxes, truth), published(boxes, truth)
        assert success_curve(errors) == pytest.approx(expected["success"])
        assert precision_curve(errors) == pytest.approx(expected["precision"])
        assert norm_precision_curve(errors) == pytest.approx(expected["norm"])
        found = score(errors)
        assert found.auc == pytest.approx(sum(expected["success"]) / 21)
        assert found.precision == pytest.approx(expected["precision"][20])
        assert found.op50 == pytest.approx(expected["success"][10])
        assert found.norm_precision == pytest.approx(sum(expected["norm"]) / 51)


@given(frames)
def test_curves_are_shares_that_only_rise_with_the_error_and_fall_with_the_overlap(
    pairs: list[tuple[Box, Box | None]],
) -> None:
    boxes, truth = [box for box, _ in pairs], [true for _, true in pairs]
    if all(true is None for true in truth):
        truth[0] = TRUE
    errors = errors_of(boxes, truth)
    curves = precision_curve(errors), norm_precision_curve(errors), success_curve(errors)
    for curve, thresholds in zip(curves, (ERROR_THRESHOLDS_PX, NORM_THRESHOLDS, OVERLAP_THRESHOLDS), strict=True):
        assert curve.shape == thresholds.shape
        assert curve.min() >= 0
        assert curve.max() <= 1
    assert (np.diff(curves[0]) >= 0).all()
    assert (np.diff(curves[1]) >= 0).all()
    assert (np.diff(curves[2]) <= 0).all()
    assert curves[2][-1] == 0
    assert score(errors).precision == curves[0][20]


@given(frames)
def test_errors_are_those_of_each_frame_alone_and_overlap_does_not_mind_which_box_is_true(
    pairs: list[tuple[Box, Box | None]],
) -> None:
    together = errors_of([box for box, _ in pairs], [true for _, true in pairs])
    for index, (box, true) in enumerate(pairs):
        alone = errors_of([box], [true])
        for values, value in (
            (together.overlap, alone.overlap),
            (together.center_px, alone.center_px),
            (together.center_norm, alone.center_norm),
        ):
            np.testing.assert_array_equal(values[index : index + 1], value)
        if true is not None:
            assert errors_of([true], [box]).overlap == pytest.approx(alone.overlap)
