"""Training: the correlation filter and its label by ADMM (paper Eq. 4-13, spec A3 and B10).

The filter's augmented Lagrangian is solved in its scaled form, with u = l / mu for the multiplier l. Writing
w = h - u, the Sherman-Morrison solution of the g sub-problem is w plus a rank-one correction,

    g = w + m a,   a = (q - m^H w) / (S_xx + T mu),   so that g + u = h + m a.

Only a, one number per DFT bin, and h, on its support, are carried from step to step: m^H w follows from m^H h, and w
itself is formed once, for the last g. It is the paper's Eq. 8-11 and 13 rearranged (derivation in docs/equations.md).
Shapes: C channels, M x N cells, T = M N, N' = N//2 + 1 bins of the half spectrum, m x n filter support.
"""

from dataclasses import dataclass

import numpy as np

from mscf.arrays import Probe, Real, Spectrum, no_probe
from mscf.config import TrackerConfig
from mscf.kernels import Kernels
from mscf.spectrum import SupportTransform


@dataclass(frozen=True, slots=True)
class Model:
    """What the filter is trained on, and what of it every step needs."""

    m_f: Spectrum  # (C, M, N') running mean of samples
    energy: Real  # (M, N') S_xx = sum_d |m_d|^2

    @classmethod
    def of(cls, m_f: Spectrum, kernels: Kernels) -> "Model":
        """Model for a running mean (C, M, N')."""
        return cls(m_f, np.ascontiguousarray(kernels.correlate(m_f, m_f).real))


@dataclass(frozen=True, slots=True)
class FilterState:
    """ADMM iterate of the filter after its h step; all zero at the start."""

    mu: float  # penalty of the next step
    h: Real  # (C, m, n) the filter on its support, in space
    fit_f: Spectrum  # (M, N') m^H h
    # of the step before, and by how much the penalty has grown since: with them u = growth^-1 (h' + m a' - h)
    h_before: Real  # (C, m, n)
    a_before_f: Spectrum  # (M, N')
    fit_before_f: Spectrum  # (M, N')
    inverse_growth: float

    @classmethod
    def start(cls, model: Model, support: SupportTransform, *, mu: float) -> "FilterState":
        """All zero, as each training begins."""
        zero = np.zeros((model.m_f.shape[0], *support.support_mn), np.float32)
        zero_f = np.zeros(model.m_f.shape[1:], np.complex64)
        return cls(mu, zero, zero_f, zero, zero_f, zero_f, 1.0)


@dataclass(frozen=True, slots=True)
class LabelState:
    """ADMM iterate of the label in the published code's split (spec B10, loop B)."""

    r_f: Spectrum  # (M, N') the label
    xi_f: Spectrum  # (M, N') multiplier
    gamma: float  # penalty of the next step


@dataclass(frozen=True, slots=True)
class Learned:
    """Outcome of one training."""

    g_f: Spectrum  # (C, M, N') filter for the next frames
    label_f: Spectrum  # (M, N') label it was trained with last


def solve_g(
    state: FilterState, model: Model, label_f: Spectrum, cells: int, kernels: Kernels
) -> tuple[Spectrum, Spectrum]:
    """Sub-problem g for a given label, per DFT bin (paper Eq. 8-11).

    Parameters
    ----------
    label_f : (M, N') the label q.
    cells : T.

    Returns
    -------
    a_f : (M, N') the correction, g = w + m a; `filter_of` makes g of it.
    fit_f : (M, N') m^H g, what the data term compares with the label.
    """
    before = state.fit_before_f, state.a_before_f
    return kernels.solve_g(label_f, model.energy, state.fit_f, before, state.inverse_growth, cells * state.mu)


def filter_of(state: FilterState, a_f: Spectrum, model: Model, support: SupportTransform, kernels: Kernels) -> Spectrum:
    """Filter of a correction, g = h - u + m a: (C, M, N').

    With u written out it is one map on the support, and a multiple of the model, so that one transform is enough:
    g = DFT((1 + growth^-1) h - growth^-1 h') + m (a - growth^-1 a').
    """
    h, corrections = (state.h, state.h_before), (a_f, state.a_before_f)
    return kernels.filter_of(model.m_f, h, corrections, state.inverse_growth, support)


def restrict(
    state: FilterState, a_f: Spectrum, model: Model, support: SupportTransform, cfg: TrackerConfig, kernels: Kernels
) -> FilterState:
    """Sub-problem h, in space and cropped to the support, multiplier and penalty (paper Eq. 7, 13).

    h = T mu / (T mu + lambda1) crop(IDFT(g + u)), and g + u = h' + m a with h' already on the support.
    """
    cells = support.size_mn[0] * support.size_mn[1]  # T
    shrink = cells * state.mu / (cells * state.mu + cfg.filter_weight)
    h, fit_f = kernels.restrict_h(model.m_f, a_f, state.h, shrink, support)
    mu = min(cfg.penalty_growth * state.mu, cfg.penalty_max)
    return FilterState(
        mu=mu,
        h=h,
        fit_f=fit_f,
        h_before=state.h,
        a_before_f=a_f,
        fit_before_f=state.fit_f,
        inverse_growth=state.mu / mu,
    )


def label_split_step(
    state: LabelState,
    fit_f: Spectrum,
    ideal_f: Spectrum,
    previous_f: Spectrum,
    cells: int,
    cfg: TrackerConfig,
    kernels: Kernels,
) -> LabelState:
    """One iteration of the published code's label: split variable s, label r, multiplier xi (spec B10, loop B).

    s = (G + gamma T r + T xi) / (1 + gamma T); r = (lambda2 Omega + phi r' + gamma T s - T xi) / (lambda2 + phi +
    gamma T); xi grows by gamma (s - r). G = sum_d conj(h_d) m_d.

    Deviation from the paper, as the published code has it: no (1 +- Psi^2) weights, and the data term stands
    behind the split variable. With gamma T far above lambda2 the label moves by 1.35 % per training (spec C).

    Parameters
    ----------
    fit_f : (M, N') m^H h, whose conjugate is G.
    ideal_f, previous_f : (M, N') Omega, and the label of the last training, r'.
    cells : T.
    """
    penalties, weights = (state.gamma, cells), (cfg.ideal_weight, cfg.previous_weight)
    r_f, xi_f = kernels.split_label((state.r_f, state.xi_f), fit_f, ideal_f, previous_f, penalties, weights)
    return LabelState(r_f, xi_f, min(cfg.penalty_growth * state.gamma, cfg.penalty_max))


def closed_form_label(
    response_f: Spectrum, ideal_f: Spectrum, previous_f: Spectrum, *, threat: float, cfg: TrackerConfig
) -> Spectrum:
    """The paper's label: weighted mean of response, ideal label and previous label (paper Eq. 12).

    Parameters
    ----------
    response_f : (M, N') X g, the response of the current filter to the model.
    threat : Psi, the mutation threat factor.
    """
    ideal = cfg.ideal_weight * (1 + threat**2)
    previous = cfg.previous_weight * (1 - threat**2)
    total = response_f + np.float32(ideal) * ideal_f + np.float32(previous) * previous_f
    label_f: Spectrum = total / np.float32(1 + ideal + previous)
    return label_f


def learn(
    model: Model,
    ideal_f: Spectrum,
    previous_f: Spectrum,
    *,
    threat: float,
    support: SupportTransform,
    cfg: TrackerConfig,
    kernels: Kernels,
    probe: Probe = no_probe,
) -> Learned:
    """Train filter and label on a model (paper section III-C).

    Parameters
    ----------
    ideal_f, previous_f : (M, N') Omega of this frame, and the label of the last training.
    threat : mutation threat factor of this frame.
    """
    state = FilterState.start(model, support, mu=cfg.penalty)
    cells = support.size_mn[0] * support.size_mn[1]  # T

    if cfg.label_rule == "split":  # filter with Omega, then the label, then the filter with it (spec B10)
        for _ in range(cfg.iterations):
            a_f, _ = solve_g(state, model, ideal_f, cells, kernels)
            state = restrict(state, a_f, model, support, cfg, kernels)
        probe("h_stage1", state.h)
        label = LabelState(previous_f, np.zeros_like(ideal_f), cfg.label_penalty)
        for _ in range(cfg.iterations):
            label = label_split_step(label, state.fit_f, ideal_f, previous_f, cells, cfg, kernels)
        label_f = label.r_f
        a_f, _ = solve_g(state, model, label_f, cells, kernels)
        for _ in range(cfg.iterations - 1):
            state = restrict(state, a_f, model, support, cfg, kernels)
            a_f, _ = solve_g(state, model, label_f, cells, kernels)
    else:
        # the label before the first iteration is the ideal one: the paper does not say
        label_f = ideal_f
        a_f, fit_f = solve_g(state, model, label_f, cells, kernels)
        for _ in range(cfg.iterations - 1):
            if cfg.label_rule == "joint":
                label_f = closed_form_label(fit_f, ideal_f, previous_f, threat=threat, cfg=cfg)
            state = restrict(state, a_f, model, support, cfg, kernels)
            a_f, fit_f = solve_g(state, model, label_f, cells, kernels)
        if cfg.label_rule == "joint":
            label_f = closed_form_label(fit_f, ideal_f, previous_f, threat=threat, cfg=cfg)
    # the h step of the last iteration would change nothing that is used
    return Learned(filter_of(state, a_f, model, support, kernels), label_f)
