"""Engaging by a command to the onboard computer."""

import math
from io import BytesIO
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.config import GroundConfig
from companion.ground_command import GroundCommands
from companion.modes import Mode
from companion.types import Disengage, Engage, OperatorCommand
from companion.wire import Wire

VEHICLE = 7
NUMBER = 31012
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4


def command(
    first: float = 1.0,
    number: int = NUMBER,
    confirmation: int = 0,
    component: int = 191,
    *,
    system: int = VEHICLE,
    second: float = 0.0,
) -> Any:
    return mavlink.MAVLink_command_long_message(system, component, number, confirmation, first, second, *[0.0] * 5)


class Station:
    """A ground station, and the commands' end on the vehicle."""

    def __init__(self, config: GroundConfig | None = None) -> None:
        self._wire = Wire(VEHICLE)
        self._commands = GroundCommands(self._wire.sender(191), config or GroundConfig(engage_command=NUMBER))
        self._in = mavlink.MAVLink(BytesIO())
        self._now_s = 10.0

    def send(self, *messages: Any, mode: Mode = Mode.TRACKING, system: int = 255) -> tuple[OperatorCommand, ...]:
        """The orders in these messages; `mode` comes of them."""
        self._now_s += 0.05
        station = mavlink.MAVLink(BytesIO(), srcSystem=system, srcComponent=190)
        data = b"".join(bytes(message.pack(station)) for message in messages)
        orders = self._commands.receive(self._wire.receive(data), self._now_s)
        self._commands.after(mode)
        return orders

    def results(self) -> list[int]:
        return [m.result for m in self._in.parse_buffer(b"".join(self._wire.drain())) or []]


@pytest.mark.parametrize("mode", Mode)
def test_engaging_is_answered_by_what_has_come_of_it(mode: Mode) -> None:
    station = Station()
    assert station.send(command(), mode=mode) == (Engage(),)
    # while holding or waiting for a confirmation the target is not followed: to engage was refused there
    expected = {Mode.FOLLOWING: ACCEPTED, Mode.COASTING: ACCEPTED, Mode.READY: REJECTED}.get(mode, FAILED)
    assert station.results() == [expected]


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("system", [255, 254, VEHICLE])
def test_disengaging_is_accepted_from_everybody(mode: Mode, system: int) -> None:
    station = Station()
    assert station.send(command(0), mode=mode, system=system) == (Disengage(),)
    assert station.results() == [ACCEPTED]


@pytest.mark.parametrize("system", [254, 1, VEHICLE])
def test_who_is_not_named_may_not_engage(system: int) -> None:
    station = Station()
    assert station.send(command(), system=system) == ()
    assert station.results() == [DENIED]


@pytest.mark.parametrize("value", [2.0, -1.0, 0.5, math.nan, math.inf])
def test_any_other_parameter_is_denied(value: float) -> None:
    station = Station()
    assert station.send(command(value)) == ()
    assert station.results() == [DENIED]


@pytest.mark.parametrize("number", [0, 31010, 31011, 31013, 400, 512, 2005])
def test_any_other_command_is_unsupported(number: int) -> None:
    station = Station()
    assert station.send(command(number=number)) == ()
    assert station.results() == [UNSUPPORTED]


@pytest.mark.parametrize("number", [0, 31010, 31012])
def test_where_no_command_is_configured_none_engages(number: int) -> None:
    station = Station(GroundConfig())
    assert station.send(command(number=number)) == ()
    assert station.send(command(0, number=number)) == ()
    assert station.results() == [UNSUPPORTED] * 2


def test_what_is_for_all_components_is_passed_over_where_it_is_not_known() -> None:
    station = Station()
    assert station.send(command(number=512, component=0)) == ()
    assert station.results() == []


def test_a_retry_engages_once_and_is_answered_as_before() -> None:
    station = Station()
    assert station.send(command(), mode=Mode.FOLLOWING) == (Engage(),)
    assert station.send(command(confirmation=1), mode=Mode.LOST) == ()
    assert station.results() == [ACCEPTED, ACCEPTED]


def test_engaging_again_after_ready_is_a_new_order_where_it_is_told_from_a_retry() -> None:
    station = Station()
    assert station.send(command(), mode=Mode.READY) == (Engage(),)
    assert station.send(command(), mode=Mode.READY) == ()
    assert station.send(command(second=1), mode=Mode.FOLLOWING) == (Engage(),)
    assert station.results() == [REJECTED, REJECTED, ACCEPTED]


@pytest.mark.parametrize(("system", "component"), [(0, 0), (0, 191), (VEHICLE, 0)])
def test_an_order_to_all_engages_nobody(system: int, component: int) -> None:
    station = Station()
    assert station.send(command(component=component, system=system)) == ()
    assert station.results() == [DENIED]


def test_orders_keep_their_order() -> None:
    station = Station()
    assert station.send(command(), command(0), mode=Mode.LEAVING) == (Engage(), Disengage())
    assert sorted(station.results()) == [ACCEPTED, FAILED]
