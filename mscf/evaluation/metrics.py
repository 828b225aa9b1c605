"""Precision and success of a run, as OTB defines them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mscf.arrays import Real64
from mscf.geometry import Box

PRECISION_PX = 20.0
OVERLAP_THRESHOLDS = np.linspace(0, 1, 21)


@dataclass(frozen=True, slots=True)
class Score:
    """Accuracy of one run."""

    precision: float  # share of frames with a centre error of at most 20 px
    auc: float  # mean over 21 thresholds of the share of frames with a larger overlap


def center_errors_px(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Real64:
    """Distance of the centres, (n,) px; NaN where there is no truth."""
    return np.array(
        [
            np.nan if true is None else np.hypot(*np.subtract(box.center_xy, true.center_xy))
            for box, true in zip(boxes, truth, strict=True)
        ]
    )


def overlaps(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Real64:
    """Intersection over union, (n,) in 0..1; NaN where there is no truth."""
    return np.array(
        [np.nan if true is None else box.iou(true) for box, true in zip(boxes, truth, strict=True)], dtype=np.float64
    )


def score(boxes: Sequence[Box], truth: Sequence[Box | None]) -> Score:
    """Precision and AUC over the frames that have a true box; NaN if none has.

    The first frame counts, as in OTB.
    """
    errors, shared = center_errors_px(boxes, truth), overlaps(boxes, truth)
    known = np.isfinite(shared)
    if not known.any():
        return Score(float("nan"), float("nan"))
    precision = float(np.mean(errors[known] <= PRECISION_PX))
    success = np.mean(shared[known][None, :] > OVERLAP_THRESHOLDS[:, None], axis=1)  # (21,)
    return Score(precision, float(np.mean(success)))
