"""Patches of a frame: cut with replicated borders, resized."""

import math

import cv2
import numpy as np

from mscf.arrays import Image


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


def sample(frame: Image, center_rc: tuple[int, int], size_hw: tuple[int, int], out_hw: tuple[int, int]) -> Image:
    """`crop` resized to `out_hw` (rows, columns), as the published code does (spec B2); uint8 as `frame`.

    Bilinear if it enlarges, else the area mean, whose time grows with the crop.
    """
    patch = crop(frame, center_rc, size_hw)
    if patch.shape[:2] == out_hw:
        return np.ascontiguousarray(patch)
    enlarges = out_hw[1] > patch.shape[0]  # columns against rows: the published code's slip, kept (spec B8)
    return _resized(patch, out_hw, cv2.INTER_LINEAR if enlarges else cv2.INTER_AREA)


def sample_exact(
    frame: Image, pos_rc: tuple[float, float], size_hw: tuple[float, float], out_hw: tuple[int, int]
) -> Image:
    """Rectangle of any size around any point, resized to `out_hw` (rows, columns); uint8 as `frame`.

    Not the published sampling, which cuts whole pixels around a pixel: of a target of 10 px that is off by up to a
    tenth of it, and by another part at another scale. What lies outside the frame repeats the border pixels. The time
    does not grow with the rectangle: up to a reduction by 2 it is bilinear, beyond that the mean of 2 x 2 such samples.

    Parameters
    ----------
    pos_rc : centre, in pixel coordinates; a pixel's own centre is at whole numbers.
    size_hw : rows and columns to cover, in frame pixels; anywhere, also wholly outside the frame.
    """
    is_fine = max(size_hw[0] / out_hw[0], size_hw[1] / out_hw[1]) > 2
    grid_hw = (2 * out_hw[0], 2 * out_hw[1]) if is_fine else out_hw
    rows, cols = frame.shape[:2]
    top, left = pos_rc[0] - size_hw[0] / 2, pos_rc[1] - size_hw[1] / 2
    # the part of the frame that is looked at, for OpenCV takes none of over 32 767 px; at least one pixel
    first_r, first_c = (int(min(max(math.floor(edge), 0), n - 1)) for edge, n in ((top, rows), (left, cols)))
    last_r, last_c = math.ceil(top + size_hw[0]) + 1, math.ceil(left + size_hw[1]) + 1
    part = frame[first_r : max(last_r, first_r + 1), first_c : max(last_c, first_c + 1)]
    step_r, step_c = size_hw[0] / grid_hw[0], size_hw[1] / grid_hw[1]
    # sample i of the grid is the middle of its step
    to_part = np.array([[step_c, 0, left - first_c + step_c / 2], [0, step_r, top - first_r + step_r / 2]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    grid = cv2.warpAffine(part, to_part, (grid_hw[1], grid_hw[0]), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    whole = np.asarray(grid, dtype=np.uint8)
    return _resized(whole, out_hw, cv2.INTER_AREA) if is_fine else whole


def _resized(patch: Image, out_hw: tuple[int, int], interpolation: int) -> Image:
    return np.asarray(cv2.resize(patch, (out_hw[1], out_hw[0]), interpolation=interpolation), dtype=np.uint8)
