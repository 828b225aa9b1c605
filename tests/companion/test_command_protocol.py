"""The command protocol between a component and ground stations of another pymavlink."""

import math
from io import BytesIO
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.command_protocol import MOST_AT_ONCE, RETRY_S, Command, CommandProtocol, Result
from companion.wire import Wire

VEHICLE, OURS = 7, 191
ENGAGE, BOX, STOP, ASK, ONCE = 31010, 2005, 2010, 512, 31011


def long(number: int = ENGAGE, *params: float, confirmation: int = 0, target: tuple[int, int] = (VEHICLE, OURS)) -> Any:
    return mavlink.MAVLink_command_long_message(*target, number, confirmation, *(*params, *[0.0] * 7)[:7])


def integer(number: int = ENGAGE, *params: float, target: tuple[int, int] = (VEHICLE, OURS)) -> Any:
    p = (*params, *[0.0] * 7)[:7]
    return mavlink.MAVLink_command_int_message(*target, 0, number, 0, 0, *p[:4], int(p[4]), int(p[5]), p[6])


class Ends:
    """A component's protocol, and who speaks to it."""

    def __init__(self) -> None:
        self.wire = Wire(VEHICLE)
        self.protocol = CommandProtocol(self.wire.sender(OURS), frozenset({BOX, STOP}), frozenset({ONCE}))
        self.now_s = 10.0
        self._stations: dict[tuple[int, int], Any] = {}
        self._in = mavlink.MAVLink(BytesIO())

    def take(self, message: Any, *, sender: tuple[int, int] = (255, 190), after_s: float = 0.1) -> Command | None:
        self.now_s += after_s
        station = self._stations.setdefault(
            sender, mavlink.MAVLink(BytesIO(), srcSystem=sender[0], srcComponent=sender[1])
        )
        (heard,) = self.wire.receive(bytes(message.pack(station)))
        return self.protocol.take(heard, self.now_s)

    def order(self, message: Any, result: Result = Result.ACCEPTED, **options: Any) -> bool:
        """Take and answer; whether there was something to be executed."""
        command = self.take(message, **options)
        if command is not None:
            self.protocol.answer(command, result)
        return command is not None

    def acks(self) -> list[tuple[int, int]]:
        return [(m.command, m.result) for m in self.sent()]

    def sent(self) -> list[Any]:
        return self._in.parse_buffer(b"".join(self.wire.drain())) or []


@pytest.mark.parametrize("target", [(VEHICLE, OURS), (0, OURS), (VEHICLE, 0), (0, 0)])
@pytest.mark.parametrize("message", [long, integer])
def test_a_command_for_us_is_taken(message: Any, target: tuple[int, int]) -> None:
    command = Ends().take(message(ENGAGE, 1, 2, 3, 4, 5, 6, 7, target=target), sender=(254, 25))
    assert command is not None
    assert (command.number, command.params, command.sender) == (ENGAGE, (1, 2, 3, 4, 5, 6, 7), (254, 25))
    assert command.is_broadcast is (0 in target)


@pytest.mark.parametrize("target", [(VEHICLE, 1), (VEHICLE, 100), (1, OURS), (8, 0), (255, 190)])
@pytest.mark.parametrize("message", [long, integer])
def test_a_command_for_somebody_else_is_not(message: Any, target: tuple[int, int]) -> None:
    ends = Ends()
    assert ends.take(message(target=target)) is None
    assert ends.sent() == []


def test_what_is_no_command_is_not_taken() -> None:
    ends = Ends()
    assert ends.take(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) is None
    assert ends.take(mavlink.MAVLink_command_ack_message(ENGAGE, 0, 0, 0, VEHICLE, OURS)) is None
    assert ends.sent() == []


@pytest.mark.parametrize("result", Result)
def test_the_answer_goes_to_who_asked(result: Result) -> None:
    ends = Ends()
    assert ends.order(long(), result, sender=(254, 25))
    (ack,) = ends.sent()
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (ENGAGE, int(result), 254, 25)
    assert (ack.get_srcSystem(), ack.get_srcComponent()) == (VEHICLE, OURS)


@pytest.mark.parametrize("result", Result)
def test_what_nobody_knows_is_left_to_others_where_it_was_for_all(result: Result) -> None:
    ends = Ends()
    ends.order(long(target=(VEHICLE, 0)), result)
    assert len(ends.sent()) == (result is not Result.UNSUPPORTED)


# ------------------------------------------------------------------------------------ retries
@pytest.mark.parametrize("result", Result)
def test_a_retry_is_acknowledged_again_and_not_executed_again(result: Result) -> None:
    ends = Ends()
    assert ends.order(long(ENGAGE, 1, math.nan), result)
    assert not ends.order(long(ENGAGE, 1, math.nan, confirmation=1), result)
    assert not ends.order(long(ENGAGE, 1, math.nan, confirmation=2), result)
    assert ends.acks() == [(ENGAGE, int(result))] * 3


def test_retries_that_go_on_are_retries_for_as_long_as_they_do() -> None:
    ends = Ends()
    ends.order(long())
    for count in range(1, 6):
        assert not ends.order(long(confirmation=count), after_s=3.0)
    assert len(ends.acks()) == 6


@pytest.mark.parametrize(
    ("again", "options"),
    [
        (long(ENGAGE, 1), {}),  # no retry: it does not say so
        (integer(ENGAGE, 1), {}),  # as above: it cannot say so
        (long(ENGAGE, 1, confirmation=1), {"after_s": RETRY_S + 0.1}),
        (long(ENGAGE, 0, confirmation=1), {}),
        (long(ENGAGE, 1, 1, confirmation=1), {}),
        (long(ENGAGE + 1, 1, confirmation=1), {}),
        (long(ENGAGE, 1, confirmation=1), {"sender": (254, 190)}),
        (long(ENGAGE, 1, confirmation=1), {"sender": (255, 191)}),
    ],
)
def test_what_is_no_retry_is_a_new_command(again: Any, options: dict[str, Any]) -> None:
    ends = Ends()
    assert ends.order(long(ENGAGE, 1))
    assert ends.order(again, **options)


def test_a_first_transmission_that_was_lost_is_no_loss() -> None:
    assert Ends().order(long(confirmation=1))


def test_a_retry_of_what_was_ordered_before_its_contrary_is_neither_done_nor_said_to_be_in_force() -> None:
    """Engage, disengage, and the retry of the first, late: whoever means it gives it anew."""
    ends = Ends()
    assert ends.order(long(ENGAGE, 1))
    assert ends.order(long(ENGAGE, 0))
    assert not ends.order(long(ENGAGE, 1, confirmation=1))
    assert ends.acks() == [(ENGAGE, 0), (ENGAGE, 0), (ENGAGE, Result.TEMPORARILY_REJECTED)]
    assert ends.order(long(ENGAGE, 1))


@pytest.mark.parametrize("result", Result)
def test_what_is_done_once_is_a_retry_whatever_came_of_it(result: Result) -> None:
    ends = Ends()
    assert ends.order(long(ONCE, 1), result)
    assert not ends.order(long(ONCE, 1))
    assert not ends.order(integer(ONCE, 1))
    assert ends.acks() == [(ONCE, result)] * 3
    assert ends.order(long(ONCE, 1, 2))


def test_what_is_forgotten_is_new_again() -> None:
    ends, box = Ends(), long(BOX, 0.1, 0.2, 0.3, 0.4)
    assert ends.order(box)
    assert ends.order(long(ASK, 275))
    ends.protocol.forget(frozenset({BOX}))
    assert ends.order(box)
    assert not ends.order(long(ASK, 275, confirmation=1))


def test_a_flood_of_commands_is_not_answered_by_a_flood() -> None:
    ends = Ends()
    taken = [ends.take(long(ASK, k), after_s=0.0) for k in range(1000)]
    assert [command is not None for command in taken] == [True] * MOST_AT_ONCE + [False] * (1000 - MOST_AT_ONCE)
    assert ends.take(long(ASK, 275)) is not None


@pytest.mark.parametrize("again", [long(), long(confirmation=1), integer()])
def test_what_comes_again_before_its_answer_is_answered_once(again: Any) -> None:
    ends = Ends()
    command = ends.take(long())
    assert command is not None
    assert ends.take(again) is None
    assert ends.sent() == []
    ends.protocol.answer(command, Result.FAILED)
    assert ends.acks() == [(ENGAGE, int(Result.FAILED))]


def test_the_oldest_commands_are_forgotten() -> None:
    ends = Ends()
    for number in range(500):
        ends.order(long(number), after_s=0.001)
    assert ends.order(long(0, confirmation=1), after_s=0.001)
    assert not ends.order(long(499, confirmation=1), after_s=0.001)


@pytest.mark.parametrize(
    ("value", "whole"), [(0.0, 0), (1.0, 1), (-1.0, -1), (0.5, None), (math.nan, None), (math.inf, None)]
)
def test_a_parameter_is_a_whole_number_or_none(value: float, whole: int | None) -> None:
    command = Ends().take(long(ENGAGE, value))
    assert command is not None
    assert command.whole(0) == whole


def test_the_same_box_again_is_a_retry_though_it_does_not_say_so() -> None:
    """MAVSDK leaves the confirmation at 0: what was drawn would be selected again where the target is no more."""
    ends, box = Ends(), long(BOX, 0.1, 0.2, 0.3, 0.4)
    assert ends.order(box)
    assert ends.order(long(ASK, 275))
    assert not ends.order(box, after_s=0.5)
    assert ends.acks() == [(BOX, 0), (ASK, 0), (BOX, 0)]


def test_the_same_box_is_a_new_one_after_another_or_a_stop_or_a_refusal_or_a_while() -> None:
    box = long(BOX, 0.1, 0.2, 0.3, 0.4)
    for between in (long(BOX, 0.5, 0.5, 0.6, 0.6), long(STOP)):
        ends = Ends()
        assert [ends.order(message) for message in (box, between, box)] == [True] * 3
    ends = Ends()
    assert ends.order(box, Result.TEMPORARILY_REJECTED)
    assert ends.order(box)
    assert ends.order(box, after_s=RETRY_S + 0.1)
    assert ends.order(box, sender=(254, 190))
