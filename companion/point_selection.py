"""From a click to a box: the object at a point of the picture, by its colours against those around it.

A click in a ground station (MAV_CMD_CAMERA_TRACK_POINT) says where the target is; the tracker has to know how large.
"""

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from mscf import Box
from mscf.arrays import Image, Real, Real64
from mscf.frame import MIN_BOX_PX

MIN_EXPECTED_PX = 40.0  # a radius of less, or of more than MAX_EXPECTED_SHARE of the frame's shorter side, says more
MAX_EXPECTED_SHARE = 0.06  # of the screen than of the object
MIN_CONTRAST = 0.06  # of the best box; noise without an object reaches 0.04

_Cells = npt.NDArray[np.int64]  # (n, 4) left, top, right, bottom of boxes, in cells of a window; the last two exclusive
_Colours = npt.NDArray[np.float32]  # (..., 3), CIE Lab

_WINDOWS = (0.8, 1.6, 3.2, 6.4)  # their sides, in expected sides
_CELLS = 64  # of a window, each way
_SIDES = (10, 12, 14, 17, 20, 24, 29, 34)  # of the boxes tried in each, in cells
_SHIFTS = (-0.28, -0.14, 0.0, 0.14, 0.28)  # of their middles from the point, in their sides
_MAX_ASPECT = 3.2  # of their sides
_MIN_SIDE = 6  # of a box, in cells: fewer are no histogram
_RIM = 0.3  # width of the strips around a box, in roots of its area
_PALETTE = 12  # colours of a window
_THUMBNAIL = 24  # side of the picture that they are taken from, in pixels
_NEAR_LAB = 4.0  # distance of colours that are as good as the same
_SIZE_COST = 0.5  # of the square of the logarithm of size over expected size
_SHIFT_COST = 5.0  # of the square of the shift
_SHARPNESS = 12.0  # of the mean over boxes: one that scores 0.1 less weighs 0.3


def box_around(image: Image, point_uv: tuple[float, float], radius_px: float) -> Box:
    """Box around the object at a point.

    Boxes of many sizes and shapes are laid around the point. Of each, the colours inside are compared with those in a
    narrow strip along each of its four sides, and the side where they differ least is what counts: a box that cuts
    through an object, or takes in ground on one side, has the same colours within and without there. The result
    is the mean of the boxes that stand out most. Boxes whose middle is near to the point and whose size is near to
    the expected one are preferred: click on the middle of the object, and draw a box by hand around what is much
    smaller or larger, or looks like what is beside it.

    The expected box is a square with a side of twice `radius_px`, but no more than `MAX_EXPECTED_SHARE` of the frame's
    shorter side, and then no less than `MIN_EXPECTED_PX`. Where nothing stands out, it is the result. No side is
    longer than four times it.

    Parameters
    ----------
    image : (H, W, 3) uint8 BGR; it is not written to.
    point_uv : a finite pixel (u, v), whose centre has integer coordinates; one outside the frame counts as the
        nearest one in it.
    radius_px : of the click, finite.

    Returns
    -------
    Whole pixels, inside the frame, with the point's pixel in it, each side at least `MIN_BOX_PX` where the frame has
    as many. Same arguments, same box, to the bit: nothing is random or remembered. Whatever the picture shows, nothing
    is raised.
    """
    rows, cols = image.shape[:2]
    u = math.floor(min(max(point_uv[0], 0.0), cols - 1.0) + 0.5)
    v = math.floor(min(max(point_uv[1], 0.0), rows - 1.0) + 0.5)
    expected_px = max(min(2 * radius_px, MAX_EXPECTED_SHARE * min(rows, cols)), MIN_EXPECTED_PX)

    windows = [_Window.cut(image, (u, v), round(share * expected_px)) for share in _WINDOWS]
    tried = [_judged(window, _boxes(), expected_px) for window in windows]
    scores = np.concatenate([one.scores for one in tried])
    contrasts = np.concatenate([one.contrasts for one in tried])
    if scores.size and contrasts[scores.argmax()] >= MIN_CONTRAST:
        middle_px, size_px = _mean_box(np.concatenate([one.edges_px for one in tried]), scores)
    else:
        middle_px, size_px = np.array((u + 0.5, v + 0.5)), np.array((expected_px, expected_px))
    x, w = _span(float(middle_px[0]), float(size_px[0]), u, cols)
    y, h = _span(float(middle_px[1]), float(size_px[1]), v, rows)
    return Box(x, y, w, h)


def _span(middle: float, side: float, pixel: int, length: int) -> tuple[float, float]:
    """Start and length in whole pixels, inside 0..length, with the pixel in it."""
    whole = min(max(round(side), math.ceil(MIN_BOX_PX)), length)
    start = min(max(round(middle - whole / 2), pixel - whole + 1), pixel)
    return float(min(max(start, 0), length - whole)), float(whole)


@dataclass(frozen=True, slots=True)
class _Window:
    """A square of the frame around the point, in cells.

    sums : (65, 65, K), integral image of how much of each colour of its palette is in a cell; 1 in all, 0 where the
        cell is outside the frame.
    frame : left, top, right, bottom of what is in the frame, in cells.
    point_px : place of the point in the frame, corner_px : of the window, as areas (x, y).
    """

    sums: Real64
    frame: _Cells
    point_px: Real64
    corner_px: Real64
    cell_px: float

    @classmethod
    def cut(cls, image: Image, pixel_uv: tuple[int, int], side_px: int) -> "_Window":
        rows, cols = image.shape[:2]
        left, top = (at - side_px // 2 for at in pixel_uv)
        right, bottom = left + side_px, top + side_px
        seen = image[max(top, 0) : bottom, max(left, 0) : right]
        margins = max(-top, 0), max(bottom - rows, 0), max(-left, 0), max(right - cols, 0)
        full = cv2.copyMakeBorder(seen, *margins, cv2.BORDER_REPLICATE)
        is_shrunk = side_px >= _CELLS
        cells = cv2.resize(full, (_CELLS, _CELLS), interpolation=cv2.INTER_AREA if is_shrunk else cv2.INTER_LINEAR)
        lab = np.asarray(cv2.cvtColor(cells.astype(np.float32) / 255, cv2.COLOR_BGR2LAB), np.float32)

        cell_px = side_px / _CELLS
        edges_px = np.array((max(left, 0) - left, max(top, 0) - top, min(right, cols) - left, min(bottom, rows) - top))
        frame = np.rint(edges_px / cell_px).astype(np.int64)
        point_px = np.array(pixel_uv) + 0.5
        return cls(_colour_sums(lab, frame), frame, point_px, np.array((left, top), np.float64), cell_px)


@dataclass(frozen=True, slots=True)
class _Judged:
    """Boxes in the frame, (n, 4) left, top, right, bottom, with their scores and contrasts, (n,)."""

    edges_px: Real64
    scores: Real64
    contrasts: Real64


def _judged(window: _Window, cells: _Cells, expected_px: float) -> _Judged:
    """What boxes are worth as far as they are in the frame; those that are too small there are left out.

    The score is the logarithm of the contrast less what size and shift cost.
    """
    left, top, right, bottom = window.frame
    inside = np.clip(cells, (left, top, left, top), (right, bottom, right, bottom))
    inside = inside[(inside[:, 2:] - inside[:, :2]).min(axis=1) >= _MIN_SIDE]
    edges_px = np.tile(window.corner_px, 2) + inside * window.cell_px
    size_px = edges_px[:, 2:] - edges_px[:, :2]
    shifts = ((edges_px[:, 2:] + edges_px[:, :2]) / 2 - window.point_px) / size_px
    log_size = np.log(size_px.prod(axis=1) / expected_px**2) / 2
    contrasts = _contrasts(window.sums, inside, min(window.cell_px, 1.0) ** 2)
    cost = _SIZE_COST * log_size**2 + _SHIFT_COST * (shifts**2).sum(axis=1)
    return _Judged(edges_px, np.log(contrasts + 1e-3) - cost, contrasts)  # 1e-3: no contrast has a logarithm as well


def _mean_box(edges_px: Real64, scores: Real64) -> tuple[Real64, Real64]:
    """Middle and size, (2,) each, of boxes weighted by their scores: where several do, none of them is sure."""
    weights = np.exp(_SHARPNESS * (scores - scores.max()))
    weights /= weights.sum()
    middles_px, sizes_px = (edges_px[:, :2] + edges_px[:, 2:]) / 2, edges_px[:, 2:] - edges_px[:, :2]
    middle_px = (weights[:, None] * middles_px).sum(axis=0)
    return middle_px, np.exp((weights[:, None] * np.log(sizes_px)).sum(axis=0))


@cache
def _boxes() -> _Cells:
    """The boxes tried in a window."""
    boxes = [
        (_CELLS / 2 + (dx - 0.5) * w, _CELLS / 2 + (dy - 0.5) * h, w, h)
        for h in _SIDES
        for w in _SIDES
        if max(w / h, h / w) <= _MAX_ASPECT
        for dy in _SHIFTS
        for dx in _SHIFTS
    ]
    x, y, w, h = np.rint(np.array(boxes)).astype(np.int64).T
    return np.stack([x, y, x + w, y + h], axis=1)


def _contrasts(sums: Real64, cells: _Cells, pixels_per_cell: float) -> Real64:
    """How much the colours of boxes differ from those along the side where they differ least, (n,) in 0..1.

    The measure is one less the Bhattacharyya coefficient, less what samples of so few pixels differ by chance: about
    (K - 1) / 8 (1 / n + 1 / m) for n and m pixels of K colours that are all as frequent. A side on the frame's edge
    says nothing.
    """
    x0, y0, x1, y1 = cells.T
    rim = np.maximum(np.rint(_RIM * np.sqrt((x1 - x0) * (y1 - y0))), 2).astype(np.int64)
    inside, in_cells = _shares(sums, cells)
    least = np.full(len(cells), np.inf)
    for strip in ((x0, y0 - rim, x1, y0), (x0, y1, x1, y1 + rim), (x0 - rim, y0, x0, y1), (x1, y0, x1 + rim, y1)):
        outside, out_cells = _shares(sums, np.stack(strip, axis=1))
        chance = (_PALETTE - 1) / 8 * (1 / np.maximum(in_cells, 1) + 1 / np.maximum(out_cells, 1)) / pixels_per_cell
        contrasts = np.clip(1 - np.sqrt(inside * outside).sum(axis=1) - chance, 0, 1)
        least = np.minimum(least, np.where(out_cells > 0.5, contrasts, np.inf))
    return np.where(np.isfinite(least), least, 0.0)  # what fills the frame stands out from nothing


def _shares(sums: Real64, cells: _Cells) -> tuple[Real64, Real64]:
    """Share of each colour in boxes, (n, K), and how many of their cells are in the frame, (n,)."""
    x0, y0, x1, y1 = np.clip(cells, 0, _CELLS).T
    amounts = np.maximum(sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0], 0)
    totals = amounts.sum(axis=1)
    return amounts / np.maximum(totals, 1)[:, None], totals


def _colour_sums(lab: _Colours, frame: _Cells) -> Real64:
    distances2 = _distances2(lab, _palette(lab))  # (64, 64, K)
    nearness = np.exp((distances2.min(axis=2, keepdims=True) - distances2) / (2 * _NEAR_LAB**2))
    left, top, right, bottom = frame
    sums = np.zeros((_CELLS + 1, _CELLS + 1, _PALETTE))
    part = nearness[top:bottom, left:right]
    sums[1 + top : 1 + bottom, 1 + left : 1 + right] = part / part.sum(axis=2, keepdims=True)
    return np.asarray(sums.cumsum(axis=0).cumsum(axis=1))


def _palette(lab: _Colours) -> _Colours:
    """Colours (K, 3) that stand for all, by k-means from starts that lie as far apart as they can: without chance."""
    thumbnail = cv2.resize(lab, (_THUMBNAIL, _THUMBNAIL), interpolation=cv2.INTER_AREA)
    pixels = np.asarray(thumbnail, np.float32).reshape(-1, 3)
    palette = np.repeat(pixels.mean(axis=0, keepdims=True), _PALETTE, axis=0)
    farness = _distances2(pixels, palette[:1])[:, 0]
    for k in range(1, _PALETTE):
        palette[k] = pixels[farness.argmax()]
        farness = np.minimum(farness, _distances2(pixels, palette[k : k + 1])[:, 0])
    for _ in range(4):
        nearest = _distances2(pixels, palette).argmin(axis=1)
        counts = np.bincount(nearest, minlength=_PALETTE)
        for channel in range(3):
            totals = np.bincount(nearest, pixels[:, channel], _PALETTE)
            palette[:, channel] = np.where(counts > 0, totals / np.maximum(counts, 1), palette[:, channel])
    return palette


def _distances2(lab: _Colours, palette: _Colours) -> Real:
    """Squared distances of colours (..., 3) from those of a palette, (..., K)."""
    # channel by channel: three times as fast as a sum over an axis of 3
    by_l, by_a, by_b = (lab[..., k, None] - palette[:, k] for k in range(3))
    return np.asarray(by_l * by_l + by_a * by_a + by_b * by_b)
