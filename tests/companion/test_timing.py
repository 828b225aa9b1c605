import pytest

from companion.timing import WINDOW, Timing


def test_an_empty_record_has_counts_only() -> None:
    assert Timing().summary() == {"overruns": 0, "step_late_count": 0, "capture_to_setpoint_count": 0}


def test_median_and_99th_percentile_are_in_ms() -> None:
    timing = Timing()
    for index in range(1000):
        timing.add_step(0.001)
        timing.add_setpoint(0.030 if index < 980 else 0.090)
    summary = timing.summary()
    assert summary["step_late_median_ms"] == pytest.approx(1.0)
    assert summary["capture_to_setpoint_median_ms"] == pytest.approx(30.0)
    assert summary["capture_to_setpoint_p99_ms"] == pytest.approx(90.0)


def test_only_the_last_ten_minutes_are_kept() -> None:
    timing = Timing()
    for _ in range(WINDOW):
        timing.add_step(1.0)
    for _ in range(WINDOW):
        timing.add_step(0.0)
    assert timing.summary()["step_late_p99_ms"] == 0.0
    assert timing.summary()["step_late_count"] == WINDOW
