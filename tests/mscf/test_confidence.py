import math

import numpy as np
import pytest

from mscf.arrays import Real
from mscf.confidence import FIRST_RESPONSES, RECENT_RATE, Evidence, History, confidence, peak_to_energy


def response(peak: float, noise: float, at: tuple[int, int] = (0, 0)) -> Real:
    """A sharp peak over noise."""
    rng = np.random.default_rng(3)
    d = np.minimum(np.arange(50), 50 - np.arange(50))
    bump = peak * np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / 4)
    return np.roll(bump + rng.normal(0, noise, (50, 50)), at, axis=(0, 1)).astype(np.float32)


def after(*responses: Real) -> tuple[float, History]:
    """Confidence in the last of some responses, and the history then."""
    history = History()
    for each in responses:
        evidence = Evidence.of(each)
        history = history.after(evidence)
    return confidence(evidence, history), history


GOOD = response(0.1, 0.005)
WEAK = response(0.03, 0.02)


def test_the_energy_ratio_is_that_of_the_definition() -> None:
    single = np.full((50, 50), 3.0, np.float32)
    single[7, 9] = 5.0
    assert peak_to_energy(single) == pytest.approx(2500)  # one cell of all has all the energy
    half = np.zeros((50, 50), np.float32)
    half[:25] = 1
    assert peak_to_energy(half) == pytest.approx(2)
    assert peak_to_energy(np.full((50, 50), 7, np.float32)) == 1


@pytest.mark.parametrize("at", [(0, 0), (25, 25), (3, 47), (-20, 10)])
def test_it_does_not_matter_where_the_peak_is(at: tuple[int, int]) -> None:
    here, there = Evidence.of(response(1.0, 0.05)), Evidence.of(response(1.0, 0.05, at))
    assert (here.log_peak, here.log_apce) == pytest.approx((there.log_peak, there.log_apce), rel=1e-5)


@pytest.mark.parametrize("flat", [0.0, -1.0, 1e-5])
def test_where_there_is_no_peak_there_is_no_confidence(flat: float) -> None:
    nothing = np.full((50, 50), flat, np.float32)
    assert after(GOOD, nothing)[0] == 0
    assert after(nothing)[0] == 0


def test_a_response_like_the_first_ones_is_trusted() -> None:
    assert after(*[GOOD] * 10)[0] > 0.8


def test_confidence_falls_with_the_height_of_the_peak_at_once() -> None:
    by_height = [after(*[GOOD] * 8, response(0.1 * share, 0.005 * share))[0] for share in (1.0, 0.5, 0.25, 0.1)]
    assert by_height == sorted(by_height, reverse=True)
    assert by_height[-1] < 0.5


def test_confidence_falls_further_while_the_response_stays_blurred() -> None:
    falling = [after(*[GOOD] * 8, *[response(0.1, 0.04)] * count)[0] for count in range(5)]
    assert falling == sorted(falling, reverse=True)
    assert falling[-1] < falling[0] - 0.2


def test_what_is_good_is_said_by_the_first_responses_only() -> None:
    _, early = after(*[GOOD] * FIRST_RESPONSES)
    _, late = after(*[GOOD] * FIRST_RESPONSES, *[WEAK] * 30)
    assert late.first == early.first
    assert late.recent_log_apce == pytest.approx(Evidence.of(WEAK).log_apce, rel=0.01)


def test_the_running_mean_forgets_at_its_rate() -> None:
    _, before = after(*[GOOD] * 20)
    now = before.after(Evidence.of(WEAK))
    step = (now.recent_log_apce - before.recent_log_apce) / (Evidence.of(WEAK).log_apce - before.recent_log_apce)
    assert step == pytest.approx(RECENT_RATE)


def test_at_another_place_the_recent_responses_do_not_count() -> None:
    _, history = after(*[GOOD] * 8)
    weak = Evidence.of(WEAK)
    there = history.elsewhere().after(weak)
    assert there.first == history.first
    assert there.recent_log_apce == weak.log_apce
    assert confidence(weak, there) < confidence(weak, history.after(weak))


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e3, 1e18])
def test_any_height_gives_a_number_from_0_to_1(scale: float) -> None:
    sure, history = after(GOOD, response(scale, scale / 10), GOOD)
    assert 0 <= sure <= 1
    assert math.isfinite(history.recent_log_apce)
    assert 0 <= after(GOOD, response(scale, scale / 10))[0] <= 1
