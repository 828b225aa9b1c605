"""Training: the correlation filter and its label by ADMM (paper Eq. 4-13, spec A3 and B10).

The filter's augmented Lagrangian is solved in its scaled form, with u = l / mu for the multiplier l. Writing
w = h - u, the Sherman-Morrison solution of the g sub-problem is w plus a rank-one correction,

    g = w + m a,   a = (q - m^H w) / (S_xx + T mu),   so that g + u = h + m a.

Only a, one number per DFT bin, and h are carried from step to step: m^H w follows from m^H h, and w itself is
formed once, for the last g. It is the paper's Eq. 8-11 and 13 rearranged (derivation in docs/equations.md).
Shapes: C channels, M x N cells, T = M N, N' = N//2 + 1 bins of the half spectrum, m x n filter support.
"""

from dataclasses import dataclass

import numpy as np

from mscf.arrays import Probe, Real, Spectrum, no_probe
from mscf.config import TrackerConfig
from mscf.spectrum import SupportTransform


@dataclass(frozen=True, slots=True)
class Model:
    """What the filter is trained on, and what of it every step needs."""

    m_f: Spectrum  # (C, M, N') running mean of samples
    energy: Real  # (M, N') S_xx = sum_d |m_d|^2

    @classmethod
    def of(cls, m_f: Spectrum) -> "Model":
        """Model for a running mean (C, M, N')."""
        return cls(m_f, correlate(m_f, m_f).real)


@dataclass(frozen=True, slots=True)
class FilterState:
    """ADMM iterate of the filter after its h step; all zero at the start."""

    mu: float  # penalty of the next step
    h_sp: Real  # (C, m, n) the filter on its support, in space
    h_f: Spectrum  # (C, M, N') its DFT
    fit_f: Spectrum  # (M, N') m^H h
    # of the step before, and by how much the penalty has grown since: with them u = growth^-1 (h' + m a' - h)
    h_before_f: Spectrum  # (C, M, N')
    a_before_f: Spectrum  # (M, N')
    fit_before_f: Spectrum  # (M, N')
    inverse_growth: float

    @classmethod
    def start(cls, model: Model, support: SupportTransform, *, mu: float) -> "FilterState":
        """All zero, as each training begins."""
        h_sp = np.zeros((model.m_f.shape[0], support.rows_inv.shape[0], support.cols_inv.shape[1]), np.float32)
        zero_f, zero_map_f = np.zeros_like(model.m_f), np.zeros_like(model.m_f[0])
        return cls(mu, h_sp, zero_f, zero_map_f, zero_f, zero_map_f, zero_map_f, 1.0)


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


def correlate(a_f: Spectrum, b_f: Spectrum) -> Spectrum:
    """sum_d conj(a_d) b_d: (C, M, N') twice -> (M, N')."""
    product_f = a_f.conj()
    product_f *= b_f
    out: Spectrum = product_f.sum(axis=0)  # four times as fast as einsum, which has no kernel for this
    return out


def solve_g(state: FilterState, model: Model, label_f: Spectrum, cells: int) -> tuple[Spectrum, Spectrum]:
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
    # m^H u = growth^-1 (m^H h' + S_xx a' - m^H h)
    before_f = state.fit_before_f + model.energy * state.a_before_f - state.fit_f
    fit_w_f = state.fit_f - np.float32(state.inverse_growth) * before_f  # m^H w
    # positive denominator, as mu is
    a_f: Spectrum = (label_f - fit_w_f) / (model.energy + np.float32(cells * state.mu))
    return a_f, fit_w_f + model.energy * a_f


def filter_of(state: FilterState, a_f: Spectrum, model: Model) -> Spectrum:
    """Filter of a correction, g = h - u + m a: (C, M, N')."""
    u_f = model.m_f * state.a_before_f
    u_f += state.h_before_f
    u_f -= state.h_f
    u_f *= np.float32(state.inverse_growth)
    g_f: Spectrum = model.m_f * a_f
    g_f += state.h_f
    g_f -= u_f
    return g_f


def restrict(
    state: FilterState, a_f: Spectrum, model: Model, support: SupportTransform, cfg: TrackerConfig
) -> FilterState:
    """Sub-problem h, in space and cropped to the support, multiplier and penalty (paper Eq. 7, 13).

    h = T mu / (T mu + lambda1) crop(IDFT(g + u)), and g + u = h' + m a with h' already on the support.
    """
    cells = support.size_mn[0] * support.size_mn[1]  # T
    shrink = np.float32(cells * state.mu / (cells * state.mu + cfg.filter_weight))
    h_sp = shrink * (state.h_sp + support.inverse(model.m_f * a_f))
    h_f = support.forward(h_sp)
    mu = min(cfg.penalty_growth * state.mu, cfg.penalty_max)
    return FilterState(
        mu=mu,
        h_sp=h_sp,
        h_f=h_f,
        fit_f=correlate(model.m_f, h_f),
        h_before_f=state.h_f,
        a_before_f=a_f,
        fit_before_f=state.fit_f,
        inverse_growth=state.mu / mu,
    )


def label_split_step(
    state: LabelState, correlation_f: Spectrum, ideal_f: Spectrum, previous_f: Spectrum, cells: int, cfg: TrackerConfig
) -> LabelState:
    """One iteration of the published code's label: split variable s, label r, multiplier xi (spec B10, loop B).

    Deviation from the paper, as the published code has it: no (1 +- Psi^2) weights, and the data term stands
    behind the split variable. With gamma T far above lambda2 the label moves by 1.35 % per training (spec C).

    Parameters
    ----------
    correlation_f : (M, N') G = sum_d conj(h_d) m_d.
    ideal_f, previous_f : (M, N') Omega, and the label of the last training.
    cells : T.
    """
    weight = state.gamma * cells  # gamma T
    s_f = (correlation_f + np.float32(weight) * state.r_f + np.float32(cells) * state.xi_f) / np.float32(1 + weight)
    r_f = (
        np.float32(cfg.ideal_weight) * ideal_f
        + np.float32(cfg.previous_weight) * previous_f
        + np.float32(weight) * s_f
        - np.float32(cells) * state.xi_f
    ) / np.float32(cfg.ideal_weight + cfg.previous_weight + weight)
    xi_f = state.xi_f + np.float32(state.gamma) * (s_f - r_f)
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
    model_f: Spectrum,
    ideal_f: Spectrum,
    previous_f: Spectrum,
    *,
    threat: float,
    support: SupportTransform,
    cfg: TrackerConfig,
    probe: Probe = no_probe,
) -> Learned:
    """Train filter and label on a model (paper section III-C).

    Parameters
    ----------
    model_f : (C, M, N').
    ideal_f, previous_f : (M, N') Omega of this frame, and the label of the last training.
    threat : mutation threat factor of this frame.
    """
    model = Model.of(model_f)
    state = FilterState.start(model, support, mu=cfg.penalty)
    cells = support.size_mn[0] * support.size_mn[1]  # T

    if cfg.label_rule == "split":  # filter with Omega, then the label, then the filter with it (spec B10)
        for _ in range(cfg.iterations):
            a_f, _ = solve_g(state, model, ideal_f, cells)
            state = restrict(state, a_f, model, support, cfg)
        probe("h_stage1", state.h_sp)
        label = LabelState(previous_f, np.zeros_like(ideal_f), cfg.label_penalty)
        for _ in range(cfg.iterations):
            label = label_split_step(label, state.fit_f.conj(), ideal_f, previous_f, cells, cfg)
        label_f = label.r_f
        a_f, _ = solve_g(state, model, label_f, cells)
        for _ in range(cfg.iterations - 1):
            state = restrict(state, a_f, model, support, cfg)
            a_f, _ = solve_g(state, model, label_f, cells)
    else:
        # the label before the first iteration is the ideal one: the paper does not say
        label_f = ideal_f
        a_f, fit_f = solve_g(state, model, label_f, cells)
        for _ in range(cfg.iterations - 1):
            if cfg.label_rule == "joint":
                label_f = closed_form_label(fit_f, ideal_f, previous_f, threat=threat, cfg=cfg)
            state = restrict(state, a_f, model, support, cfg)
            a_f, fit_f = solve_g(state, model, label_f, cells)
        if cfg.label_rule == "joint":
            label_f = closed_form_label(fit_f, ideal_f, previous_f, threat=threat, cfg=cfg)
    # the h step of the last iteration would change nothing that is used
    return Learned(filter_of(state, a_f, model), label_f)
