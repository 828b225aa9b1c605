"""Regression targets on the feature grid; all circular, with their centre at index [0, 0]."""

import math
from typing import TypeVar

import numpy as np

from mscf.arrays import Real, Spectrum
from mscf.spectrum import circular_offsets

_Map = TypeVar("_Map", Real, Spectrum)


def gaussian_label(size_mn: tuple[int, int], *, sigma_cells: float) -> Real:
    """Gaussian y1 with value 1 at [0, 0]: (M, N) float32 (spec B4).

    Parameters
    ----------
    sigma_cells : standard deviation in cells, > 0.
    """
    d_r, d_c = circular_offsets(size_mn[0])[:, None], circular_offsets(size_mn[1])[None, :]
    return np.exp(-(d_r**2 + d_c**2) / (2 * sigma_cells**2)).astype(np.float32)


def pedestal(size_mn: tuple[int, int], arm_mn: tuple[float, float], *, centred: bool) -> Real:
    """Cruciform pedestal y2: the union of an a x b and a b x a rectangle, 1 inside, 0 outside (paper Eq. 3).

    Parameters
    ----------
    arm_mn : the sides (a, b) of the rectangle in cells.
    centred : True: symmetric about [0, 0]. False: as the published code has it, a cell or two towards
        negative offsets (spec B5).

    Returns
    -------
    (M, N) float32 of 0 and 1.
    """

    def mask(size: int, arm: float) -> Real:
        half = (arm - 1) / 2
        first, last = -math.floor(half), (math.floor(half) if centred else math.ceil(half) - 2)
        offset = circular_offsets(size)
        return ((offset >= first) & (offset <= last)).astype(np.float32)

    a, b = arm_mn
    rows, cols = size_mn
    upright = np.outer(mask(rows, a), mask(cols, b))
    lying = np.outer(mask(rows, b), mask(cols, a))
    return np.maximum(upright, lying)


def ideal_label(gaussian: _Map, pedestal_: _Map, *, height: float, threat: float) -> _Map:
    """Ideal hybrid label Omega = y1 + height * (1 - threat) * y2, of maps or of their spectra (paper Eq. 3).

    The paper writes y1 + (1 - theta * MTF) y2, gives no theta, and gives an eta = 0.044 that appears in no
    equation. With a pedestal of 1 the label would have no peak; as in the published code, eta is the height
    and theta is 1 (spec A2).
    """
    return np.asarray(gaussian + np.float32(height * (1 - threat)) * pedestal_, gaussian.dtype)
