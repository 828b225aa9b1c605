"""What a viewer sees: frame, boxes, response map, threat curve and frame rate in one picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mscf.arrays import Image, Real
from mscf.geometry import Box

# one colour a tracker, BGR: orange-red, blue, green, yellow, violet, turquoise
COLORS_BGR: tuple[tuple[int, int, int], ...] = (
    (40, 80, 255),
    (255, 160, 40),
    (80, 220, 80),
    (40, 220, 250),
    (230, 90, 200),
    (200, 200, 60),
)
TRUTH_BGR = (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_CURVE_FRAMES = 200  # how much of the past the curve shows
_PANEL_SHARE = 0.2  # height of the panels over the frame's


@dataclass(frozen=True, slots=True)
class Shown:
    """One tracker in the picture."""

    name: str
    box: Box
    threats: Sequence[float]  # of all frames so far; NaN where there is none


def draw(
    frame: Image,
    trackers: Sequence[Shown],
    *,
    response: Real | None,
    truth: Box | None,
    caption: str,
) -> Image:
    """Copy of `frame` with the overlay.

    Parameters
    ----------
    frame : (H, W, 3) BGR or (H, W) uint8.
    trackers : the first one's response map is shown; colours by position.
    response : (M, N) of the first tracker, not shifted; None in the first frame.
    truth : drawn thin and white where known.
    caption : a line of text.

    Returns
    -------
    (H, W, 3) BGR uint8.
    """
    picture = np.repeat(frame[..., None], 3, axis=2) if frame.ndim == 2 else frame.copy()
    unit = max(frame.shape[0] / 720, 0.35)  # sizes below are for 720 rows
    width_px = max(1, round(2 * unit))
    for tracker, color in reversed(list(zip(trackers, COLORS_BGR, strict=False))):  # the first one on top
        draw_box(picture, tracker.box, color, width_px)
    if truth is not None:
        draw_box(picture, truth, TRUTH_BGR, 1)
    _captions(picture, caption, trackers, unit, has_truth=truth is not None)
    _panels(picture, trackers, response, unit)
    return picture


def draw_box(picture: Image, box: Box, color: tuple[int, int, int], width_px: int) -> None:
    """Draw a finite box into a picture (H, W, 3), wherever it lies."""
    # a box far outside would overflow OpenCV's fixed-point coordinates
    limit = 4 * max(picture.shape)
    corners = np.clip([box.x, box.y, box.x + box.w - 1, box.y + box.h - 1], -limit, limit)
    x0, y0, x1, y1 = (round(float(value)) for value in corners)
    cv2.rectangle(picture, (x0, y0), (x1, y1), color, width_px, cv2.LINE_AA)


def _captions(picture: Image, caption: str, trackers: Sequence[Shown], unit: float, *, has_truth: bool) -> None:
    line_px = round(26 * unit)
    texts = [(caption, TRUTH_BGR)]
    texts += [(tracker.name, color) for tracker, color in zip(trackers, COLORS_BGR, strict=False)]
    texts += [("true box", TRUTH_BGR)] if has_truth else []
    for index, (text, color) in enumerate(texts, start=1):
        origin = round(12 * unit), index * line_px
        draw_text(picture, text, origin, color, unit)


def draw_text(picture: Image, text: str, origin_xy: tuple[int, int], color: tuple[int, int, int], unit: float) -> None:
    """Write into a picture (H, W, 3), from where the first letter stands; `unit` is 1 for 720 rows."""
    # dark under light: legible on any ground
    cv2.putText(picture, text, origin_xy, _FONT, 0.6 * unit, (0, 0, 0), max(2, round(4 * unit)), cv2.LINE_AA)
    cv2.putText(picture, text, origin_xy, _FONT, 0.6 * unit, color, max(1, round(1.5 * unit)), cv2.LINE_AA)


def _panels(picture: Image, trackers: Sequence[Shown], response: Real | None, unit: float) -> None:
    rows, cols = picture.shape[:2]
    height = min(round(_PANEL_SHARE * rows), cols // 3)
    margin = round(10 * unit)
    top = rows - height - margin
    if height < 24 or 2 * margin + height > cols:  # too small to read anything
        return
    if response is not None:
        picture[top : top + height, margin : margin + height] = _response_picture(response, height)
        cv2.rectangle(picture, (margin, top), (margin + height, top + height), TRUTH_BGR, 1)
        _label(picture, "response", (margin, top), unit)
    left = 2 * margin + height
    width = min(cols - left - margin, 3 * height)
    if width >= 24:
        _threat_curve(picture, (left, top, width, height), trackers)
        _label(picture, "threat", (left, top), unit)


def _label(picture: Image, text: str, corner_xy: tuple[int, int], unit: float) -> None:
    origin = corner_xy[0] + round(4 * unit), corner_xy[1] + round(16 * unit)
    cv2.putText(picture, text, origin, _FONT, 0.45 * unit, TRUTH_BGR, 1, cv2.LINE_AA)


def _response_picture(response: Real, side_px: int) -> Image:
    """Response map with its centre in the middle; negative values black."""
    shifted = np.fft.fftshift(response)
    top = float(shifted.max())
    shade = np.clip(shifted / top if top > 0 else np.zeros_like(shifted), 0, 1) * 255
    large = cv2.resize(shade.astype(np.uint8), (side_px, side_px), interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.applyColorMap(large, cv2.COLORMAP_INFERNO), dtype=np.uint8)


def _threat_curve(picture: Image, area_xywh: tuple[int, int, int, int], trackers: Sequence[Shown]) -> None:
    left, top, width, height = area_xywh
    area = picture[top : top + height, left : left + width]
    area[:] = area // 3
    cv2.rectangle(picture, (left, top), (left + width, top + height), TRUTH_BGR, 1)
    for tracker, color in reversed(list(zip(trackers, COLORS_BGR, strict=False))):
        recent = np.clip(np.nan_to_num(tracker.threats[-_CURVE_FRAMES:]), 0, 1)
        x = left + np.arange(len(recent)) * (width - 1) / (_CURVE_FRAMES - 1)
        y = top + (1 - recent) * (height - 1)
        points = np.stack([x, y], axis=1).round().astype(np.int32)
        cv2.polylines(picture, [points], isClosed=False, color=color, thickness=1, lineType=cv2.LINE_AA)
