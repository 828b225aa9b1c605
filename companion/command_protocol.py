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
MOST_AT_ONCE = 16  # commands that are taken in one read; MAVSDK asks for five at a time, of each component
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
    once : numbers of commands of which the same again is a retry even after it was refused.
    """

    def __init__(
        self, sender: Any, unrepeated: frozenset[int] = frozenset(), once: frozenset[int] = frozenset()
    ) -> None:
        self._mav = sender
        self._once = once
        self._taken, self._taken_s = 0, -math.inf
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
            0 in {message.target_system, message.target_component},
            now_s,
        )
        # who asks so much at once must not keep the setpoints from leaving; what is left unanswered is asked again
        self._taken = self._taken + 1 if now_s == self._taken_s else 1
        self._taken_s = now_s
        if self._taken > MOST_AT_ONCE:
            return None
        # COMMAND_INT has no such field: its retries look like new commands
        is_retry = kind == "COMMAND_LONG" and message.confirmation > 0
        known = self._same(command)
        if known is None:
            if is_retry and self._is_outdated(command):
                # neither done again nor said to be in force; who means it gives it anew
                self._acknowledge(command, Result.TEMPORARILY_REJECTED)
                return None
        elif known.result is None or is_retry or self._is_unrepeated(known):
            known.heard_s = now_s
            if known.result is not None:
                self._acknowledge(known.command, known.result)
            return None
        self._known.append(_Known(command, None, now_s))
        return command

    def forget(self, numbers: frozenset[int]) -> None:
        """Commands that are not in force any more: the same again is a new one."""
        self._known = deque((known for known in self._known if known.command.number not in numbers), _MOST_KNOWN)

    def answer(self, command: Command, result: Result) -> None:
        """Acknowledge a command; one for every component that we do not know is left to those who do."""
        for known in self._known:
            if known.command is command:
                known.result = result
        if not (result is Result.UNSUPPORTED and command.is_broadcast):
            self._acknowledge(command, result)

    def _acknowledge(self, command: Command, result: Result) -> None:
        self._mav.command_ack_send(
            command.number, int(result), target_system=command.sender[0], target_component=command.sender[1]
        )

    def _is_ours(self, message: Any) -> bool:
        is_system = message.target_system in {0, self._mav.srcSystem}
        return is_system and message.target_component in {0, self._mav.srcComponent}

    def _is_unrepeated(self, known: _Known) -> bool:
        """Whether nobody gives it twice in a row; MAVSDK and old ground stations leave `confirmation` at 0."""
        if known.command.number in self._once:
            return True
        last = [
            other
            for other in self._known
            if other.command.sender == known.command.sender and other.command.number in self._unrepeated
        ]
        return known.result is Result.ACCEPTED and bool(last) and last[-1] is known

    def _same(self, command: Command) -> _Known | None:
        """The last command of that number and sender, where this is the same one, and it is not long ago."""
        for known in reversed(self._known):
            if (known.command.number, known.command.sender) == (command.number, command.sender):
                return known if self._is_recent(known, command) else None
        return None

    def _is_outdated(self, command: Command) -> bool:
        """Whether there was the same one, and another of that number after it."""
        return any(
            (known.command.number, known.command.sender) == (command.number, command.sender)
            and self._is_recent(known, command)
            for known in self._known
        )

    @staticmethod
    def _is_recent(known: _Known, command: Command) -> bool:
        # as text: NaN is like NaN
        is_same = repr(known.command.params) == repr(command.params)
        return is_same and command.time_s - known.heard_s <= RETRY_S
