"""Mutation threat factor: how dangerous the highest sub-peak of a response map is (paper Eq. 1 and 2)."""

from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from mscf.arrays import Probe, Real, no_probe
from mscf.config import TrackerConfig

if TYPE_CHECKING:
    from mscf.kernels import Kernels

WINDOW_RADIUS_CELLS = 6
HOLE_CELLS = 1.5  # around the main peak: of the 3 x 3 square
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def measure_threat(response: Real, cfg: TrackerConfig, kernels: "Kernels", *, probe: Probe = no_probe) -> float:
    """Mutation threat factor of a response map (M, N) by the configured rule."""
    rule = kernels.threat_in_window if cfg.threat_rule == "window" else threat_of_peaks
    return rule(response, nu=cfg.threat_nu, delta=cfg.threat_delta, probe=probe)


def distance_weight(distance_cells: Real, *, nu: float, delta: float) -> Real:
    """Pi = nu / (1 + delta exp(d)), without the hole around the main peak (paper Eq. 2)."""
    return np.asarray(nu / (1 + delta * np.exp(distance_cells)), dtype=np.float32)


@lru_cache(maxsize=8)
def radial_weight(size_mn: tuple[int, int], nu: float, delta: float) -> Real:
    """Pi about the middle of a map, 0 up to and including `HOLE_CELLS` from it."""
    d_r, d_c = np.arange(size_mn[0]) - size_mn[0] // 2, np.arange(size_mn[1]) - size_mn[1] // 2
    distance = np.hypot(d_r[:, None], d_c[None, :]).astype(np.float32)
    return np.where(distance > HOLE_CELLS, distance_weight(distance, nu=nu, delta=delta), np.float32(0))


def regional_maxima(values: Real) -> Real:
    """1 where no 8-connected neighbour is higher, else 0; (M, N) float32. The map is not circular here.

    A plateau counts as a maximum wherever none of its own neighbours is higher; strictly, all of a plateau is
    or is not one. Responses have no plateaus but the zeroed hole, whose weight is 0.
    """
    return (values >= cv2.dilate(values, _NEIGHBOURS)).astype(np.float32)


def threat_in_window(response: Real, *, nu: float, delta: float, probe: Probe = no_probe) -> float:
    """Threat as the published code computes it, in a 13 x 13 window around the main peak (spec B7).

    The window is shifted to stay inside the map, so it may not be centred on the peak, but the distance is
    measured from its middle. The 3 x 3 hole is cut before the maxima are searched, so that its rim is mostly
    flagged as one: the value measures how wide the main peak is more than it sees sub-peaks (spec C).

    Parameters
    ----------
    response : (M, N) float32, not shifted; each side at least 13.

    Returns
    -------
    max(R Psi Pi) / max(R); 1 where the response has no positive value, so no peak to trust.
    """
    shifted = np.fft.fftshift(response)
    rows, cols = shifted.shape
    radius = WINDOW_RADIUS_CELLS
    peak_c, peak_r = np.unravel_index(int(np.argmax(shifted.T)), (cols, rows))
    r_max = float(shifted[peak_r, peak_c])
    if not r_max > 0:
        return 1.0
    # the published bounds (1-based r0 + 7 > S -> S - 7) keep one more cell free at the far border
    row = min(max(int(peak_r), radius), rows - radius - 2)
    col = min(max(int(peak_c), radius), cols - radius - 2)
    window = shifted[row - radius : row + radius + 1, col - radius : col + radius + 1].copy()
    window[radius - 1 : radius + 2, radius - 1 : radius + 2] = 0
    maxima = regional_maxima(window)
    probe("threat_window", window)
    probe("threat_maxima", maxima)
    weight = radial_weight(window.shape, nu, delta)
    return float(np.max(np.where(maxima, window * weight, 0)) / r_max)


def threat_of_peaks(response: Real, *, nu: float, delta: float, probe: Probe = no_probe) -> float:
    """Threat as the paper states it: over the true sub-peaks of the whole response (paper Eq. 1 and 2).

    Distances are circular and measured from the main peak. d_min is not given in the paper; 1.5 cells is the
    circle around the published code's 3 x 3 hole.

    Parameters and returned value as for `threat_in_window`, for maps of any size.
    """
    rows, cols = response.shape
    peak_r, peak_c = np.unravel_index(int(np.argmax(response)), (rows, cols))
    r_max = float(response[peak_r, peak_c])
    if not r_max > 0:
        return 1.0
    centred = np.roll(response, (rows // 2 - int(peak_r), cols // 2 - int(peak_c)), axis=(0, 1))
    maxima = regional_maxima(np.pad(centred, 1, mode="wrap"))[1:-1, 1:-1]
    probe("threat_window", centred)
    probe("threat_maxima", maxima)
    weight = radial_weight((rows, cols), nu, delta)
    return float(np.max(centred * maxima * weight) / r_max)
