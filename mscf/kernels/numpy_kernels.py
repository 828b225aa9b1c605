"""The numeric steps with NumPy and OpenCV: what runs where nothing could be compiled, and what says what is right."""

from typing import cast

import numpy as np

from mscf.arrays import Image, Probe, Real, Real64, Spectrum, no_probe
from mscf.confidence import peak_to_sidelobe
from mscf.features.fhog import fhog
from mscf.features.stack import feature_stack
from mscf.kernels import KernelsName
from mscf.mutation import threat_in_window
from mscf.sampling import sample_exact
from mscf.spectrum import SupportTransform, correlate, dft, inverse_dft, locate_peak, shifted


class NumpyKernels:
    """`Kernels` in NumPy and OpenCV."""

    name: KernelsName = "numpy"

    def feature_stack(self, patch: Image, table: Real | None) -> Real:
        return feature_stack(patch, table)

    def fhog(self, patches: Image) -> Real:
        return fhog(patches)

    def sample_exact(
        self, frame: Image, pos_rc: tuple[float, float], sizes_hw: Real64, out_hw: tuple[int, int]
    ) -> Image:
        return np.stack([sample_exact(frame, pos_rc, (h, w), out_hw) for h, w in sizes_hw.tolist()])

    def windowed_dft(self, maps: Real, window: Real) -> Spectrum:
        return dft(maps * window)

    def inverse_dft(self, map_f: Spectrum, size_mn: tuple[int, int]) -> Real:
        return inverse_dft(map_f, size_mn)

    def correlate(self, a_f: Spectrum, b_f: Spectrum) -> Spectrum:
        return correlate(a_f, b_f)

    def blend(
        self,
        mean_f: Spectrum,
        sample_f: Spectrum,
        rate: float,
        offset_rc: tuple[float, float],
        size_mn: tuple[int, int],
    ) -> tuple[Spectrum, Real]:
        share = np.float32(rate)
        added_f = shifted(sample_f, offset_rc, size_mn) if offset_rc != (0, 0) else sample_f
        after_f = (1 - share) * mean_f + share * added_f
        return after_f, correlate(after_f, after_f).real

    def solve_g(
        self,
        label_f: Spectrum,
        energy: Real,
        fit_f: Spectrum,
        before: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        weight: float,
    ) -> tuple[Spectrum, Spectrum]:
        fit_before_f, a_before_f = before
        # m^H u = growth^-1 (m^H h' + S_xx a' - m^H h)
        fit_w_f = fit_f - np.float32(inverse_growth) * (fit_before_f + energy * a_before_f - fit_f)  # m^H w
        # positive denominator, as mu is
        a_f: Spectrum = (label_f - fit_w_f) / (energy + np.float32(weight))
        return a_f, fit_w_f + energy * a_f

    def restrict_h(
        self, model_f: Spectrum, a_f: Spectrum, h: Real, shrink: float, support: SupportTransform
    ) -> tuple[Real, Spectrum]:
        after = np.float32(shrink) * (h + support.inverse(model_f * a_f))
        return after, correlate(model_f, support.forward(after))

    def split_label(
        self,
        label: tuple[Spectrum, Spectrum],
        fit_f: Spectrum,
        ideal_f: Spectrum,
        previous_f: Spectrum,
        penalties: tuple[float, float],
        weights: tuple[float, float],
    ) -> tuple[Spectrum, Spectrum]:
        (r_f, xi_f), (gamma, cells), (ideal, previous) = label, penalties, weights
        weight, scaled_xi_f = np.float32(gamma * cells), np.float32(cells) * xi_f
        s_f = (fit_f.conj() + weight * r_f + scaled_xi_f) / (1 + weight)
        total_f = np.float32(ideal) * ideal_f + np.float32(previous) * previous_f + weight * s_f - scaled_xi_f
        r_f = total_f / np.float32(ideal + previous + gamma * cells)
        return r_f, xi_f + np.float32(gamma) * (s_f - r_f)

    def filter_of(
        self,
        model_f: Spectrum,
        h: tuple[Real, Real],
        a_f: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        support: SupportTransform,
    ) -> Spectrum:
        share = np.float32(inverse_growth)
        g_f: Spectrum = model_f * (a_f[0] - share * a_f[1])
        g_f += support.forward((1 + share) * h[0] - share * h[1])
        return g_f

    def peak_to_sidelobe(self, response: Real) -> float:
        return peak_to_sidelobe(response)

    def threat_in_window(self, response: Real, *, nu: float, delta: float, probe: Probe = no_probe) -> float:
        return threat_in_window(response, nu=nu, delta=delta, probe=probe)

    def locate_peak(self, response: Real, response_f: Spectrum) -> tuple[float, float]:
        return locate_peak(response, response_f)

    def scale_dft(self, features: Real) -> Spectrum:
        return cast("Spectrum", np.fft.rfft(features, axis=0))

    def scale_match(self, num_f: Spectrum, x_f: Spectrum) -> Spectrum:
        return np.asarray(np.einsum("kf,kf->k", num_f, x_f))

    def scale_learn(
        self, num_f: Spectrum, den: Real, x_f: Spectrum, label_f: Spectrum, rate: float
    ) -> tuple[Spectrum, Real]:
        share = np.float32(rate)
        energy = np.einsum("kf,kf->k", x_f.real, x_f.real) + np.einsum("kf,kf->k", x_f.imag, x_f.imag)
        added_f = label_f[:, None] * x_f.conj()
        return (1 - share) * num_f + share * added_f, (1 - share) * den + share * energy
