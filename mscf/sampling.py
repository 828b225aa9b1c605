"""Patches of a frame: cut with replicated borders, resized."""

import cv2
import numpy as np

from mscf.arrays import Image


def crop(frame: Image, center_rc: tuple[int, int], size_hw: tuple[int, int], *, stride: int = 1) -> Image:
    """Rectangle of `frame` around a pixel; what lies outside repeats the border pixels (spec B2).

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) uint8.
    center_rc : 0-based pixel; of an even size, the pixel left and above the middle.
    size_hw : rows and columns to cover, in frame pixels; anywhere, also wholly outside the frame.
    stride : take the middle one of each `stride` rows and columns only.

    Returns
    -------
    (ceil((h - stride//2) / stride), likewise[, 3]) uint8; a view of `frame` where the rectangle lies inside it.
    """
    (h, w), (rows, cols) = size_hw, frame.shape[:2]
    top, left = center_rc[0] + 1 - h // 2, center_rc[1] + 1 - w // 2
    middle = stride // 2
    if top >= 0 and left >= 0 and top + h <= rows and left + w <= cols:
        return frame[top + middle : top + h : stride, left + middle : left + w : stride]
    row = np.clip(np.arange(top + middle, top + h, stride), 0, rows - 1)
    col = np.clip(np.arange(left + middle, left + w, stride), 0, cols - 1)
    return frame[row[:, None], col]


def sample(
    frame: Image,
    center_rc: tuple[int, int],
    size_hw: tuple[int, int],
    out_hw: tuple[int, int],
    *,
    oversampling: float | None,
) -> Image:
    """`crop` resized to `out_hw` (rows, columns); uint8 as `frame`.

    Bilinear if it enlarges, else area mean, as the published code does. The cost of an area mean grows with
    the target; with `oversampling` = q the crop is thinned first, to no less than q samples for each pixel of
    the result along either axis, so that it does not. None keeps every pixel.
    """
    stride = 1
    if oversampling is not None:
        thinning = min(size_hw[0] / out_hw[0], size_hw[1] / out_hw[1]) / oversampling
        stride = max(1, int(thinning))
    patch = crop(frame, center_rc, size_hw, stride=stride)
    if patch.shape[:2] == out_hw:
        return np.ascontiguousarray(patch)
    enlarging = out_hw[1] > patch.shape[0]  # columns against rows: the published code's slip, kept (spec B8)
    interpolation = cv2.INTER_LINEAR if enlarging else cv2.INTER_AREA
    return np.asarray(cv2.resize(patch, (out_hw[1], out_hw[0]), interpolation=interpolation), dtype=np.uint8)
