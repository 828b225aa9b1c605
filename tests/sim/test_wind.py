"""Wind: its statistics, and that it is a function of time."""

import numpy as np
import pytest

from sim.wind import CALM, Wind

TIMES_S = np.arange(0.0, 2000.0, 1.0)


def sampled(wind: Wind, times_s: np.ndarray = TIMES_S) -> np.ndarray:
    return np.array([wind.velocity_ne_mps(float(time_s)) for time_s in times_s])


def test_calm_is_no_wind_at_any_time() -> None:
    assert {CALM.velocity_ne_mps(time_s) for time_s in (0.0, 1.0, 1e6)} == {(0.0, 0.0)}


def test_wind_without_gusts_is_its_mean() -> None:
    assert Wind((3.0, -4.0)).velocity_ne_mps(12.3) == (3.0, -4.0)


@pytest.mark.parametrize("seed", range(4))
def test_gusts_have_the_asked_deviation_about_the_mean(seed: int) -> None:
    """A sum of a few waves over a finite time: within 15 %."""
    wind = sampled(Wind((3.0, -4.0), gust_mps=1.5, seed=seed))
    assert wind.mean(axis=0) == pytest.approx([3.0, -4.0], abs=0.15)
    assert wind.std(axis=0) == pytest.approx([1.5, 1.5], rel=0.15)


@pytest.mark.parametrize("correlation_s", [2.0, 6.0])
def test_gusts_forget_themselves_exponentially(correlation_s: float) -> None:
    """Mean over seeds of the correlation at a lag of one correlation time: 1/e."""
    at_lag = []
    for seed in range(12):
        wind = Wind(gust_mps=1.0, correlation_s=correlation_s, seed=seed)
        now, later = sampled(wind), sampled(wind, TIMES_S + correlation_s)
        at_lag.append((now * later).mean() / (now**2).mean())
    assert np.mean(at_lag) == pytest.approx(np.exp(-1.0), abs=0.06)


def test_wind_depends_on_seed_and_time_alone() -> None:
    forward = sampled(Wind(gust_mps=1.0, seed=3), TIMES_S[:50])
    backward = sampled(Wind(gust_mps=1.0, seed=3), TIMES_S[:50][::-1])[::-1]
    np.testing.assert_array_equal(forward, backward)
    assert not np.allclose(forward, sampled(Wind(gust_mps=1.0, seed=4), TIMES_S[:50]))


@pytest.mark.parametrize("bad", [{"gust_mps": -1.0}, {"correlation_s": 0.0}])
def test_impossible_wind_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Wind(**bad)
