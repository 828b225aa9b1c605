import math

import numpy as np
import pytest

from mscf.arrays import Real
from mscf.confidence import BIAS, LOG_PSR, confidence
from mscf.kernels import Kernels


def response(peak: float, noise: float, at: tuple[int, int] = (0, 0)) -> Real:
    """A sharp peak over noise."""
    rng = np.random.default_rng(3)
    d = np.minimum(np.arange(50), 50 - np.arange(50))
    bump = peak * np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / 4)
    return np.asarray(np.roll(bump + rng.normal(0, noise, (50, 50)), at, axis=(0, 1)), np.float32)


def judged(kernels: Kernels, values: Real) -> float:
    """Confidence as the tracker asks for it."""
    return confidence(float(values.max()), kernels.peak_to_sidelobe(values))


def test_the_ratio_is_that_of_the_definition(kernels: Kernels) -> None:
    values = np.zeros((50, 50), np.float32)
    values[::2] = 1  # sidelobe of about one half, which deviates by as much
    values[20, 30] = 5
    hole = np.zeros((50, 50), bool)
    hole[15:26, 25:36] = True
    sidelobe = values[~hole]
    assert kernels.peak_to_sidelobe(values) == pytest.approx((5 - sidelobe.mean()) / sidelobe.std(), rel=1e-6)
    assert kernels.peak_to_sidelobe(values) == pytest.approx(9, abs=0.05)


def test_what_is_near_the_peak_is_no_sidelobe(kernels: Kernels) -> None:
    far, near = response(1.0, 0.02), response(1.0, 0.02)
    near[5, 0] = near[0, 45] = 0.9
    assert kernels.peak_to_sidelobe(near) == pytest.approx(kernels.peak_to_sidelobe(far))
    far[6, 0] = 0.9
    assert kernels.peak_to_sidelobe(far) < 0.8 * kernels.peak_to_sidelobe(near)


@pytest.mark.parametrize("at", [(0, 0), (25, 25), (3, 47), (-20, 10)])
def test_it_does_not_matter_where_the_peak_is_nor_how_high(kernels: Kernels, at: tuple[int, int]) -> None:
    here = judged(kernels, response(1.0, 0.05))
    assert judged(kernels, response(1.0, 0.05, at)) == pytest.approx(here, rel=1e-5)
    assert judged(kernels, 0.05 * response(1.0, 0.05, at)) == pytest.approx(here, rel=1e-5)


@pytest.mark.parametrize("flat", [0.0, -1.0, 1e-5, 7.0, math.nan])
def test_where_there_is_no_peak_there_is_no_confidence(kernels: Kernels, flat: float) -> None:
    assert judged(kernels, np.full((50, 50), flat, np.float32)) == 0


def test_a_peak_that_is_less_than_its_surroundings_have_on_average_is_none(kernels: Kernels) -> None:
    upside_down = np.full((50, 50), -1.0, np.float32)
    upside_down[10, 10] = 0.0005
    assert judged(kernels, upside_down) == 0


def test_confidence_is_the_logistic_of_the_ratio_and_falls_with_noise(kernels: Kernels) -> None:
    by_noise = [judged(kernels, response(0.1, noise)) for noise in (0.002, 0.004, 0.008, 0.016, 0.03)]
    assert by_noise == sorted(by_noise, reverse=True)
    assert by_noise[0] > 0.95
    assert by_noise[-1] < 0.1
    ratio = kernels.peak_to_sidelobe(response(0.1, 0.008))
    assert judged(kernels, response(0.1, 0.008)) == pytest.approx(1 / (1 + math.exp(-BIAS) * ratio**-LOG_PSR))


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e3, 1e18])
def test_any_height_gives_a_number_from_0_to_1(kernels: Kernels, scale: float) -> None:
    assert 0 <= judged(kernels, response(scale, scale / 10)) <= 1


def test_an_infinite_peak_is_not_trusted(kernels: Kernels) -> None:
    broken = response(0.1, 0.005)
    broken[3, 4] = math.inf
    assert judged(kernels, broken) == 0
