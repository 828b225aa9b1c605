"""The tracker's numeric steps, each in two forms: NumPy with OpenCV, and compiled.

Both compute the same; tests/mscf/kernels say how closely they agree. Which one is used: `mscf.kernels.choice`.
"""

from typing import Literal, Protocol

from mscf.arrays import Image, Probe, Real, Real64, Spectrum, no_probe
from mscf.spectrum import SupportTransform

KernelsName = Literal["numpy", "native"]


class Kernels(Protocol):
    """What a tracker computes with; to be shared by trackers of one thread or of several.

    The compiled ones give up the interpreter's lock in each step, about 24 times an update, and ask for it again: where
    another thread computes in Python, each time may cost a `sys.setswitchinterval`, of 5 ms where nobody has set it.

    Sizes: C channels, M x N cells, N' = N//2 + 1 bins of the half spectrum, T = M N, m x n filter support, K scales,
    K' = K//2 + 1, F features of a scale sample. What is returned is never written to again.
    """

    name: KernelsName

    def feature_stack(self, patch: Image, table: Real | None) -> Real:
        """Gray, FHOG and colour names of a patch, as `mscf.features.stack.feature_stack`: (C, M, N)."""
        ...

    def fhog(self, patches: Image) -> Real:
        """FHOG of a batch of patches, as `mscf.features.fhog.fhog`: (B, 31, h//4, w//4)."""
        ...

    def sample_exact(
        self, frame: Image, pos_rc: tuple[float, float], sizes_hw: Real64, out_hw: tuple[int, int]
    ) -> Image:
        """Rectangles of the sizes (K, 2) around a point, each as `mscf.sampling.sample_exact`: (K, h, w[, 3]) uint8."""
        ...

    def windowed_dft(self, maps: Real, window: Real) -> Spectrum:
        """`mscf.spectrum.dft` of maps (C, M, N) times a window (M, N): (C, M, N')."""
        ...

    def inverse_dft(self, map_f: Spectrum, size_mn: tuple[int, int]) -> Real:
        """`mscf.spectrum.inverse_dft` of one map (M, N'): (M, N)."""
        ...

    def correlate(self, a_f: Spectrum, b_f: Spectrum) -> Spectrum:
        """sum_d conj(a_d) b_d: (C, M, N') twice -> (M, N')."""
        ...

    def blend(
        self,
        mean_f: Spectrum,
        sample_f: Spectrum,
        rate: float,
        offset_rc: tuple[float, float],
        size_mn: tuple[int, int],
    ) -> tuple[Spectrum, Real]:
        """Running mean (C, M, N') with a sample that is `shifted` by `offset_rc`, and sum_d |mean_d|^2 (M, N')."""
        ...

    def solve_g(
        self,
        label_f: Spectrum,
        energy: Real,
        fit_f: Spectrum,
        before: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        weight: float,
    ) -> tuple[Spectrum, Spectrum]:
        """Sub-problem g per DFT bin (paper Eq. 8-11): correction a and fit m^H g, (M, N') each; see `mscf.filter`.

        Parameters
        ----------
        label_f : the label q. energy : S_xx. fit_f : m^H h.
        before : m^H h' and a' of the step before.
        weight : T mu.
        """
        ...

    def restrict_h(
        self, model_f: Spectrum, a_f: Spectrum, h: Real, shrink: float, support: SupportTransform
    ) -> tuple[Real, Spectrum]:
        """Sub-problem h (paper Eq. 7): shrink * (h + crop(IDFT(m a))), (C, m, n), and its fit m^H h, (M, N')."""
        ...

    def split_label(
        self,
        label: tuple[Spectrum, Spectrum],
        fit_f: Spectrum,
        ideal_f: Spectrum,
        previous_f: Spectrum,
        penalties: tuple[float, float],
        weights: tuple[float, float],
    ) -> tuple[Spectrum, Spectrum]:
        """One iteration of the published code's label: r and xi, (M, N') each; see `mscf.filter.label_split_step`.

        Parameters
        ----------
        label : r and xi before. fit_f : m^H h, whose conjugate is G. penalties : gamma and T.
        weights : of the ideal label and of the previous one.
        """
        ...

    def filter_of(
        self,
        model_f: Spectrum,
        h: tuple[Real, Real],
        a_f: tuple[Spectrum, Spectrum],
        inverse_growth: float,
        support: SupportTransform,
    ) -> Spectrum:
        """DFT(h + share (h - h')) + m (a - share a'): (C, M, N') of h and h', a and a'; `share` is `inverse_growth`."""
        ...

    def peak_to_sidelobe(self, response: Real) -> float:
        """As `mscf.confidence.peak_to_sidelobe`."""
        ...

    def threat_in_window(self, response: Real, *, nu: float, delta: float, probe: Probe = no_probe) -> float:
        """As `mscf.mutation.threat_in_window`; the compiled form shows nothing to the probe."""
        ...

    def locate_peak(self, response: Real, response_f: Spectrum) -> tuple[float, float]:
        """As `mscf.spectrum.locate_peak`."""
        ...

    def scale_dft(self, features: Real) -> Spectrum:
        """Half spectrum over the scales, K odd: (K, F) -> (K', F)."""
        ...

    def scale_match(self, num_f: Spectrum, x_f: Spectrum) -> Spectrum:
        """sum_f num_f x_f: (K', F) twice -> (K',)."""
        ...

    def scale_learn(
        self, num_f: Spectrum, den: Real, x_f: Spectrum, label_f: Spectrum, rate: float
    ) -> tuple[Spectrum, Real]:
        """Running means of label conj(x), (K', F), and of sum_f |x|^2, (K',)."""
        ...
