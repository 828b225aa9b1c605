"""Training by construction: each solution is the minimum of the objective it is stated for.

The objectives are quadratic, so a central difference is their directional derivative but for rounding. It is
compared with the derivative a small step away from the solution: single precision leaves 1e-3 of that.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mscf.arrays import Spectrum
from mscf.config import TrackerConfig
from mscf.filter import (
    FilterState,
    LabelState,
    Model,
    closed_form_label,
    filter_of,
    label_split_step,
    learn,
    restrict,
    solve_g,
)
from mscf.kernels import Kernels
from mscf.labels import gaussian_label
from mscf.spectrum import SupportTransform, correlate, dft

SIZE = (16, 16)
CELLS = 256
SUPPORT = (5, 4)
CHANNELS = 3


@pytest.fixture
def support() -> SupportTransform:
    return SupportTransform.centred(SIZE, SUPPORT)


@pytest.fixture
def model_f(rng: np.random.Generator) -> Spectrum:
    return dft(rng.standard_normal((CHANNELS, *SIZE), dtype=np.float32))


@pytest.fixture
def model(kernels: Kernels, model_f: Spectrum) -> Model:
    return Model.of(model_f, kernels)


@pytest.fixture
def label_f() -> Spectrum:
    return dft(gaussian_label(SIZE, sigma_cells=1.0))


def slope_ratio(objective: Callable[[Any], float], solution: Any, rng: np.random.Generator) -> float:
    """Largest directional derivative at `solution`, over that a step of 1 % away in the same direction."""
    solution = solution.astype(np.result_type(solution.dtype, np.float64))
    step = 1e-2 * np.abs(solution).max()
    worst = 0.0
    for _ in range(12):
        direction = rng.standard_normal(solution.shape)
        if np.iscomplexobj(solution):
            direction = direction + 1j * rng.standard_normal(solution.shape)
        here = objective(solution + step * direction) - objective(solution - step * direction)
        there = objective(solution + 2 * step * direction) - objective(solution)
        worst = max(worst, abs(here / there))
    return worst


@pytest.fixture
def state(kernels: Kernels, model: Model, label_f: Spectrum, support: SupportTransform) -> FilterState:
    """An iterate with everything non-zero: after one step from zero."""
    start = FilterState.start(model, support, mu=0.1)
    a_f, _ = solve_g(start, model, label_f, CELLS, kernels)
    return restrict(start, a_f, model, support, TrackerConfig(), kernels)


def multiplier(state: FilterState, model: Model, support: SupportTransform, kernels: Kernels) -> Spectrum:
    """Scaled multiplier u of a state: g = h - u where the correction is zero."""
    without_correction_f = filter_of(state, np.zeros_like(state.fit_f), model, support, kernels)
    return np.asarray(support.forward(state.h) - without_correction_f)


def test_g_minimises_its_sub_problem(
    kernels: Kernels,
    rng: np.random.Generator,
    state: FilterState,
    model: Model,
    label_f: Spectrum,
    support: SupportTransform,
) -> None:
    a_f, fit_f = solve_g(state, model, label_f, CELLS, kernels)
    h_f = support.forward(state.h)
    g_f, u_f = filter_of(state, a_f, model, support, kernels), multiplier(state, model, support, kernels)
    assert np.abs(u_f).max() > 1e-4  # the state is no trivial one

    def objective(g: Any) -> float:  # paper Eq. 8 times T, per bin; u = zeta / mu
        fit = np.sum(np.abs(label_f - np.sum(model.m_f.conj() * g, axis=0)) ** 2)
        split = np.sum(np.abs(g - h_f + u_f) ** 2)
        return float(0.5 * fit + 0.5 * state.mu * CELLS * split)

    assert slope_ratio(objective, g_f, rng) < 1e-3
    np.testing.assert_allclose(fit_f, correlate(model.m_f, g_f), rtol=1e-3, atol=1e-4)


def test_g_is_the_solution_of_the_normal_equations_of_a_bin(
    kernels: Kernels, state: FilterState, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    a_f, _ = solve_g(state, model, label_f, CELLS, kernels)
    g_f = filter_of(state, a_f, model, support, kernels)
    w_f = support.forward(state.h) - multiplier(state, model, support, kernels)
    for bin_rc in [(0, 0), (3, 5), (15, 8)]:
        m = model.m_f[:, *bin_rc].astype(np.complex128)
        matrix = np.outer(m, m.conj()) + CELLS * state.mu * np.eye(CHANNELS)
        g = np.linalg.solve(matrix, m * label_f[bin_rc] + CELLS * state.mu * w_f[:, *bin_rc])
        np.testing.assert_allclose(g_f[:, *bin_rc], g, rtol=1e-3, atol=1e-6)


def test_h_minimises_its_sub_problem(
    kernels: Kernels,
    rng: np.random.Generator,
    state: FilterState,
    model: Model,
    label_f: Spectrum,
    support: SupportTransform,
) -> None:
    cfg = TrackerConfig()
    a_f, _ = solve_g(state, model, label_f, CELLS, kernels)
    after = restrict(state, a_f, model, support, cfg, kernels)
    half = filter_of(state, a_f, model, support, kernels), multiplier(state, model, support, kernels)
    g_ff, u_ff = (np.fft.fft2(np.fft.irfft2(x_f, s=SIZE)) for x_f in half)  # all bins
    top, left = SIZE[0] // 2 - SUPPORT[0] // 2, SIZE[1] // 2 - SUPPORT[1] // 2

    def objective(h: Any) -> float:  # paper Eq. 7, zero outside the support
        padded = np.zeros((CHANNELS, *SIZE))
        padded[:, top : top + SUPPORT[0], left : left + SUPPORT[1]] = h
        split = np.sum(np.abs(g_ff - np.fft.fft2(padded) + u_ff) ** 2)
        return float(0.5 * cfg.filter_weight * np.sum(h**2) + 0.5 * state.mu * split)

    assert slope_ratio(objective, after.h, rng) < 1e-3


def test_the_multiplier_grows_by_the_gap_between_g_and_h(
    kernels: Kernels, state: FilterState, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    a_f, _ = solve_g(state, model, label_f, CELLS, kernels)
    after = restrict(state, a_f, model, support, TrackerConfig(), kernels)
    gap_f = filter_of(state, a_f, model, support, kernels) - support.forward(after.h)
    expected = state.mu * multiplier(state, model, support, kernels) + state.mu * gap_f  # paper Eq. 13
    found = after.mu * multiplier(after, model, support, kernels)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_the_penalty_grows_to_its_limit(
    kernels: Kernels, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    cfg = TrackerConfig(penalty=0.1, penalty_growth=10, penalty_max=5)
    state = FilterState.start(model, support, mu=cfg.penalty)
    penalties = []
    for _ in range(4):
        penalties.append(state.mu)
        a_f, _ = solve_g(state, model, label_f, CELLS, kernels)
        state = restrict(state, a_f, model, support, cfg, kernels)
    assert penalties == pytest.approx([0.1, 1, 5, 5])


def test_g_and_h_agree_once_the_iterations_have_converged(
    kernels: Kernels, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    cfg = TrackerConfig(penalty=1.0, penalty_growth=1.0)
    state = FilterState.start(model, support, mu=cfg.penalty)
    for _ in range(400):
        a_f, _ = solve_g(state, model, label_f, CELLS, kernels)
        g_f = filter_of(state, a_f, model, support, kernels)
        state = restrict(state, a_f, model, support, cfg, kernels)
    assert np.abs(g_f - support.forward(state.h)).max() / np.abs(support.forward(state.h)).max() < 1e-2


@pytest.mark.parametrize("threat", [0.0, 0.4, 1.0])
def test_r_minimises_its_sub_problem(rng: np.random.Generator, label_f: Spectrum, threat: float) -> None:
    cfg = TrackerConfig(ideal_weight=2.0, previous_weight=3.0)
    fit_f, previous_f = (dft(rng.standard_normal(SIZE, dtype=np.float32)) for _ in range(2))
    r_f = closed_form_label(fit_f, label_f, previous_f, threat=threat, cfg=cfg)

    def objective(r: Any) -> float:  # paper Eq. 12
        return float(
            0.5 * np.sum(np.abs(r - fit_f) ** 2)
            + 0.5 * (1 + threat**2) * cfg.ideal_weight * np.sum(np.abs(label_f - r) ** 2)
            + 0.5 * (1 - threat**2) * cfg.previous_weight * np.sum(np.abs(r - previous_f) ** 2)
        )

    assert slope_ratio(objective, r_f, rng) < 1e-3


def test_each_variable_of_the_split_label_minimises_its_sub_problem(
    kernels: Kernels, rng: np.random.Generator, label_f: Spectrum
) -> None:
    cfg = TrackerConfig()
    fit_f, previous_f, xi_f = (dft(rng.standard_normal(SIZE, dtype=np.float32)) for _ in range(3))
    before = LabelState(previous_f, xi_f, 27.0)
    after = label_split_step(before, fit_f, label_f, previous_f, CELLS, cfg, kernels)
    s_f = after.xi_f / 27.0 - before.xi_f / 27.0 + after.r_f  # from the multiplier's update

    def label_objective(r: Any) -> float:
        return float(
            0.5 * cfg.ideal_weight * np.sum(np.abs(label_f - r) ** 2)
            + 0.5 * cfg.previous_weight * np.sum(np.abs(r - previous_f) ** 2)
            + 0.5 * 27.0 * CELLS * np.sum(np.abs(s_f - r - xi_f / 27.0) ** 2)
        )

    def split_objective(s: Any) -> float:
        fit = np.sum(np.abs(s - fit_f.conj()) ** 2)
        return float(0.5 * fit + 0.5 * 27.0 * CELLS * np.sum(np.abs(s - before.r_f - xi_f / 27.0) ** 2))

    assert slope_ratio(split_objective, s_f, rng) < 1e-3
    assert slope_ratio(label_objective, after.r_f, rng) < 1e-3


def test_the_label_follows_the_response_when_lambda2_is_small(
    kernels: Kernels, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    cfg = TrackerConfig(label_rule="joint", iterations=3, ideal_weight=0.0, previous_weight=0.0)
    learned = learn(model, label_f, label_f, threat=0.3, support=support, cfg=cfg, kernels=kernels)
    np.testing.assert_allclose(learned.label_f, correlate(model.m_f, learned.g_f), rtol=1e-4, atol=1e-4)


def test_the_label_stays_at_omega_when_lambda2_is_large(
    kernels: Kernels, rng: np.random.Generator, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    cfg = TrackerConfig(label_rule="joint", iterations=3, ideal_weight=1e7)
    previous_f = dft(rng.standard_normal(SIZE, dtype=np.float32))
    learned = learn(model, label_f, previous_f, threat=0.3, support=support, cfg=cfg, kernels=kernels)
    np.testing.assert_allclose(learned.label_f, label_f, atol=1e-3)


def test_a_fixed_label_is_returned_as_it_came(
    kernels: Kernels, model: Model, label_f: Spectrum, support: SupportTransform
) -> None:
    cfg = TrackerConfig.preset("bacf")
    learned = learn(model, label_f, label_f, threat=0.0, support=support, cfg=cfg, kernels=kernels)
    np.testing.assert_array_equal(learned.label_f, label_f)


@pytest.mark.parametrize("preset", ["reference", "paper", "bacf", "bacf+al", "bacf+ahl", "mscf"])
def test_an_all_zero_model_gives_finite_numbers(
    kernels: Kernels, preset: str, label_f: Spectrum, support: SupportTransform
) -> None:
    zero_f = np.zeros((CHANNELS, 16, 9), np.complex64)
    learned = learn(
        Model.of(zero_f, kernels),
        label_f,
        label_f,
        threat=0.0,
        support=support,
        cfg=TrackerConfig.preset(preset),
        kernels=kernels,
    )
    assert np.isfinite(learned.g_f).all()
    assert np.isfinite(learned.label_f).all()
    assert learned.g_f.dtype == learned.label_f.dtype == np.complex64
