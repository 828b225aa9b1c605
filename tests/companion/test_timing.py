import pytest

from companion.timing import WINDOW, Timing
from companion.types import TrackSample


def test_an_empty_record_has_counts_only() -> None:
    counts = dict.fromkeys(("step_late_count", "capture_to_box_count", "capture_to_setpoint_count"), 0)
    assert Timing().summary() == {"overruns": 0, **counts}


def test_median_and_99th_percentile_are_in_ms() -> None:
    timing = Timing()
    for index in range(1000):
        timing.add_step(0.001)
        timing.add_setpoint(0.030 if index < 980 else 0.090)
    summary = timing.summary()
    assert summary["step_late_median_ms"] == pytest.approx(1.0)
    assert summary["capture_to_setpoint_median_ms"] == pytest.approx(30.0)
    assert summary["capture_to_setpoint_p99_ms"] == pytest.approx(90.0)


def test_each_sample_of_the_tracker_counts_once() -> None:
    timing = Timing()
    timing.see(None)
    for seq in (0, 1, 1, 1, 2):
        timing.see(TrackSample(seq, 10.0, 10.0 + 0.02 * (seq + 1), (48, 64), 0))
    summary = timing.summary()
    assert summary["capture_to_box_count"] == 3
    assert summary["capture_to_box_median_ms"] == pytest.approx(40.0)


def test_only_the_last_ten_minutes_are_kept() -> None:
    timing = Timing()
    for _ in range(WINDOW):
        timing.add_step(1.0)
    for _ in range(WINDOW):
        timing.add_step(0.0)
    assert timing.summary()["step_late_p99_ms"] == 0.0
    assert timing.summary()["step_late_count"] == WINDOW
