"""From light to a digital picture: blur, exposure, lens fall-off and noise."""

import math
from functools import lru_cache

import cv2
import numpy as np

from mscf.arrays import Image, Real64

LONGEST_SMEAR_PX = 48.0  # far more than a steady flight gives, and still a kernel of bearable size
_LENS_SIGMA_PX = 0.55  # a sharp lens behind a demosaiced sensor
_NOISE_MARGIN_PX = 64


def blurred(image: Image, motion_px: Real64) -> Image:
    """`image` through the lens, smeared along `motion_px` (du, dv), at most `LONGEST_SMEAR_PX` of it."""
    motion_px = motion_px * min(1.0, LONGEST_SMEAR_PX / max(float(np.abs(motion_px).max()), 1.0))
    reach = float(np.abs(motion_px).max()) / 2
    # The kernel ends where less than 2 % of the light would fall.
    half = max(1, math.ceil(reach + 0.25))
    ticks = np.arange(-half, half + 1)
    shares = np.linspace(-0.5, 0.5, 2 * half + 3)[:, None]
    rows, columns = (np.exp(-((ticks - shares * way_px) ** 2) / (2 * _LENS_SIGMA_PX**2)) for way_px in motion_px)
    kernel = columns.T @ rows  # the light spot at each moment, summed
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


@lru_cache(maxsize=1)
def _noise_field(seed: int, size_hw: tuple[int, int], std: float) -> Image:
    """A field larger than the frame; it minus itself shifted is the sensor's noise, fine with a little coarse."""
    rng = np.random.default_rng((seed, 4))
    field = np.empty((size_hw[0] + _NOISE_MARGIN_PX, size_hw[1] + _NOISE_MARGIN_PX, 3), np.uint8)
    for strip in np.array_split(field, 16):  # floats of the whole field would take 30 MB
        luma = 0.85 * rng.standard_normal((*strip.shape[:2], 1), dtype=np.float32)
        chroma = cv2.GaussianBlur(rng.standard_normal(strip.shape, dtype=np.float32), (0, 0), 1.0)
        # The deviation of a difference is sqrt(2) that of each; 4 std of offset keep the field positive.
        strip[...] = np.clip(np.round((luma + chroma + 4) * (std / math.sqrt(2))), 0, 255)
    return field


@lru_cache(maxsize=1)
def _vignette(size_hw: tuple[int, int]) -> Image:
    """Fall-off of the lens towards the corners (H, W, 3), 255 in the middle."""
    height, width = size_hw
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None] * np.float32(height / width)
    x = np.linspace(-1, 1, width, dtype=np.float32)
    fall = cv2.convertScaleAbs((1 + 0.13 * (x**2 + y**2)) ** -2, alpha=255)
    return np.asarray(cv2.merge([fall] * 3), np.uint8)


def developed(frame: Image, seed: int, time_s: float, exposure_gain: float, noise_std: float) -> Image:
    """Exposure, lens fall-off and sensor noise."""
    height, width = frame.shape[:2]
    frame = np.asarray(cv2.multiply(frame, _vignette((height, width)), scale=exposure_gain / 255), np.uint8)
    if noise_std <= 0:
        return frame
    # Fresh shifts for every time: the same noise never stands still on the picture.
    rng = np.random.default_rng((seed, 5, int(time_s * 1e6) & 0xFFFFFFFF))
    shift = rng.integers(_NOISE_MARGIN_PX, size=2)
    # Far enough from the first for the two to have nothing in common.
    other_shift = (shift + rng.integers(8, _NOISE_MARGIN_PX - 8, size=2)) % _NOISE_MARGIN_PX
    field = _noise_field(seed, (height, width), noise_std)
    bright, dark = (field[top : top + height, left : left + width] for top, left in (shift, other_shift))
    # Dark last: the sum of the offsets cancels, saturation only meets what was saturated already.
    return np.asarray(cv2.subtract(cv2.add(frame, bright, dst=frame), dark, dst=frame), np.uint8)
