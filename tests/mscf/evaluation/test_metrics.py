"""Metrics against values worked by hand."""

import math

import numpy as np
import pytest

from mscf.evaluation.metrics import center_errors_px, overlaps, score
from mscf.geometry import Box

TRUE = Box(10, 10, 40, 20)


def test_centre_error_is_the_distance_of_the_centres() -> None:
    boxes = [TRUE, Box(13, 14, 40, 20), Box(0, 0, 60, 40)]
    assert center_errors_px(boxes, [TRUE] * 3).tolist() == [0, 5, 0]


@pytest.mark.parametrize(("shift_px", "precision"), [(19.9, 1), (20.0, 1), (20.1, 0)])
def test_precision_counts_errors_up_to_20_px(shift_px: float, precision: float) -> None:
    assert score([Box(10 + shift_px, 10, 40, 20)], [TRUE]).precision == precision


def test_auc_is_the_mean_success_over_21_thresholds() -> None:
    # overlap 1/3 exceeds the thresholds 0, 0.05 ... 0.30: 7 of 21
    assert score([Box(10, 20, 40, 20)], [TRUE]).auc == pytest.approx(7 / 21)
    # a perfect box exceeds all but 1.00
    assert score([TRUE], [TRUE]).auc == pytest.approx(20 / 21)
    assert score([Box(500, 500, 9, 9)], [TRUE]).auc == 0
    assert score([TRUE, Box(500, 500, 9, 9)], [TRUE, TRUE]).auc == pytest.approx(10 / 21)


def test_frames_without_truth_do_not_count() -> None:
    boxes = [TRUE, Box(500, 500, 9, 9), TRUE]
    found = score(boxes, [TRUE, None, TRUE])
    assert (found.precision, found.auc) == (1, pytest.approx(20 / 21))
    assert np.isnan(overlaps(boxes, [TRUE, None, TRUE])).tolist() == [False, True, False]


def test_without_any_truth_there_is_no_score() -> None:
    found = score([TRUE], [None])
    assert math.isnan(found.precision)
    assert math.isnan(found.auc)
