"""Training: the correlation filter and its label by ADMM (paper Eq. 4-15, spec A3 and B10).

The filter's augmented Lagrangian is solved in its scaled form, with u = l / mu for the multiplier l. Writing
w = h - u, the Sherman-Morrison solution of the g sub-problem is w plus a rank-one correction,

    g = w + m a,   a = (q - m^H w) / (S_xx + T mu),   so that g + u = h + m a,

which is the paper's Eq. 9-12 with fewer passes over the arrays (derivation in docs/equations.md).
Shapes: C channels, M x N cells, T = M N, N' = N//2 + 1 bins of the half spectrum, m x n filter support.
"""

from dataclasses import dataclass

import numpy as np

from mscf.arrays import Probe, Real, Spectrum, no_probe
from mscf.config import TrackerConfig
from mscf.spectrum import SupportTransform


@dataclass(frozen=True, slots=True)
class FilterState:
    """ADMM iterate of the filter."""

    g_f: Spectrum  # (C, M, N') the filter, unrestricted; what localisation uses
    h_sp: Real  # (C, m, n) the filter on its support, in space
    h_f: Spectrum  # (C, M, N') its DFT
    u_f: Spectrum  # (C, M, N') scaled multiplier l / mu
    mu: float  # penalty of the next step

    @classmethod
    def start(cls, model_f: Spectrum, support: SupportTransform, *, mu: float) -> "FilterState":
        """All zero, as each training begins."""
        zero_f = np.zeros_like(model_f)
        h_sp = np.zeros((model_f.shape[0], support.rows_inv.shape[0], support.cols_inv.shape[1]), np.float32)
        return cls(zero_f, h_sp, zero_f, zero_f, mu)


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


def filter_step(
    state: FilterState,
    model_f: Spectrum,
    energy: Real,
    label_f: Spectrum,
    support: SupportTransform,
    cfg: TrackerConfig,
) -> FilterState:
    """One ADMM iteration of the filter for a given label: g, h, multiplier, penalty (paper Eq. 7-12, 14, 15).

    Parameters
    ----------
    model_f : (C, M, N') running model m.
    energy : (M, N') S_xx = sum_d |m_d|^2.
    label_f : (M, N') the label q.
    """
    cells = support.size_mn[0] * support.size_mn[1]  # T
    mu = state.mu
    w_f = state.h_f - state.u_f
    # sub-problem g, per DFT bin; the denominator is positive as mu is
    a_f = (label_f - correlate(model_f, w_f)) / (energy + np.float32(cells * mu))  # (M, N')
    correction_f = model_f * a_f
    g_f = w_f + correction_f
    # sub-problem h, in space, cropped to the support: T mu / (T mu + lambda1) (g + u)
    sum_f = state.h_f + correction_f  # g + u
    h_sp = np.float32(cells * mu / (cells * mu + cfg.filter_weight)) * support.inverse(sum_f)
    h_f = support.forward(h_sp)
    mu_next = min(cfg.penalty_growth * mu, cfg.penalty_max)
    u_f = (sum_f - h_f) * np.float32(mu / mu_next)  # u + g - h, rescaled to the next penalty
    return FilterState(g_f, h_sp, h_f, u_f, mu_next)


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
    """The paper's label: weighted mean of response, ideal label and previous label (paper Eq. 13).

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
    energy = correlate(model_f, model_f).real  # S_xx
    state = FilterState.start(model_f, support, mu=cfg.penalty)
    label_f = ideal_f
    cells = support.size_mn[0] * support.size_mn[1]

    if cfg.label_rule == "split":  # filter with Omega, then the label, then the filter with it (spec B10)
        for _ in range(cfg.iterations):
            state = filter_step(state, model_f, energy, ideal_f, support, cfg)
        probe("h_stage1", state.h_sp)
        correlation_f = correlate(state.h_f, model_f)
        label = LabelState(previous_f, np.zeros_like(ideal_f), cfg.label_penalty)
        for _ in range(cfg.iterations):
            label = label_split_step(label, correlation_f, ideal_f, previous_f, cells, cfg)
        label_f = label.r_f
        for _ in range(cfg.iterations):
            state = filter_step(state, model_f, energy, label_f, support, cfg)
    else:
        for _ in range(cfg.iterations):
            state = filter_step(state, model_f, energy, label_f, support, cfg)
            if cfg.label_rule == "joint":
                fit_f = correlate(model_f, state.g_f)  # m^H g, what the data term compares with r
                label_f = closed_form_label(fit_f, ideal_f, previous_f, threat=threat, cfg=cfg)
    probe("h_final", state.h_sp)
    return Learned(state.g_f, label_f)
