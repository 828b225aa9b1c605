"""Where to look for a lost target, and what it looked like."""

import math
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from mscf.arrays import Image, Real64
from mscf.geometry import Box
from mscf.kernels import Kernels

LOOKS_SIDE_PX = 32  # of the resized patch whose features are compared: 8 x 8 cells
LOOKS_MARGIN = 1.5  # side of that patch over the box's: the outline tells more than the inside, as measured
LOOKS_RATE = 0.1  # of the running mean, per trusted frame
PICTURE_PX = 10.0  # side of the target in the small picture that is matched: as measured, 8 is worse
FRAME_PX2 = 100_000.0  # area of a frame it is matched with, at most: bounds the time
RANKS = 4  # best matches that are looked at in turn: the best one alone would always be the same wrong thing
STEP = 1.75  # of the grid, over the target's size: the window lets a look see about as far to either side


@dataclass(frozen=True, slots=True)
class Looks:
    """What a target looked like in the frames in which it was trusted."""

    features: Real64  # (F,) running mean of features
    picture: Image  # (h, w[, 3]) the last one, small
    shrink: float  # side of that picture over that of the box
    kernels: Kernels

    @classmethod
    def of(cls, frame: Image, box: Box, kernels: Kernels) -> Self:
        """What is in `box` of `frame`."""
        rows, cols = frame.shape[:2]
        pos_rc, (h, w) = box.to_pos_size()
        shrink = min(1.0, PICTURE_PX / math.sqrt(h * w), math.sqrt(FRAME_PX2 / (rows * cols)))
        picture_hw = max(3, round(h * shrink)), max(3, round(w * shrink))
        picture = kernels.sample_exact(frame, pos_rc, np.array([[h, w]]), picture_hw)[0]
        return cls(outline(frame, box, kernels), picture, shrink, kernels)

    def after(self, frame: Image, box: Box) -> "Looks":
        """Looks with one more trusted frame."""
        last = Looks.of(frame, box, self.kernels)
        return replace(last, features=self.features + LOOKS_RATE * (last.features - self.features))

    def similarity(self, frame: Image, box: Box) -> float:
        """Cosine of the features in `box` and the remembered ones, -1..1; 0 where one of them is nothing."""
        features = outline(frame, box, self.kernels)
        lengths = float(np.linalg.norm(features) * np.linalg.norm(self.features))
        return float(features @ self.features) / lengths if lengths > 0 else 0.0

    def best_match(self, frame: Image, rank: int) -> tuple[float, float] | None:
        """Centre (x, y) of the place in `frame` that is like the last picture; None where the frame is too small.

        rank : 0 is the best match, 1 the best one that does not overlap it, and so on.
        """
        rows, cols = frame.shape[:2]
        h, w = self.picture.shape[:2]
        small_hw = round(rows * self.shrink), round(cols * self.shrink)
        if small_hw[0] <= h or small_hw[1] <= w:
            return None
        middle_rc, whole_hw = ((rows - 1) / 2, (cols - 1) / 2), np.array([[rows, cols]], np.float64)
        small = self.kernels.sample_exact(frame, middle_rc, whole_hw, small_hw)[0]
        match = np.nan_to_num(cv2.matchTemplate(small, self.picture, cv2.TM_CCOEFF_NORMED), nan=-1.0, posinf=-1.0)
        row, col = np.unravel_index(int(np.argmax(match)), match.shape)
        for _ in range(rank):
            match[max(row - h + 1, 0) : row + h, max(col - w + 1, 0) : col + w] = -2
            row, col = np.unravel_index(int(np.argmax(match)), match.shape)
        return (float(col) + w / 2) * cols / small_hw[1], (float(row) + h / 2) * rows / small_hw[0]


def outline(frame: Image, box: Box, kernels: Kernels) -> Real64:
    """Gray and FHOG features around a box, of zero mean a channel and length 1, or 0 where nothing is seen: (F,)."""
    pos_rc, (h, w) = box.to_pos_size()
    sizes_hw, out_hw = np.array([[h * LOOKS_MARGIN, w * LOOKS_MARGIN]]), (LOOKS_SIDE_PX, LOOKS_SIDE_PX)
    patch = kernels.sample_exact(frame, pos_rc, sizes_hw, out_hw)[0]
    features = kernels.feature_stack(patch, None).astype(np.float64)
    features -= features.mean(axis=(1, 2), keepdims=True)
    length = float(np.linalg.norm(features))
    return features.ravel() / length if length > 0 else features.ravel()


def place_around(frame_hw: tuple[int, int], box: Box, origin_xy: tuple[float, float], turn: int) -> tuple[float, float]:
    """Where to look in turn 0, 1, 2 ...: the origin every other time, else the next place of a grid around it.

    The grid grows from the origin over the whole frame, and begins anew when it is done. Its outermost places, and
    an origin outside, are moved inwards so far that the box is within the frame: there a target comes in.

    Parameters
    ----------
    frame_hw : rows and columns of the frame.
    box : last one of the target, px.
    origin_xy : where it is expected, px.
    """
    rows, cols = frame_hw
    margin_xy = np.minimum([box.w / 2, box.h / 2], [cols / 2, rows / 2])
    low_xy, high_xy = margin_xy, np.array([cols, rows]) - margin_xy
    origin = np.clip(origin_xy, low_xy, high_xy)
    if turn % 2 == 0:
        return float(origin[0]), float(origin[1])
    step_px = STEP * math.sqrt(box.w * box.h)
    first, last = np.ceil((low_xy - origin) / step_px - 1), np.floor((high_xy - origin) / step_px + 1)
    steps = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True))), axis=-1)
    steps = steps.reshape(-1, 2)  # (P, 2) x, y
    steps = steps[np.argsort(np.hypot(steps[:, 0], steps[:, 1]), kind="stable")][1:]  # not the origin
    place = np.clip(origin + step_px * steps[turn // 2 % len(steps)], low_xy, high_xy)
    return float(place[0]), float(place[1])
