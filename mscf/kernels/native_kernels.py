"""The numeric steps compiled: what stands between the arrays of NumPy and the kernels in `src`."""

import math
from functools import lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Probe, Real, Real64, Spectrum, no_probe
from mscf.confidence import SIDELOBE_HOLE_CELLS
from mscf.features.fhog import CELL_PX, CHANNELS, orientation_bins
from mscf.features.gray import LUMA_BGR
from mscf.kernels import KernelsName, _native
from mscf.kernels.pool import Pool
from mscf.mutation import WINDOW_RADIUS_CELLS, radial_weight
from mscf.spectrum import CONVERGED_RAD, NEWTON_STEPS, SupportTransform, shift_phases

_LUMA = np.ascontiguousarray(LUMA_BGR[0])
_REAL, _SPECTRUM, _PIXELS = np.dtype(np.float32), np.dtype(np.complex64), np.dtype(np.uint8)
_Number = TypeVar("_Number", np.float32, np.complex64)
_LANES = 16  # columns that the kernels take at a time


class NativeKernels:
    """`Kernels`, compiled. The GIL is released while one of them computes.

    Raises
    ------
    ValueError
        By each, for an array of another dtype or shape; nothing is computed then.
    """

    name: KernelsName = "native"

    def __init__(self) -> None:
        self._pool = Pool()

    def feature_stack(self, patch: Image, table: Real | None) -> Real:
        rows, cols = patch.shape[0] // CELL_PX, patch.shape[1] // CELL_PX
        features = self._pool.empty((1 + CHANNELS + (0 if table is None else table.shape[1]), rows, cols), _REAL)
        pixels = np.ascontiguousarray(patch).reshape(*patch.shape[:2], -1)
        _native.feature_stack(pixels, orientation_bins(), _LUMA, table, features)
        return features

    def fhog(self, patches: Image) -> Real:
        batch, height, width = patches.shape[:3]
        features = self._pool.empty((batch, CHANNELS, height // CELL_PX, width // CELL_PX), _REAL)
        pixels = np.ascontiguousarray(patches).reshape(batch, height, width, -1)
        _native.fhog(pixels, orientation_bins(), features)
        return features

    def sample_exact(
        self, frame: Image, pos_rc: tuple[float, float], sizes_hw: Real64, out_hw: tuple[int, int]
    ) -> Image:
        pixels = frame if frame.ndim == 3 else frame[..., None]
        patches = self._pool.empty((len(sizes_hw), *out_hw, *frame.shape[2:]), _PIXELS)
        sizes_hw = np.ascontiguousarray(sizes_hw, np.float64)  # a box may be of whole numbers
        _native.sample_exact(pixels, *pos_rc, sizes_hw, patches.reshape(len(sizes_hw), *out_hw, -1))
        return patches

    def windowed_dft(self, maps: Real, window: Real) -> Spectrum:
        channels, rows, cols = maps.shape
        maps_f = self._pool.empty((channels, rows, cols // 2 + 1), _SPECTRUM)
        _native.windowed_dft(maps, window, *_waves(rows), *_waves(cols), maps_f)
        return maps_f

    def inverse_dft(self, map_f: Spectrum, size_mn: tuple[int, int]) -> Real:
        response = self._pool.empty(size_mn, _REAL)
        _native.inverse_dft(map_f, *_waves(size_mn[0]), *_waves(size_mn[1]), response)
        return response

    def correlate(self, a_f: Spectrum, b_f: Spectrum) -> Spectrum:
        sum_f = self._pool.empty(a_f.shape[1:], _SPECTRUM)
        _native.correlate(a_f, b_f, sum_f)
        return sum_f

    def blend(
        self,
        mean_f: Spectrum,
        sample_f: Spectrum,
        rate: float,
        offset_rc: tuple[float, float],
        size_mn: tuple[int, int],
    ) -> tuple[Spectrum, Real]:
        after_f, energy = self._pool.empty(mean_f.shape, _SPECTRUM), self._pool.empty(mean_f.shape[1:], _REAL)
        _native.blend(mean_f, sample_f, rate, *shift_phases(offset_rc, size_mn), after_f, energy)
        return after_f, energy

    def solve_g(
        self,
        label_f: Spectrum,
        energy: Real,
        fit_f: Spectrum,
        before: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        weight: float,
    ) -> tuple[Spectrum, Spectrum]:
        a_f, fit_g_f = self._pool.empty(label_f.shape, _SPECTRUM), self._pool.empty(label_f.shape, _SPECTRUM)
        _native.solve_g(label_f, energy, fit_f, *before, inverse_growth, weight, a_f, fit_g_f)
        return a_f, fit_g_f

    def restrict_h(
        self, model_f: Spectrum, a_f: Spectrum, h: Real, shrink: float, support: SupportTransform
    ) -> tuple[Real, Spectrum]:
        after, fit_f = self._pool.empty(h.shape, _REAL), self._pool.empty(a_f.shape, _SPECTRUM)
        _native.restrict_h(model_f, a_f, h, shrink, *_support(support.size_mn, support.support_mn), after, fit_f)
        return after, fit_f

    def split_label(
        self,
        label: tuple[Spectrum, Spectrum],
        fit_f: Spectrum,
        ideal_f: Spectrum,
        previous_f: Spectrum,
        penalties: tuple[float, float],
        weights: tuple[float, float],
    ) -> tuple[Spectrum, Spectrum]:
        r_f, xi_f = self._pool.empty(fit_f.shape, _SPECTRUM), self._pool.empty(fit_f.shape, _SPECTRUM)
        _native.split_label(*label, fit_f, ideal_f, previous_f, *penalties, *weights, r_f, xi_f)
        return r_f, xi_f

    def filter_of(
        self,
        model_f: Spectrum,
        h: tuple[Real, Real],
        a_f: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        support: SupportTransform,
    ) -> Spectrum:
        g_f = self._pool.empty(model_f.shape, _SPECTRUM)
        tables = _support(support.size_mn, support.support_mn)
        _native.filter_of(model_f, *h, *a_f, inverse_growth, *tables, g_f)
        return g_f

    def peak_to_sidelobe(self, response: Real) -> float:
        ratio = np.empty(1)
        _native.peak_to_sidelobe(response, SIDELOBE_HOLE_CELLS, ratio)
        return float(ratio[0])

    def threat_in_window(self, response: Real, *, nu: float, delta: float, probe: Probe = no_probe) -> float:
        threat, side = np.empty(1), 2 * WINDOW_RADIUS_CELLS + 1
        _native.threat_in_window(response, radial_weight((side, side), nu, delta), threat)
        return float(threat[0])

    def locate_peak(self, response: Real, response_f: Spectrum) -> tuple[float, float]:
        offset_rc = np.empty(2)
        _native.locate_peak(response, response_f, NEWTON_STEPS, CONVERGED_RAD, offset_rc)
        return float(offset_rc[0]), float(offset_rc[1])

    def scale_dft(self, features: Real) -> Spectrum:
        scales, size = features.shape
        x_f = self._pool.empty((scales // 2 + 1, size), _SPECTRUM)
        _native.scale_dft(features, *_waves(scales), x_f)
        return x_f

    def scale_match(self, num_f: Spectrum, x_f: Spectrum) -> Spectrum:
        total_f = np.empty(num_f.shape[0], np.complex64)
        _native.scale_match(num_f, x_f, total_f)
        return total_f

    def scale_learn(
        self, num_f: Spectrum, den: Real, x_f: Spectrum, label_f: Spectrum, rate: float
    ) -> tuple[Spectrum, Real]:
        num_after_f, den_after = self._pool.empty(num_f.shape, _SPECTRUM), np.empty_like(den)
        _native.scale_learn(num_f, den, x_f, label_f, rate, num_after_f, den_after)
        return num_after_f, den_after


@lru_cache(maxsize=16)
def _waves(size: int) -> tuple[Real, Real]:
    """Cosine and sine of 2 pi j k / size for j, k = 0 .. size//2."""
    index = np.arange(size // 2 + 1)
    angle = 2 * math.pi / size * (np.outer(index, index) % size)
    return _fixed(np.cos(angle).astype(np.float32)), _fixed(np.sin(angle).astype(np.float32))


@lru_cache(maxsize=16)
def _support(size_mn: tuple[int, int], support_mn: tuple[int, int]) -> tuple[Real, Real, Spectrum, Real]:
    """What the kernels take of a `SupportTransform`: rows from the middle on, as the others are conjugate; columns."""
    support = SupportTransform.centred(size_mn, support_mn)
    count, width = size_mn[0], support_mn[1]
    bins, reach = np.arange(count // 2 + 1), np.arange(support_mn[0] // 2 + 1)
    angle = 2 * math.pi / count * (np.outer(bins, reach + count // 2) % count)
    sine = np.sin(angle)
    sine[[0, -1]] = 0  # exactly
    cols_inv = np.zeros((support.cols_inv.shape[0], -(-width // _LANES) * _LANES), np.float32)
    cols_inv[:, :width] = support.cols_inv
    rows = _fixed(np.cos(angle).astype(np.float32)), _fixed(sine.astype(np.float32))
    return *rows, _fixed(support.cols_f), _fixed(cols_inv)


def _fixed(table: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
    """The array, which nobody can write to any more."""
    table.flags.writeable = False
    return table
