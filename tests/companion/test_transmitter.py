from collections.abc import Sequence

import pytest

from companion.config import RcConfig
from companion.transmitter import RcSwitch, StickGuard
from companion.types import Deselect, Disengage, Engage, OperatorCommand, RcChannels, Select

CENTRED = (1500, 1500, 1100, 1500, 1500)  # roll, pitch, throttle, yaw, switch
OFF, MIDDLE, ON, LOST = 1100, 1500, 1900, 0


def sticks(rows: Sequence[tuple[float, tuple[int, ...] | None]], config: RcConfig | None = None) -> list[bool]:
    """Whether the guard is held after each of (time, pulse widths)."""
    guard, held = StickGuard(), []
    for time_s, pwm_us in rows:
        rc = RcChannels(time_s, pwm_us) if pwm_us is not None else None
        guard = guard.after(rc, config or RcConfig(), time_s)
        held.append(guard.is_held)
    return held


def away(us: int, channel: int = 1) -> tuple[int, ...]:
    return (*CENTRED[: channel - 1], us, *CENTRED[channel:])


# ------------------------------------------------------------------------------------------- sticks
@pytest.mark.parametrize("channel", [1, 2, 4])
@pytest.mark.parametrize("us", [1000, 1379, 1621, 2000])
def test_a_stick_away_from_its_centre_for_so_long_is_held(channel: int, us: int) -> None:
    rows = [(time_s, away(us, channel)) for time_s in (1.0, 1.1, 1.19, 1.2, 1.3)]
    assert sticks([(0.0, CENTRED), *rows]) == [False, False, False, False, True, True]


@pytest.mark.parametrize(
    "pwm_us",
    [
        CENTRED,
        away(1380),
        away(1620),
        away(1900, 3),  # throttle rests anywhere
        away(1900, 5),
        away(0),  # no signal on this channel
        away(800),
        (),
        (1500,),
        None,
    ],
)
def test_centred_sticks_throttle_and_channels_without_a_signal_are_not_held(pwm_us: tuple[int, ...] | None) -> None:
    assert sticks([(0.1 * k, pwm_us) for k in range(10)]) == [False] * 10


def test_a_stick_that_returns_begins_anew() -> None:
    rows = [(0.0, away(1800)), (0.15, away(1800)), (0.2, CENTRED), (0.25, away(1800)), (0.4, away(1800))]
    assert sticks(rows) == [False] * 5
    assert sticks([*rows, (0.45, away(1800)), (0.5, CENTRED)]) == [False] * 5 + [True, False]


def test_from_one_stick_to_another_the_time_runs_on() -> None:
    rows = [(0.0, away(1800, 1)), (0.1, away(1200, 2)), (0.2, away(1800, 4))]
    assert sticks(rows) == [False, False, True]


def test_a_receiver_that_is_lost_lets_go() -> None:
    assert sticks([(0.0, away(1800)), (0.3, away(1800)), (0.35, None), (0.4, away(1800))]) == [
        False,
        True,
        False,
        False,
    ]


def test_a_receiver_that_falls_silent_with_a_stick_held_keeps_it_held() -> None:
    guard, last = StickGuard(), RcChannels(0.0, away(1800))
    for time_s in (0.0, 0.1, 0.2, 5.0):
        guard = guard.after(last, RcConfig(), time_s)
    assert guard.is_held


def test_the_channels_and_the_deviation_are_those_of_the_configuration() -> None:
    config = RcConfig(roll_channel=5, pitch_channel=6, yaw_channel=3, stick_guard_us=300)
    for pwm_us, is_held in (
        ((2000, 2000, 1500, 2000, 1500, 1500), False),
        ((1500, 1500, 1801, 1500, 1500, 1500), True),
        ((1500, 1500, 1500, 1500, 1199, 1500), True),
        ((1500, 1500, 1500, 1500, 1500, 1801), True),
        ((1500, 1500, 1800, 1500, 1200, 1800), False),
    ):
        assert sticks([(0.0, pwm_us), (0.2, pwm_us)], config)[-1] is is_held


# ------------------------------------------------------------------------------------------- the switch
def orders(rows: list[tuple[float, int]], channel: int = 5) -> list[tuple[float, OperatorCommand]]:
    """Orders and their times, of (time, pulse width of the switch)."""
    switch, given = RcSwitch(), []
    for time_s, us in rows:
        rc = RcChannels(time_s, (*CENTRED[:4], us))
        switch = switch.after(rc, RcConfig(switch_channel=channel), time_s)
        given += [(round(time_s, 3), command) for command in switch.commands]
    return given


def held(us: int, start_s: float, end_s: float) -> list[tuple[float, int]]:
    """A position at the 10 Hz of RC_CHANNELS."""
    return [(0.1 * k, us) for k in range(round(start_s * 10), round(end_s * 10))]


@pytest.mark.parametrize("us", [OFF, MIDDLE, ON])
def test_where_the_switch_rests_at_the_start_means_nothing(us: int) -> None:
    assert orders(held(us, 0, 3)) == []


@pytest.mark.parametrize(
    ("before", "after", "commands"),
    [
        (OFF, MIDDLE, [Select(None)]),
        (OFF, ON, [Engage()]),
        (MIDDLE, ON, [Engage()]),
        (ON, MIDDLE, [Disengage()]),
        (ON, OFF, [Disengage(), Deselect()]),
        (MIDDLE, OFF, [Disengage(), Deselect()]),
    ],
)
def test_a_movement_is_an_order_once_it_has_rested(before: int, after: int, commands: list[OperatorCommand]) -> None:
    given = orders(held(before, 0, 1) + held(after, 1, 3))
    assert [command for _, command in given] == commands
    assert {time_s for time_s, _ in given} == {1.2}


def test_a_flick_through_the_middle_selects_nothing() -> None:
    assert orders(held(OFF, 0, 1) + held(MIDDLE, 1, 1.2) + held(ON, 1.2, 2)) == [(1.4, Engage())]
    assert orders(held(ON, 0, 1) + held(MIDDLE, 1, 1.2) + held(OFF, 1.2, 2)) == [
        (1.4, Disengage()),
        (1.4, Deselect()),
    ]


def test_a_switch_that_chatters_orders_nothing_until_it_rests() -> None:
    chatter = [(1 + 0.1 * k, MIDDLE if k % 2 else ON) for k in range(10)]
    assert orders(held(MIDDLE, 0, 1) + chatter) == []
    assert orders(held(MIDDLE, 0, 1) + chatter + held(ON, 2, 3)) == [(2.2, Engage())]


def test_a_movement_that_is_taken_back_in_time_is_none() -> None:
    assert orders(held(OFF, 0, 1) + held(ON, 1, 1.2) + held(OFF, 1.2, 3)) == []


def test_a_signal_that_is_lost_is_no_movement() -> None:
    assert orders(held(ON, 0, 1) + held(LOST, 1, 2) + held(ON, 2, 3)) == []
    assert orders(held(MIDDLE, 0, 1) + held(ON, 1, 1.2) + held(800, 1.2, 1.3) + held(ON, 1.3, 1.5)) == []


def test_a_switch_that_was_moved_while_its_signal_was_lost_has_moved() -> None:
    given = orders(held(ON, 0, 1) + held(LOST, 1, 2) + held(OFF, 2, 3))
    assert given == [(2.2, Disengage()), (2.2, Deselect())]


@pytest.mark.parametrize(("rest_s", "counts"), [(0.15, False), (0.2, True)])
def test_a_position_counts_when_it_has_rested_for_so_long(rest_s: float, counts: bool) -> None:  # noqa: FBT001
    assert bool(orders([*held(OFF, 0, 1), (1.0, ON), (1.0 + rest_s, ON)])) is counts


def test_before_a_signal_there_is_no_position_to_move_from() -> None:
    assert orders(held(LOST, 0, 1) + held(ON, 1, 3)) == []


def test_an_order_is_given_once() -> None:
    assert len(orders(held(OFF, 0, 1) + held(MIDDLE, 1, 10))) == 1


@pytest.mark.parametrize("channel", [0, 6, 18])
def test_without_a_switch_or_its_channel_there_are_no_orders(channel: int) -> None:
    assert orders(held(OFF, 0, 1) + held(ON, 1, 3), channel) == []


@pytest.mark.parametrize(
    ("us", "commands"), [(1299, []), (1300, [Select(None)]), (1700, [Select(None)]), (1701, [Engage()])]
)
def test_the_positions_begin_at_these_pulse_widths(us: int, commands: list[OperatorCommand]) -> None:
    assert [command for _, command in orders(held(OFF, 0, 1) + held(us, 1, 2))] == commands


def test_without_a_receiver_there_are_no_orders() -> None:
    config = RcConfig(switch_channel=5)
    switch = RcSwitch().after(None, config, 0.0).after(None, config, 1.0)
    assert (switch.position, switch.commands) == (None, ())


# ------------------------------------------------------------------------------- a switch that only engages
@pytest.mark.parametrize(
    ("before", "after", "commands"),
    [
        (OFF, MIDDLE, []),
        (OFF, ON, [Engage()]),
        (MIDDLE, ON, [Engage()]),
        (ON, MIDDLE, [Disengage()]),
        (ON, OFF, [Disengage()]),
        (MIDDLE, OFF, []),
    ],
)
def test_a_switch_that_only_engages_leaves_the_target_to_the_ground_station(
    before: int, after: int, commands: list[OperatorCommand]
) -> None:
    switch, given, config = RcSwitch(), [], RcConfig(switch_channel=5, switch="engage")
    for time_s, us in held(before, 0, 1) + held(after, 1, 3):
        switch = switch.after(RcChannels(time_s, (*CENTRED[:4], us)), config, time_s)
        given += switch.commands
    assert given == commands
    assert switch.is_on is (after == ON)
