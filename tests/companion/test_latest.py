import threading

from companion.latest import Latest


def test_the_newest_value_wins_and_what_came_between_is_counted() -> None:
    latest: Latest[int] = Latest()
    for value in (1, 2, 3):
        latest.put(value)
    assert latest.take(0.0) == 3
    assert latest.dropped == 2


def test_a_value_is_taken_once_but_can_be_looked_at_again() -> None:
    latest: Latest[str] = Latest()
    latest.put("frame")
    assert latest.take(0.0) == "frame"
    assert latest.take(0.0) is None
    assert latest.value == "frame"
    assert latest.dropped == 0


def test_before_the_first_value_there_is_none() -> None:
    latest: Latest[int] = Latest()
    assert latest.value is None
    assert latest.take(0.0) is None


def test_who_waits_is_woken_by_the_next_value() -> None:
    latest: Latest[int] = Latest()
    taken: list[int | None] = []
    reader = threading.Thread(target=lambda: taken.append(latest.take(10.0)))
    reader.start()
    latest.put(7)
    reader.join(10.0)
    assert taken == [7]


def test_who_puts_never_waits_for_who_takes() -> None:
    latest: Latest[int] = Latest()
    for value in range(1000):
        latest.put(value)
    assert latest.value == 999
