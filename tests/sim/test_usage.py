import os

import pytest

from sim.usage import Usage


def test_a_process_that_works_takes_time_and_memory() -> None:
    usage = Usage()
    usage.read(os.getpid(), 0.0)
    ballast = bytearray(b"x" * 50_000_000)
    while len(usage.readings) < 2 or usage.readings[-1][1] - usage.readings[0][1] < 0.1:
        usage.readings[1:] = []
        sum(range(100_000))
        usage.read(os.getpid(), 10.0)
    figures = usage.figures()
    assert figures["application_cpu_percent_of_a_core"] >= 1.0
    assert figures["application_memory_peak_mb"] - usage.readings[0][2] > 0.8 * len(ballast) / 2**20


def test_memory_is_compared_from_when_the_process_has_settled() -> None:
    usage = Usage([(0.0, 1.0, 40.0), (60.0, 13.0, 150.0), (600.0, 121.0, 151.0)])
    assert usage.figures() == {
        "application_cpu_percent_of_a_core": 20.0,
        "application_memory_at_60_s_mb": 150.0,
        "application_memory_at_the_end_mb": 151.0,
        "application_memory_peak_mb": 151.0,
    }


@pytest.mark.parametrize("pid", [2**22 + 1, -5])
def test_a_process_that_is_not_there_gives_no_figures(pid: int) -> None:
    usage = Usage()
    usage.read(pid, 0.0)
    usage.read(pid, 1.0)
    assert usage.figures() == {}
