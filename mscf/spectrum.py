"""Discrete Fourier transforms of feature maps, and the peak between the grid points.

Layout, fixed for the whole package: channel first, (C, M, N) float32 in space and the half spectrum
(C, M, N//2 + 1) complex64 of `rfft2` in frequency (`_f`). NumPy keeps single precision since 2.0.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np

from mscf.arrays import Real, Real64, Spectrum

Spectrum128 = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]
NEWTON_STEPS = 5  # at most (spec B6)
CONVERGED_RAD = 1e-5


def dft(x: Real) -> Spectrum:
    """Unnormalised half spectrum over the last two axes: (M, N) or (C, M, N) -> (..., M, N//2 + 1) complex64.

    Of many small maps two matrix products are faster than NumPy's transform, and more so on a busy machine.
    """
    if x.ndim == 2:
        return cast("Spectrum", np.fft.rfft2(x))  # the stubs say complex128
    return _full_support(x.shape[1:]).forward(x)


def inverse_dft(x_f: Spectrum, size_mn: tuple[int, int]) -> Real:
    """Inverse of `dft`, with the factor 1/(M*N): (..., M, N//2 + 1) -> (..., M, N)."""
    return cast("Real", np.fft.irfft2(x_f, s=size_mn))


def circular_offsets(size: int) -> Real64:
    """Signed offsets of DFT order, 0, 1 .. ceil((n-1)/2), -floor((n-1)/2) .. -1: (n,) float64 (spec B4)."""
    index = np.arange(size)
    return np.where(index <= size // 2, index, index - size).astype(np.float64)


def correlate(a_f: Spectrum, b_f: Spectrum) -> Spectrum:
    """sum_d conj(a_d) b_d: (C, M, N') twice -> (M, N')."""
    product_f = a_f.conj()
    product_f *= b_f
    out: Spectrum = product_f.sum(axis=0)  # four times as fast as einsum, which has no kernel for this
    return out


def shift_phases(offset_rc: tuple[float, float], size_mn: tuple[int, int]) -> tuple[Spectrum, Spectrum]:
    """Factors by row (M,) and by column (N//2 + 1,) of a spectrum that move its map: see `shifted`."""
    k_r, k_c = _frequency_grid(size_mn)
    rows = np.exp(2j * np.pi / size_mn[0] * offset_rc[0] * k_r)
    cols = np.exp(2j * np.pi / size_mn[1] * offset_rc[1] * k_c[: size_mn[1] // 2 + 1])
    return rows.astype(np.complex64), cols.astype(np.complex64)


def shifted(x_f: Spectrum, offset_rc: tuple[float, float], size_mn: tuple[int, int]) -> Spectrum:
    """Spectrum of the map moved circularly by minus `offset_rc` cells: what was at the offset comes to (0, 0)."""
    moved_f: Spectrum = x_f * np.outer(*shift_phases(offset_rc, size_mn))
    return moved_f


@dataclass(frozen=True, slots=True)
class SupportTransform:
    """DFT of maps that are zero outside a small centred rectangle, and the inverse for that rectangle alone.

    With m x n non-zero samples out of M x N, two small matrix products replace the full transform:
    `x_f = rows_f @ x @ cols_f`. It is exact, not an approximation.
    """

    size_mn: tuple[int, int]  # full map (M, N)
    rows_f: Spectrum  # (M, m): DFT over rows, of the support's rows
    cols_f: Spectrum  # (n, N//2 + 1): DFT over columns, of the support's columns
    rows_inv: Spectrum  # (m, M): inverse over rows
    cols_inv: Real  # (2 * (N//2 + 1), n): inverse over columns of (real, imaginary) pairs, conjugate half added

    @property
    def support_mn(self) -> tuple[int, int]:
        """Rows and columns of the support (m, n)."""
        return self.rows_inv.shape[0], self.cols_inv.shape[1]

    @classmethod
    def centred(cls, size_mn: tuple[int, int], support_mn: tuple[int, int]) -> "SupportTransform":
        """Transform for a support of (m, n) samples from (M//2 - m//2, N//2 - n//2) on (spec B10)."""
        (rows, cols), (m, n) = size_mn, support_mn
        row = rows // 2 - m // 2 + np.arange(m)
        col = cols // 2 - n // 2 + np.arange(n)
        row_bin, col_bin = np.arange(rows), np.arange(cols // 2 + 1)
        rows_f = np.exp(-2j * np.pi / rows * np.outer(row_bin, row))
        cols_f = np.exp(-2j * np.pi / cols * np.outer(col, col_bin))
        # every column bin but 0 and (for even N) the last stands for itself and for its conjugate
        weight = np.where((col_bin == 0) | (2 * col_bin == cols), 1.0, 2.0) / cols
        cols_inv_f = np.exp(2j * np.pi / cols * np.outer(col_bin, col)) * weight[:, None]
        pairs = np.stack([cols_inv_f.real, -cols_inv_f.imag], axis=1).reshape(-1, n)
        return cls(
            size_mn,
            rows_f.astype(np.complex64),
            cols_f.astype(np.complex64),
            (rows_f.conj().T / rows).astype(np.complex64),
            pairs.astype(np.float32),
        )

    def forward(self, x: Real) -> Spectrum:
        """(C, m, n) samples on the support -> (C, M, N//2 + 1)."""
        c, m, n = x.shape
        half = (x.reshape(c * m, n) @ self.cols_f).reshape(c, m, -1)  # (C, m, N//2 + 1)
        x_f: Spectrum = self.rows_f @ half
        return x_f

    def inverse(self, x_f: Spectrum) -> Real:
        """(C, M, N//2 + 1) -> (C, m, n): the inverse DFT, cropped to the support."""
        c, m = x_f.shape[0], self.rows_inv.shape[0]
        half = self.rows_inv @ x_f  # (C, m, N//2 + 1), inverse over rows
        x: Real = half.view(np.float32).reshape(c * m, -1) @ self.cols_inv  # real part of the inverse over columns
        return x.reshape(c, m, -1)


@lru_cache(maxsize=8)
def _full_support(size_mn: tuple[int, int]) -> SupportTransform:
    return SupportTransform.centred(size_mn, size_mn)


@lru_cache(maxsize=8)
def _frequency_grid(size_mn: tuple[int, int]) -> tuple[Real64, Real64]:
    return circular_offsets(size_mn[0]), circular_offsets(size_mn[1])


def locate_peak(response: Real, response_f: Spectrum) -> tuple[float, float]:
    """Offset of the maximum of a response map, between the grid points (spec B6).

    Newton's method on the trigonometric interpolation of `response`, from the grid maximum. Where it does
    not end higher than the grid maximum, or not at a finite point, the grid maximum is returned.

    Parameters
    ----------
    response : (M, N) float32, not shifted: offset (0, 0) at index [0, 0].
    response_f : (M, N//2 + 1) its half spectrum.

    Returns
    -------
    (row, column) offset in cells, signed, float.
    """
    rows, cols = response.shape
    # column-major first among equals, as the published code has it
    col, row = np.unravel_index(int(np.argmax(response.T)), (cols, rows))
    k_r, k_c = _frequency_grid((rows, cols))
    grid_rc = np.array([k_r[row], k_c[col]])
    to_rad = 2 * np.pi / np.array([rows, cols])

    half_f = response_f.astype(np.complex128) / response.size
    k_c = k_c[: cols // 2 + 1]
    weights_r = np.stack([np.ones(rows), 1j * k_r, -(k_r**2)])  # value, first and second derivative
    weights_c = np.stack([np.ones(len(k_c)), 1j * k_c, -(k_c**2)], axis=1)
    weights_c *= np.where((k_c == 0) | (2 * k_c == cols), 1, 2)[:, None]  # a bin stands for its conjugate, too
    angle_rc = grid_rc * to_rad
    for _ in range(NEWTON_STEPS):
        moments = _derivatives(half_f, weights_r, weights_c, angle_rc, k_r, k_c)
        h_rr, h_cc, h_rc = moments[2, 0], moments[0, 2], moments[1, 1]
        det = h_rr * h_cc - h_rc * h_rc
        if det == 0 or not np.isfinite(det):
            break
        g_r, g_c = moments[1, 0], moments[0, 1]
        step_rc = np.array([h_cc * g_r - h_rc * g_c, h_rr * g_c - h_rc * g_r]) / det
        angle_rc = angle_rc - step_rc
        if np.abs(step_rc).max() < CONVERGED_RAD:  # a further step would be its square
            break
    value = _derivatives(half_f, weights_r, weights_c, angle_rc, k_r, k_c)[0, 0]
    if not value >= response[row, col]:  # also where it is NaN
        return float(grid_rc[0]), float(grid_rc[1])
    offset_rc = angle_rc / to_rad
    return float(offset_rc[0]), float(offset_rc[1])


def _derivatives(
    half_f: Spectrum128, weights_r: Spectrum128, weights_c: Spectrum128, angle_rc: Real64, k_r: Real64, k_c: Real64
) -> Real64:
    """[i, j]: i-th derivative by row and j-th by column of the interpolated response, (3, 3)."""
    rows = weights_r * np.exp(1j * angle_rc[0] * k_r)  # (3, M)
    cols = weights_c * np.exp(1j * angle_rc[1] * k_c)[:, None]  # (N//2 + 1, 3)
    if len(k_r) % 2:
        return np.real(rows @ half_f @ cols)
    # the highest frequency is both M/2 and -M/2: a bin stands for its conjugate in the same row, so that the imaginary
    # parts cancel, but for the corner bin, which has no other
    highest = len(k_r) // 2
    corner_f = half_f[highest, -1].real if weights_c[-1, 0] == 1 else 0.0  # an odd map has none
    corner = np.outer(rows[:, highest].imag, cols[-1].imag) * corner_f
    rows[:, highest] = rows[:, highest].real
    return np.asarray(np.real(rows @ half_f @ cols) - corner)
