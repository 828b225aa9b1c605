"""The autopilot's clock in ours, by construction: two clocks, and ways there and back, all of them known."""

import random
from collections.abc import Callable

import pytest

from companion.time_sync import MAX_ANSWER_AGE_S, MIN_ANSWERS, BootClock

AHEAD_S = 95.25  # of our clock
LOOP_S = 0.05
WAY_S = 0.008  # of those messages and questions that take no loop


class Link:
    """An autopilot that sends 50 messages a second, and answers; we read what has come every 50 ms."""

    def __init__(self, there_s: float, back_s: float, answer: Callable[[float], float] = lambda boot_s: boot_s) -> None:
        self.clock = BootClock()
        self.errors_s: list[float] = []  # of our time for each message
        self._there_s, self._back_s, self._answer = there_s, back_s, answer
        self._under_way: list[tuple[float, int, int]] = []  # answers: arrival, tc1, ts1
        self._step = 0
        self._noise = random.Random(5)  # noqa: S311

    def run(self, duration_s: float, *, is_asking: bool = True) -> float:
        """Let time pass; the error of the last message's time."""
        for _ in range(round(duration_s / LOOP_S)):
            begin_s = 100.0 + LOOP_S * self._step
            self._step += 1
            now_s = begin_s + LOOP_S
            for _ in range(3):
                made_s = begin_s + self._noise.uniform(0.0, LOOP_S) - self._back_s
                boot_ms = int((made_s - AHEAD_S) * 1000)
                self.errors_s.append(self.clock.ours_s(boot_ms / 1000, now_s) - made_s)
            for arrival_s, tc1_ns, ts1_ns in [a for a in self._under_way if a[0] <= now_s]:
                self.clock.hear(tc1_ns, ts1_ns, now_s)
                self._under_way = [a for a in self._under_way if a[0] > arrival_s]
            if is_asking and self._step % 20 == 0:
                ts1_ns = self.clock.ask(now_s)
                boot_s = now_s + self._there_s - AHEAD_S
                arrival_s = now_s + self._there_s + self._back_s
                self._under_way.append((arrival_s, round(self._answer(boot_s) * 1e9), ts1_ns))
        return self.errors_s[-1]


def error_s(link: Link, duration_s: float = 30.0, *, is_asking: bool = True) -> float:
    """The worst error of the last second."""
    link.run(duration_s, is_asking=is_asking)
    return max(map(abs, link.errors_s[-60:]))


@pytest.mark.parametrize("delay_s", [0.0, 0.004, 0.0075, 0.009])
def test_a_delay_that_is_the_same_both_ways_is_taken_off_though_the_loop_reads_every_50_ms(delay_s: float) -> None:
    without_s, with_s = error_s(Link(delay_s, delay_s), is_asking=False), error_s(Link(delay_s, delay_s))
    assert without_s == pytest.approx(delay_s, abs=0.002)
    assert with_s < 0.002


def test_the_error_of_the_bearing_falls_below_a_tenth_of_a_degree_at_45_degrees_a_second() -> None:
    """With 15 ms there and back."""
    without_deg = 45 * error_s(Link(0.0075, 0.0075), is_asking=False)
    with_deg = 45 * error_s(Link(0.0075, 0.0075))
    assert without_deg > 0.3
    assert with_deg < 0.1


@pytest.mark.parametrize(("there_s", "back_s"), [(0.0, 0.015), (0.015, 0.0), (0.004, 0.012)])
def test_with_ways_that_differ_the_error_is_at_most_half_the_round_trip(there_s: float, back_s: float) -> None:
    assert error_s(Link(there_s, back_s)) <= (there_s + back_s) / 2 + 0.002


@pytest.mark.parametrize(("there_s", "back_s"), [(0.015, 0.015), (0.025, 0.0), (0.0, 0.025)])
def test_a_round_trip_of_more_than_20_ms_counts_for_nothing(there_s: float, back_s: float) -> None:
    assert error_s(Link(there_s, back_s)) == error_s(Link(there_s, back_s), is_asking=False)


@pytest.mark.parametrize(
    "answer",
    [
        lambda boot_s: boot_s + 1.7e9,  # Unix time
        lambda boot_s: boot_s / 1000,  # microseconds that are called nanoseconds
        lambda boot_s: boot_s + 0.05,  # it heard before we asked
        lambda boot_s: boot_s - 0.05,
        lambda _: -1.0,
    ],
    ids=["unix", "microseconds", "early", "late", "negative"],
)
def test_an_answer_that_contradicts_the_smallest_delay_is_not_believed(answer: Callable[[float], float]) -> None:
    assert error_s(Link(0.005, 0.005, answer)) == error_s(Link(0.005, 0.005), is_asking=False)


def answered(*ways_s: float) -> BootClock:
    """A clock with questions that took so long to be heard."""
    clock = BootClock()
    clock.ours_s(4.75 - WAY_S, 100.0)
    for k, way_s in enumerate(ways_s):
        clock.hear(round((100.0 + k + way_s - AHEAD_S) * 1e9), clock.ask(100.0 + k), 100.3 + k)
    return clock


@pytest.mark.parametrize("odd_s", [-WAY_S, 0.011])
def test_a_few_odd_answers_move_nothing(odd_s: float) -> None:
    plain, odd = answered(*[WAY_S] * 9), answered(*[WAY_S] * 6, *[odd_s] * 3)
    assert moved_s(odd, 109.0) == pytest.approx(moved_s(plain, 109.0), abs=1e-6)


def test_slow_answers_do_not_outvote_those_that_were_quick() -> None:
    clock = answered(*[WAY_S] * 3, *[0.2] * 6)
    assert moved_s(clock, 109.0) == pytest.approx(WAY_S, abs=1e-3)


def test_an_answer_that_is_early_by_the_rounding_of_time_boot_ms_counts_and_puts_nothing_into_the_future() -> None:
    early = answered(*[-WAY_S - 0.001] * 5, *[0.0] * 3)
    assert early.ours_s(9.75 - WAY_S, 105.0) == pytest.approx(105.0, abs=1e-9)


def synced() -> BootClock:
    return answered(*[WAY_S] * MIN_ANSWERS)


def moved_s(clock: BootClock, now_s: float = 103.0) -> float:
    """How far before its arrival a message is put that came as fast as any."""
    return now_s - clock.ours_s(now_s - WAY_S - AHEAD_S, now_s)


def test_the_first_answers_are_waited_for() -> None:
    assert moved_s(synced()) == pytest.approx(WAY_S, abs=1e-3)
    assert moved_s(answered(*[WAY_S] * (MIN_ANSWERS - 1))) == 0.0


def test_only_the_answer_to_the_question_that_was_asked_last_counts_and_it_counts_once() -> None:
    clock = BootClock()
    clock.ours_s(4.75 - WAY_S, 100.0)
    for _ in range(5):
        clock.hear(round((100.0 + WAY_S - AHEAD_S) * 1e9), round(100.0 * 1e9), 100.05)  # nobody asked
    first_ns, second_ns = clock.ask(100.0), clock.ask(101.0)
    for _ in range(5):
        clock.hear(round((100.0 + WAY_S - AHEAD_S) * 1e9), first_ns, 101.05)
    for _ in range(5):
        clock.hear(round((101.0 + WAY_S - AHEAD_S) * 1e9), second_ns, 101.05)
    assert moved_s(clock) == 0.0


def test_answers_are_forgotten_on_a_reboot_and_when_no_more_come() -> None:
    clock = synced()
    clock.reset()
    assert moved_s(clock) == 0.0
    clock = synced()
    late_s = 103.0 + MAX_ANSWER_AGE_S
    clock.ours_s(late_s - WAY_S - AHEAD_S, late_s)
    assert moved_s(clock, late_s) == 0.0


def test_a_question_of_before_a_reboot_is_not_answered_after_it() -> None:
    clock = synced()
    ts1_ns = clock.ask(103.0)
    clock.reset()
    clock.ours_s(0.1, 104.0)
    for _ in range(MIN_ANSWERS):
        clock.hear(round(0.09 * 1e9), ts1_ns, 104.0)
    assert 105.0 - clock.ours_s(1.1, 105.0) == pytest.approx(0.0, abs=1e-9)


def test_no_message_is_ever_put_after_its_arrival() -> None:
    clock, noise = synced(), random.Random(7)  # noqa: S311
    for k in range(1000):
        now_s = 103.0 + k / 100
        assert clock.ours_s(now_s - AHEAD_S - noise.uniform(0.0, 0.3), now_s) <= now_s
