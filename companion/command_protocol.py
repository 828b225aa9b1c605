"""MAVLink's command protocol, as one of our components takes part in it: which commands are for it, and its answers.

A command comes as COMMAND_LONG or COMMAND_INT and is answered with COMMAND_ACK to who sent it. One whose answer was
lost comes again, with a higher `confirmation`: it is acknowledged again, not executed again. One that comes again while
its answer is still awaited is answered once, at the end. Source: "Command Protocol" of the MAVLink developer guide.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

# within which the same command of the same sender, with a confirmation above 0, is a retry: QGroundControl waits 3 s
RETRY_S = 4.0
_MOST_KNOWN = 32  # commands that are remembered


class Result(IntEnum):
    """Answers, as MAV_RESULT."""

    ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
    TEMPORARILY_REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED  # not now
    DENIED = mavlink.MAV_RESULT_DENIED  # bad values, or not allowed
    UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
    FAILED = mavlink.MAV_RESULT_FAILED


@dataclass(frozen=True, slots=True)
class Command:
    """A command for us, once.

    params : seven, as sent; of COMMAND_INT the fifth and the sixth are its whole numbers.
    sender : system and component.
    is_broadcast : whether it was for every component: those who do not know it are silent then.
    """

    number: int
    params: tuple[float, ...]
    sender: tuple[int, int]
    is_broadcast: bool
    time_s: float

    def whole(self, index: int) -> int | None:
        """Parameter `index`, from 0, where it is a whole number."""
        value = self.params[index]
        return int(value) if math.isfinite(value) and value == int(value) else None


@dataclass(slots=True)
class _Known:
    command: Command
    result: Result | None  # None: not answered yet
    heard_s: float  # the last time


class CommandProtocol:
    """Takes a component's commands out of the messages, and answers them.

    Parameters
    ----------
    sender : of the component, `Wire.sender`.
    unrepeated : numbers of commands of which nobody gives the same one twice in a row on purpose, such as a box
        that is drawn: the same again is a retry, whatever its `confirmation`.
    """

    def __init__(self, sender: Any, unrepeated: frozenset[int] = frozenset()) -> None:
        self._mav = sender
        self._unrepeated = unrepeated
        self._known: deque[_Known] = deque(maxlen=_MOST_KNOWN)

    def take(self, message: Any, now_s: float) -> Command | None:
        """The command in a message, to be answered by `answer` now or later; None: it is none, or not new."""
        kind = message.get_type()
        if kind not in {"COMMAND_LONG", "COMMAND_INT"} or not self._is_ours(message):
            return None
        names = ("param5", "param6", "param7") if kind == "COMMAND_LONG" else ("x", "y", "z")
        params = tuple(float(getattr(message, name)) for name in ("param1", "param2", "param3", "param4", *names))
        command = Command(
            message.command,
            params,
            (message.get_srcSystem(), message.get_srcComponent()),
            message.target_component == 0,
            now_s,
        )
        known = self._same(command)
        if known is not None and known.result is None:
            known.heard_s = now_s
            return None
        # COMMAND_INT has no such field: its retries look like new commands
        is_retry = kind == "COMMAND_LONG" and message.confirmation > 0
        # MAVSDK and old ground stations leave it at 0
        is_retry |= known is not None and known.result is Result.ACCEPTED and self._is_last_of_unrepeated(known)
        if known is not None and known.result is not None and is_retry:
            known.heard_s = now_s
            self._acknowledge(known.command, known.result)
            return None
        self._known.append(_Known(command, None, now_s))
        return command

    def answer(self, command: Command, result: Result) -> None:
        """Acknowledge a command; one for every component that we do not know is left to those who do."""
        if result is Result.UNSUPPORTED and command.is_broadcast:
            return
        for known in self._known:
            if known.command is command:
                known.result = result
        self._acknowledge(command, result)

    def _acknowledge(self, command: Command, result: Result) -> None:
        self._mav.command_ack_send(
            command.number, int(result), target_system=command.sender[0], target_component=command.sender[1]
        )

    def _is_ours(self, message: Any) -> bool:
        is_system = message.target_system in {0, self._mav.srcSystem}
        return is_system and message.target_component in {0, self._mav.srcComponent}

    def _is_last_of_unrepeated(self, known: _Known) -> bool:
        last = [
            other
            for other in self._known
            if other.command.sender == known.command.sender and other.command.number in self._unrepeated
        ]
        return bool(last) and last[-1] is known

    def _same(self, command: Command) -> _Known | None:
        """The last command of that number and sender, where this is the same one, and it is not long ago.

        The last one: what was ordered before another order is not in force any more, and to repeat it is a new order.
        """
        for known in reversed(self._known):
            if (known.command.number, known.command.sender) == (command.number, command.sender):
                # as text: NaN is like NaN
                is_same = repr(known.command.params) == repr(command.params)
                return known if is_same and command.time_s - known.heard_s <= RETRY_S else None
        return None
