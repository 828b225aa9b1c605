"""Errors of a run against the truth, and what the benchmarks make of them.

Wu, Lim, Yang, "Online Object Tracking: A Benchmark", CVPR 2013 (OTB): precision, success and its area. Müller et al.,
"TrackingNet", ECCV 2018: normalised precision. Frames without truth do not count; the first frame counts, as in OTB,
with the box the tracker was given, where OTB's code puts the true one (the same but for SRE).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mscf.arrays import Real64
from mscf.geometry import Box

PRECISION_PX = 20.0
ERROR_THRESHOLDS_PX = np.arange(51.0)
OVERLAP_THRESHOLDS = np.linspace(0, 1, 21)
NORM_THRESHOLDS = np.linspace(0, 0.5, 51)
HALF = 10  # index of 0.5 in OVERLAP_THRESHOLDS


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Of each frame of a run, the first included; NaN where there is no truth.

    A box that is not finite is a miss like one out of sight: no overlap, infinite errors.
    """

    overlap: Real64  # (n,) intersection over union, 0..1
    center_px: Real64  # (n,) distance of the centres
    center_norm: Real64  # (n,) so, x in widths and y in heights of the true box


@dataclass(frozen=True, slots=True)
class Score:
    """Accuracy of one run in 0..1; NaN where no frame has truth."""

    precision: float  # share of frames with a centre error of at most 20 px
    norm_precision: float  # mean over 51 thresholds, 0 to 0.5, of the share with at most that normalised error
    auc: float  # mean over 21 thresholds of the share of frames with a larger overlap
    op50: float  # share of frames with an overlap over 0.5


def errors_of(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Errors:
    """Compare boxes with the truth of the same frames.

    Raises
    ------
    ValueError
        If their numbers differ.
    """
    normed = [
        np.nan if true is None else _distance(box, true, true.w, true.h) for box, true in zip(boxes, truth, strict=True)
    ]
    return Errors(overlaps(boxes, truth), center_errors_px(boxes, truth), np.array(normed, dtype=np.float64))


def center_errors_px(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Real64:
    """Distance of the centres, (n,) px; NaN where there is no truth."""
    found = [np.nan if true is None else _distance(box, true, 1, 1) for box, true in zip(boxes, truth, strict=True)]
    return np.array(found, dtype=np.float64)


def overlaps(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Real64:
    """Intersection over union, (n,) in 0..1; NaN where there is no truth."""
    found = [np.nan if true is None else box.iou(true) for box, true in zip(boxes, truth, strict=True)]
    return np.minimum(np.array(found, dtype=np.float64), 1)  # by rounding, a box may overlap itself by more


def score(errors: Errors) -> Score:
    """Accuracy of a run.

    Normalised precision is the area under its curve from 0 to 0.5, as TrackingNet ranks by; LaSOT's toolkit takes the
    curve's value at 0.2 instead.
    """
    success = success_curve(errors)
    return Score(
        precision=float(_share(np.less_equal, errors.center_px, np.array([PRECISION_PX]))[0]),
        norm_precision=float(norm_precision_curve(errors).mean()),
        auc=float(success.mean()),
        op50=float(success[HALF]),
    )


def precision_curve(errors: Errors) -> Real64:
    """Share of frames with a centre error of at most ERROR_THRESHOLDS_PX, (51,); NaN where no frame has truth."""
    return _share(np.less_equal, errors.center_px, ERROR_THRESHOLDS_PX)


def norm_precision_curve(errors: Errors) -> Real64:
    """Share of frames with a normalised error of at most NORM_THRESHOLDS, (51,); NaN where no frame has truth."""
    return _share(np.less_equal, errors.center_norm, NORM_THRESHOLDS)


def success_curve(errors: Errors) -> Real64:
    """Share of frames with an overlap over OVERLAP_THRESHOLDS, (21,); NaN where no frame has truth."""
    return _share(np.greater, errors.overlap, OVERLAP_THRESHOLDS)


def _share(compare: np.ufunc, values: Real64, thresholds: Real64) -> Real64:
    """Share of the known values that compare so with each threshold: (n,), (t,) -> (t,)."""
    known = values[~np.isnan(values)]
    if not known.size:
        return np.full(thresholds.shape, np.nan)
    return np.asarray(np.mean(compare(known[None, :], thresholds[:, None]), axis=1))  # (t, n) -> (t,)


def _distance(box: Box, true: Box, unit_x: float, unit_y: float) -> float:
    """Distance of the centres in such units; infinite where the box is not finite."""
    if not box.is_finite:
        return math.inf
    (x, y), (true_x, true_y) = box.center_xy, true.center_xy
    return math.hypot((x - true_x) / unit_x, (y - true_y) / unit_y)
