import numpy as np
import pytest

from mscf.arrays import Real
from mscf.confidence import confidence, peak_to_sidelobe


def response(peak: float, noise: float, at: tuple[int, int] = (0, 0)) -> Real:
    """A sharp peak over noise."""
    rng = np.random.default_rng(3)
    d = np.minimum(np.arange(50), 50 - np.arange(50))
    bump = peak * np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / 4)
    return np.roll(bump + rng.normal(0, noise, (50, 50)), at, axis=(0, 1)).astype(np.float32)


def test_the_ratio_is_that_of_the_definition() -> None:
    ratio = peak_to_sidelobe(response(1.0, 0.05))
    assert ratio == pytest.approx(1.0 / 0.05, rel=0.15)  # the noise under the peak counts too


@pytest.mark.parametrize("at", [(0, 0), (25, 25), (3, 47), (-20, 10)])
def test_it_does_not_matter_where_the_peak_is(at: tuple[int, int]) -> None:
    assert peak_to_sidelobe(response(1.0, 0.05, at)) == pytest.approx(peak_to_sidelobe(response(1.0, 0.05)), rel=1e-3)


def test_a_flat_map_has_no_peak() -> None:
    assert peak_to_sidelobe(np.ones((50, 50), np.float32)) == 0
    assert confidence(np.zeros((50, 50), np.float32), 0.1) == 0
    assert confidence(np.full((50, 50), -1, np.float32), 0.1) == 0


def test_confidence_rises_with_sharpness_and_with_height() -> None:
    by_noise = [confidence(response(0.1, noise), 0.1) for noise in (0.05, 0.02, 0.01, 0.005)]
    assert by_noise == sorted(by_noise)
    by_height = [confidence(response(0.1, 0.01), first) for first in (1.0, 0.3, 0.1)]
    assert by_height == sorted(by_height)
    assert 0.9 < by_noise[-1] < 1
    assert confidence(response(0.0, 0.01), first_peak=0.1) < 0.2  # nothing but noise


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e3, 1e30])
def test_any_height_gives_a_number_from_0_to_1(scale: float) -> None:
    assert 0 <= confidence(response(scale, scale / 10), 0.1) <= 1
