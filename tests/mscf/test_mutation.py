import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mscf.kernels import Kernels
from mscf.mutation import regional_maxima, threat_in_window, threat_of_peaks

if TYPE_CHECKING:
    from collections.abc import Callable


def expected(ratio: float, distance: float, nu: float = 1.0, delta: float = 0.01) -> float:
    """Eq. 1 and 2 for one sub-peak."""
    return ratio * nu / (1 + delta * math.exp(distance))


def planted(
    main: tuple[int, int], sub: tuple[int, int], height: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    response = np.zeros((50, 50), np.float32)
    response[main] = 0.08
    response[(main[0] + sub[0]) % 50, (main[1] + sub[1]) % 50] = 0.08 * height
    return response


@pytest.mark.parametrize("main", [(0, 0), (12, 47), (25, 25), (49, 0)])
@pytest.mark.parametrize("sub", [(2, 0), (0, -3), (3, 4), (-7, 3), (12, -9)])
def test_a_planted_sub_peak_gives_the_threat_of_the_formula(main: tuple[int, int], sub: tuple[int, int]) -> None:
    threat = threat_of_peaks(planted(main, sub, 0.6), nu=1.0, delta=0.01)
    assert threat == pytest.approx(expected(0.6, math.hypot(*sub)), rel=1e-5)


def test_the_most_dangerous_of_several_sub_peaks_counts() -> None:
    response = planted((0, 0), (8, 0), 0.9)  # higher, but farther
    response[0, 4] = 0.08 * 0.7
    assert threat_of_peaks(response, nu=1.0, delta=0.01) == pytest.approx(expected(0.7, 4), rel=1e-5)


def test_the_flank_of_the_main_peak_is_no_threat_in_the_papers_sense(kernels: Kernels) -> None:
    d = np.minimum(np.arange(50), 50 - np.arange(50))
    response = np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / 30).astype(np.float32)
    assert threat_of_peaks(response, nu=1.0, delta=0.01) == pytest.approx(0, abs=1e-6)
    # the published code cuts the hole first and so sees the flank: spec C, row 4
    assert kernels.threat_in_window(response, nu=1.0, delta=0.01) > 0.5


@pytest.mark.parametrize("sub", [(2, 0), (0, -3), (3, 4), (-6, 6)])
def test_the_published_window_sees_a_sub_peak_within_6_cells(kernels: Kernels, sub: tuple[int, int]) -> None:
    threat = kernels.threat_in_window(planted((0, 0), sub, 0.6), nu=1.0, delta=0.01)
    assert threat == pytest.approx(expected(0.6, math.hypot(*sub)), rel=1e-5)


def test_the_published_window_is_blind_beyond(kernels: Kernels) -> None:
    assert kernels.threat_in_window(planted((0, 0), (7, 0), 0.9), nu=1.0, delta=0.01) == 0


@pytest.mark.parametrize("shift", [(0, 0), (24, 0), (-25, 3), (10, -25), (24, 24), (-25, -25)])
def test_the_window_stays_inside_the_map(shift: tuple[int, int], rng: np.random.Generator) -> None:
    response = np.roll(planted((0, 0), (3, 0), 0.5), shift, axis=(0, 1))
    response += rng.uniform(0, 1e-4, response.shape).astype(np.float32)
    windows = []
    threat = threat_in_window(response, nu=1.0, delta=0.01, probe=lambda _, array: windows.append(array))
    assert windows[0].shape == windows[1].shape == (13, 13)
    assert 0 < threat < 1


@pytest.mark.parametrize("shift", [(24, 0), (-25, 3), (10, -25), (24, 24), (-25, -25)])
def test_a_sub_peak_beside_a_peak_at_the_rim_counts_from_the_middle_of_the_window(
    kernels: Kernels, shift: tuple[int, int]
) -> None:
    windows: list[Any] = []
    response = np.roll(planted((0, 0), (3, 0), 0.5), shift, axis=(0, 1))
    threat_in_window(response, nu=1.0, delta=0.01, probe=lambda _, array: windows.append(array))
    rows, cols = np.nonzero(windows[0])
    by_hand = [
        expected(windows[0][r, c] / response.max(), math.hypot(r - 6, c - 6)) for r, c in zip(rows, cols, strict=True)
    ]
    assert kernels.threat_in_window(response, nu=1.0, delta=0.01) == pytest.approx(max(by_hand, default=0), rel=1e-5)


def test_a_response_without_a_positive_peak_is_all_threat(kernels: Kernels) -> None:
    rules: tuple[Callable[..., float], ...] = (kernels.threat_in_window, threat_of_peaks)
    for rule in rules:
        assert rule(np.zeros((50, 50), np.float32), nu=1.0, delta=0.01) == 1
        assert rule(np.full((50, 50), -1, np.float32), nu=1.0, delta=0.01) == 1


def test_regional_maxima_look_at_all_eight_neighbours() -> None:
    values = np.zeros((5, 5), np.float32)
    values[1, 1], values[2, 2], values[4, 4] = 1, 2, 3
    maxima = regional_maxima(values)
    assert maxima[1, 1] == 0
    assert maxima[2, 2] == maxima[4, 4] == 1
