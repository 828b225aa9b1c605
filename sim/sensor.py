"""From light to a digital picture: blur, exposure, lens fall-off and noise."""

import math
from functools import lru_cache

import cv2
import numpy as np

from mscf.arrays import Image, Real, Real64

_LENS_SIGMA_PX = 0.55  # a sharp lens behind a demosaiced sensor
_NOISE_MARGIN_PX = 64


def blurred(image: Image, motion_px: Real64) -> Image:
    """`image` through the lens, smeared along `motion_px` (du, dv)."""
    reach = float(np.abs(motion_px).max()) / 2
    # The kernel ends where less than 2 % of the light would fall.
    half = max(1, math.ceil(reach + 0.25))
    ticks = np.arange(-half, half + 1)
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for share in np.linspace(-0.5, 0.5, 2 * half + 3):
        column = np.exp(-((ticks - share * motion_px[1]) ** 2) / (2 * _LENS_SIGMA_PX**2))
        row = np.exp(-((ticks - share * motion_px[0]) ** 2) / (2 * _LENS_SIGMA_PX**2))
        kernel += column[:, None] * row
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


@lru_cache(maxsize=4)
def _noise_fields(seed: int, size_hw: tuple[int, int], std: float) -> tuple[Image, Image]:
    """Two fields larger than the frame; their difference is the sensor's noise, fine with a little coarse."""
    rng = np.random.default_rng((seed, 4))
    shape = (size_hw[0] + _NOISE_MARGIN_PX, size_hw[1] + _NOISE_MARGIN_PX)
    fields = []
    for _ in range(2):
        luma = rng.standard_normal(shape, dtype=np.float32)[..., None]
        chroma = cv2.GaussianBlur(rng.standard_normal((*shape, 3), dtype=np.float32), (0, 0), 1.0) * 2.0
        # The deviation of a difference is sqrt(2) that of each; 4 std of offset keep both fields positive.
        field = np.clip((luma * 0.85 + chroma * 0.5 + 4) * std / math.sqrt(2), 0, 255)
        fields.append(np.round(field).astype(np.uint8))
    return fields[0], fields[1]


@lru_cache(maxsize=4)
def _vignette(size_hw: tuple[int, int]) -> Image:
    """Fall-off of the lens towards the corners (H, W, 3), 255 in the middle."""
    height, width = size_hw
    y = np.linspace(-1, 1, height)[:, None] * height / width
    x = np.linspace(-1, 1, width)
    fall: Real = (255 / (1 + 0.13 * (x**2 + y**2)) ** 2).astype(np.float32)
    return np.repeat(np.round(fall).astype(np.uint8)[..., None], 3, axis=2)


def developed(frame: Image, seed: int, time_s: float, exposure_gain: float, noise_std: float) -> Image:
    """Exposure, lens fall-off and sensor noise."""
    height, width = frame.shape[:2]
    frame = np.asarray(cv2.multiply(frame, _vignette((height, width)), scale=exposure_gain / 255), np.uint8)
    if noise_std <= 0:
        return frame
    # Fresh shifts for every time: the same noise never stands still on the picture.
    rng = np.random.default_rng((seed, 5, int(time_s * 1e6) & 0xFFFFFFFF))
    bright, dark = (
        field[top : top + height, left : left + width]
        for field, (top, left) in zip(
            _noise_fields(seed, (height, width), noise_std),
            rng.integers(_NOISE_MARGIN_PX, size=(2, 2)),
            strict=True,
        )
    )
    # Dark last: the sum of the offsets cancels, saturation only meets what was saturated already.
    return np.asarray(cv2.subtract(cv2.add(frame, bright), dark), np.uint8)
