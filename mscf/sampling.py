"""Patches of a frame: cut with replicated borders, resized."""

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.config import ResamplingRule


def crop(frame: Image, center_rc: tuple[int, int], size_hw: tuple[int, int]) -> Image:
    """Rectangle of `frame` around a pixel; what lies outside repeats the border pixels (spec B2).

    Parameters
    ----------
    frame : (H, W) or (H, W, 3) uint8.
    center_rc : 0-based pixel; of an even size, the pixel left and above the middle.
    size_hw : rows and columns to cover, in frame pixels; anywhere, also wholly outside the frame.

    Returns
    -------
    (h, w[, 3]) uint8; a view of `frame` where the rectangle lies inside it.
    """
    (h, w), (rows, cols) = size_hw, frame.shape[:2]
    top, left = center_rc[0] + 1 - h // 2, center_rc[1] + 1 - w // 2
    if top >= 0 and left >= 0 and top + h <= rows and left + w <= cols:
        return frame[top : top + h, left : left + w]
    row = np.clip(np.arange(top, top + h), 0, rows - 1)
    col = np.clip(np.arange(left, left + w), 0, cols - 1)
    return frame[row[:, None], col]


def sample(
    frame: Image, center_rc: tuple[int, int], size_hw: tuple[int, int], out_hw: tuple[int, int], *, rule: ResamplingRule
) -> Image:
    """`crop` resized to `out_hw` (rows, columns); uint8 as `frame`.

    rule "area" : bilinear if it enlarges, else the area mean, as the published code does (spec B2). The time of
        an area mean grows with the crop.
    rule "bounded" : bilinear up to a reduction by 2, beyond that the mean of 2 x 2 pixels nearest to a grid of
        twice the resolution. The time does not grow with the crop.
    """
    reduction = max(size_hw[0] / out_hw[0], size_hw[1] / out_hw[1])
    if rule == "bounded" and reduction > 2:
        fine = _nearest(frame, center_rc, size_hw, (2 * out_hw[0], 2 * out_hw[1]))
        return _resized(fine, out_hw, cv2.INTER_AREA)
    patch = crop(frame, center_rc, size_hw)
    if patch.shape[:2] == out_hw:
        return np.ascontiguousarray(patch)
    enlarges = out_hw[1] > patch.shape[0]  # columns against rows: the published code's slip, kept (spec B8)
    return _resized(patch, out_hw, cv2.INTER_LINEAR if rule == "bounded" or enlarges else cv2.INTER_AREA)


def _resized(patch: Image, out_hw: tuple[int, int], interpolation: int) -> Image:
    return np.asarray(cv2.resize(patch, (out_hw[1], out_hw[0]), interpolation=interpolation), dtype=np.uint8)


def _nearest(frame: Image, center_rc: tuple[int, int], size_hw: tuple[int, int], out_hw: tuple[int, int]) -> Image:
    """Pixels of `crop` nearest to a regular grid of `out_hw`, without making the crop."""
    rows, cols = frame.shape[:2]
    top, left = center_rc[0] + 1 - size_hw[0] // 2, center_rc[1] + 1 - size_hw[1] // 2
    # the part of the frame that is looked at; at least the pixel that would be repeated
    first_r, first_c = min(max(top, 0), rows - 1), min(max(left, 0), cols - 1)
    part = frame[first_r : max(top + size_hw[0], first_r + 1), first_c : max(left + size_hw[1], first_c + 1)]
    step_r, step_c = size_hw[0] / out_hw[0], size_hw[1] / out_hw[1]
    # pixel i of the grid looks at the middle of its step
    to_part = np.array([[step_c, 0, left - first_c + step_c / 2 - 0.5], [0, step_r, top - first_r + step_r / 2 - 0.5]])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    grid = cv2.warpAffine(part, to_part, (out_hw[1], out_hw[0]), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(grid, dtype=np.uint8)
