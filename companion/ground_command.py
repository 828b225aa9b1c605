"""Engaging from the ground by a command: MAV_CMD_USER_n to the onboard computer, where it is configured.

Parameter 1 is 1 to engage and 0 to disengage. Parameter 2 is free: the same command again within seconds is taken for
a retry, whatever came of it, and a script that means it anew counts it up. Engaging is acknowledged by what has come of
it in the same step of the loop: ACCEPTED while following, TEMPORARILY_REJECTED where PX4 first has to be in OFFBOARD
(engage again then), FAILED where it is refused; the status text says why. Disengaging is always accepted, from
everybody: it can only make the vehicle stand.
"""

from collections.abc import Iterable
from typing import Any

from companion.command_protocol import Command, CommandProtocol, Result
from companion.config import GroundConfig
from companion.modes import Mode
from companion.types import Disengage, Engage, OperatorCommand

_ORDERS: dict[int | None, OperatorCommand] = {0: Disengage(), 1: Engage()}


class GroundCommands:
    """The onboard computer's side of MAVLink's command protocol.

    Parameters
    ----------
    sender : of the onboard computer, `Wire.sender`.
    """

    def __init__(self, sender: Any, config: GroundConfig) -> None:
        self._protocol = CommandProtocol(sender, once=frozenset({config.engage_command} - {0}))
        self._config = config
        self._engaging: list[Command] = []  # to be acknowledged after the step

    def receive(self, messages: Iterable[Any], now_s: float) -> tuple[OperatorCommand, ...]:
        """Orders in messages that have arrived; whatever else is asked of us is answered at once."""
        orders: list[OperatorCommand] = []
        for message in messages:
            command = self._protocol.take(message, now_s)
            if command is None:
                continue
            # 0 is no command, but somebody may send it
            if not self._config.engage_command or command.number != self._config.engage_command:
                self._protocol.answer(command, Result.UNSUPPORTED)
                continue
            order = _ORDERS.get(command.whole(0))
            is_engaging = isinstance(order, Engage)
            # one for all would engage every vehicle in reach
            may_engage = command.sender[0] in self._config.system_ids and not command.is_broadcast
            if order is None or (is_engaging and not may_engage):
                self._protocol.answer(command, Result.DENIED)
                continue
            if is_engaging:
                self._engaging.append(command)
            else:
                self._protocol.answer(command, Result.ACCEPTED)
            orders.append(order)
        return tuple(orders)

    def after(self, mode: Mode) -> None:
        """Acknowledge what was asked in this step, now that its mode is known."""
        if mode in {Mode.FOLLOWING, Mode.COASTING}:  # not where a target that is lost still waits to be confirmed
            result = Result.ACCEPTED
        else:
            result = Result.TEMPORARILY_REJECTED if mode is Mode.READY else Result.FAILED
        for command in self._engaging:
            self._protocol.answer(command, result)
        self._engaging.clear()
