"""Every scenario with both autopilots, with true boxes in place of the tracker's: control, modes and failsafes."""

import math
from dataclasses import replace

import pytest

from sim.eyes import RenderedEyes, TrueEyes
from sim.scenarios import AUTOPILOTS, DEMO, SCENARIOS, Check, fly
from sim.trace import Trace


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_passes_its_checks(name: str, autopilot: str) -> None:
    _, verdicts = fly(SCENARIOS[name], autopilot, TrueEyes)
    assert [f"{v.name}: {v.measured}, wanted {v.wanted}" for v in verdicts if not v.is_passed] == []


def test_the_same_flight_is_the_same_to_the_bit() -> None:
    first, again = (fly(SCENARIOS["sticks"], "px4", TrueEyes, seed=3)[0] for _ in range(2))
    assert first == again


def test_a_flight_with_pictures_and_the_tracker_is_the_same_to_the_bit() -> None:
    short = replace(SCENARIOS["straight"], duration_s=5.0)
    first, again = (fly(short, "ardupilot", RenderedEyes, seed=3)[0] for _ in range(2))
    assert first == again
    assert first.moments[-1].mode == "following"
    assert (first.moments[-1].iou or 0.0) > 0.5


def test_the_demo_is_a_scenario() -> None:
    assert DEMO in SCENARIOS


@pytest.mark.parametrize(
    ("value", "is_passed"), [(0.99, False), (1.0, True), (2.0, True), (2.01, False), (math.nan, False)]
)
def test_a_check_passes_within_its_limits_only(value: float, is_passed: bool) -> None:  # noqa: FBT001 - a table
    verdict = Check("x", "m", lambda _: value, least=1, most=2).judge(Trace(()))
    assert verdict.is_passed is is_passed
    assert verdict.wanted == "at least 1 and at most 2 m"


def test_a_figure_is_never_rounded_to_the_other_side_of_a_limit() -> None:
    assert Check("x", "m", lambda _: 10.0004, most=10).judge(Trace(())).measured == "10.0004 m"
