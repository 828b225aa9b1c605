"""Intervals by simulation, by cases worked by hand, and what pairs with what."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mscf.evaluation.metrics import Errors
from mscf.evaluation.record import Record, Run
from mscf.evaluation.statistics import (
    Difference,
    Interval,
    bootstrap_mean,
    paired_difference,
    sequence_values,
)
from mscf.geometry import Box

NOTHING = Errors(np.array([]), np.array([]), np.array([]))


def run_of(value: float, first: int = 0, x: float = 0) -> Run:
    """Run of a start that carries its value as the time of an update."""
    return Run(first, (Box(x, 0, 9, 9),) * 2, (False, False), (value,), NOTHING)


def value_of(run: Run) -> float:
    return run.update_ms[0]


def records_of(values: dict[str, Sequence[float]], tracker: str = "mscf") -> list[Record]:
    """Records whose runs start at frames 0, 1, 2 ..."""
    return [
        Record(name, tracker, frozenset(), tuple(run_of(value, first) for first, value in enumerate(several)))
        for name, several in values.items()
    ]


# --- intervals ---


@pytest.mark.parametrize(
    ("count", "sigma", "least"),
    # percentile intervals of few values are narrow: the standard error lacks sqrt(n / (n - 1)), and the normal
    # quantile stands for Student's
    [(6, 1.0, 0.83), (11, 0.2, 0.88), (40, 3.0, 0.915)],
)
def test_the_interval_holds_the_true_mean_about_as_often_as_it_says(count: int, sigma: float, least: float) -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(400):
        found = bootstrap_mean(rng.normal(0.4, sigma, count))
        held += found.low <= 0.4 <= found.high
    assert least <= held / 400 <= 0.97


def test_the_interval_is_as_wide_as_the_theory_of_means_says() -> None:
    values = np.random.default_rng(2).normal(0, 1, 400)
    found = bootstrap_mean(values)
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.03)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([], Interval(math.nan, math.nan, math.nan, 0)),
        ([math.nan], Interval(math.nan, math.nan, math.nan, 0)),
        ([0.3], Interval(0.3, math.nan, math.nan, 1)),
        # of two, a quarter of the resamples has the lower one twice, a quarter the higher one
        ([1.0, 0.0], Interval(0.5, 0, 1, 2)),
        ([0.25] * 5, Interval(0.25, 0.25, 0.25, 5)),
        # of three, 1/27 has the lowest one three times: more than 2.5 %
        ([0.0, math.nan, 3.0, 9.0], Interval(4, 0, 9, 3)),
        # of four, 0.4 % have the 4 four times and 4.7 % three times, 31.6 % never
        ([0.0, 0.0, 0.0, 4.0], Interval(1, 0, 3, 4)),
    ],
)
def test_intervals_of_a_few_values_are_those_worked_by_hand(values: list[float], expected: Interval) -> None:
    found = bootstrap_mean(np.array(values))
    assert found.count == expected.count
    for name in ("mean", "low", "high"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), nan_ok=True)


def test_the_interval_is_the_same_everywhere_whatever_the_order() -> None:
    values = np.array([0.3, 0.1, 0.25, 0.9, 0.6, 0.55, 0.35])
    found = bootstrap_mean(values)
    assert found == bootstrap_mean(values[::-1]) == bootstrap_mean(np.append(values, np.nan))
    assert found != bootstrap_mean(values, seed=1)
    # to the last bit, as PCG64 and sums in a fixed order give it
    assert found == Interval(0.43571428571428567, 0.2642857142857143, 0.6285714285714284, 7)


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=12), st.integers(0, 3))
def test_the_interval_lies_among_the_values_and_values_are_not_changed(values: list[float], seed: int) -> None:
    array = np.array(values)
    array.setflags(write=False)
    found = bootstrap_mean(array, seed)
    assert array.tolist() == values
    slack = 1e-12
    assert min(values) - slack <= found.low <= found.high <= max(values) + slack
    assert min(values) - slack <= found.mean <= max(values) + slack


# --- sequences ---


def test_a_sequence_has_the_mean_of_its_runs_and_runs_without_a_value_do_not_count() -> None:
    records = records_of({"a": [0.1, 0.5], "b": [math.nan, 0.4], "c": [math.nan], "d": []})
    found = sequence_values(records, value_of)
    assert found == pytest.approx({"a": 0.3, "b": 0.4, "c": math.nan, "d": math.nan}, nan_ok=True)


# --- differences ---


def test_differences_are_paired_by_sequence_and_start() -> None:
    a = records_of({"x": [0.5, 0.9], "y": [0.4], "only": [1.0]})
    b = records_of({"y": [0.1], "x": [0.1, 0.3, 0.7]})
    found = paired_difference(a, b, value_of)
    # x: (0.4 + 0.6) / 2 = 0.5, y: 0.3; of a the sequence "only", of b the third start of x stand alone
    assert found == Difference(pytest.approx(0.4), pytest.approx(0.3), pytest.approx(0.5), 2, 3, 2, 0, 2)


def test_a_start_is_its_frame_and_its_box() -> None:
    a = [Record("x", "a", frozenset(), (run_of(0.5, x=1), run_of(0.1, x=2), run_of(0.2, first=3, x=1)))]
    b = [Record("x", "b", frozenset(), (run_of(0.4, x=2), run_of(0.4, x=1), run_of(0.9, first=4, x=1)))]
    found = paired_difference(a, b, value_of)
    assert (found.pairs, found.unpaired) == (2, 2)
    assert found.mean == pytest.approx(((0.5 - 0.4) + (0.1 - 0.4)) / 2)


def test_pairs_without_a_value_do_not_count() -> None:
    a, b = records_of({"x": [0.5, math.nan], "y": [math.nan]}), records_of({"x": [0.1, math.nan], "y": [math.nan]})
    found = paired_difference(a, b, value_of)
    assert (found.mean, found.sequences, found.pairs, found.unpaired) == (pytest.approx(0.4), 1, 1, 0)


def test_what_has_nothing_in_common_has_no_difference() -> None:
    found = paired_difference(records_of({"x": [1.0]}), records_of({"y": [1.0]}), value_of)
    assert (found.sequences, found.pairs, found.unpaired, found.is_real) == (0, 0, 2, False)
    assert math.isnan(found.mean)


def test_long_sequences_and_many_runs_do_not_weigh_more() -> None:
    a = records_of({"x": [1.0] * 50, "y": [0.0]})
    b = records_of({"x": [0.0] * 50, "y": [1.0]})
    found = paired_difference(a, b, value_of)
    assert (found.mean, found.wins, found.losses, found.sequences, found.pairs) == (0, 1, 1, 2, 51)


def test_to_exchange_the_sides_turns_the_difference(rng: np.random.Generator) -> None:
    names = [f"s{index}" for index in range(9)]
    a = records_of({name: rng.uniform(size=3).tolist() for name in names})
    b = records_of({name: rng.uniform(size=3).tolist() for name in reversed(names)})
    there, back = paired_difference(a, b, value_of), paired_difference(b, a, value_of)
    assert there.mean == pytest.approx(-back.mean)
    assert (there.wins, there.losses, there.pairs) == (back.losses, back.wins, back.pairs)
    assert (there.low, there.high) == pytest.approx((-back.high, -back.low), abs=0.01)  # other resamples
    assert paired_difference(a, a, value_of) == Difference(0, 0, 0, 9, 27, 0, 0, 0)


@pytest.mark.parametrize(
    ("low", "high", "sequences", "is_real"),
    [
        (0.01, 0.1, 11, True),
        (-0.1, -0.01, 11, True),
        (0.0, 0.1, 11, False),
        (-0.1, 0.0, 11, False),
        (-0.1, 0.1, 11, False),
        (0.0, 0.0, 11, False),
        (math.nan, math.nan, 1, False),
        (0.01, 0.1, 6, True),
        (0.01, 0.1, 5, False),  # five that agree are 1 in 16 by chance
    ],
)
def test_a_difference_is_real_where_enough_sequences_keep_zero_out(
    low: float, high: float, sequences: int, *, is_real: bool
) -> None:
    assert Difference((low + high) / 2, low, high, sequences, sequences, 0, 0, 0).is_real == is_real


def test_the_pairing_finds_what_the_means_alone_do_not_show() -> None:
    rng = np.random.default_rng(4)
    level = rng.uniform(0.1, 0.9, 30)
    a = {f"s{index}": [value + 0.02 + rng.normal(0, 0.01)] for index, value in enumerate(level)}
    b = {f"s{index}": [value] for index, value in enumerate(level)}
    apart = [bootstrap_mean(np.array([value for (value,) in side.values()])) for side in (a, b)]
    assert apart[1].high > apart[0].low
    assert paired_difference(records_of(a), records_of(b), value_of).is_real


def test_where_there_is_no_difference_it_is_seldom_called_real() -> None:
    rng = np.random.default_rng(6)
    called = 0
    for _ in range(200):
        a, b = ({f"s{index}": [value] for index, value in enumerate(rng.normal(0, 1, 20))} for _ in range(2))
        called += paired_difference(records_of(a), records_of(b), value_of).is_real
    assert called / 200 < 0.1
