"""The bytes of one link: MAVLink 2 messages in, messages of all our components out. Sans-I/O: no port, no clock.

There is one parser, whoever of us a message is for, and one sender a component: each has its own sequence numbers. What
the senders write leaves in the order in which it was written, but for what moves the vehicle: on a slow port a setpoint
would be old before it had got past the answers to a ground station's questions, which may wait.
"""

import logging
import os
from functools import partial
from typing import TYPE_CHECKING, Any

os.environ.setdefault("MAVLINK20", "1")  # read by pymavlink at import; version 1 cannot carry what we send

from pymavlink.dialects.v20 import common as mavlink

from companion.signing import Signing

if TYPE_CHECKING:
    from collections.abc import Callable

logger = logging.getLogger(__name__)
_MAX_BACKLOG = 65536  # bytes handed to the parser at once; a longer read is old


class _Outbox:
    """What pymavlink writes to, a message at a time; its sequence numbers advance only in `send`."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []

    def write(self, packet: bytes) -> None:
        self.packets.append(bytes(packet))


class Wire:
    """The link's messages.

    Parameters
    ----------
    system_id : the vehicle's, which all our components share.
    signing : everything that is sent is signed, and nothing else is heard; None: neither.
    """

    def __init__(self, system_id: int = 1, signing: Signing | None = None) -> None:
        self._signing = signing
        self._system_id = system_id
        self._outbox = _Outbox()
        self._waiting: list[tuple[Any, Callable[[], None]]] = []  # messages, and what packs each into the outbox
        self._parser = self._end(0)
        self._parser.robust_parsing = True
        self._senders: dict[int, Any] = {}
        self._failed: set[str] = set()  # kinds of messages of which one could not be packed

    @property
    def system_id(self) -> int:
        """Of the vehicle, and of everything that is sent."""
        return self._system_id

    @system_id.setter
    def system_id(self, system_id: int) -> None:
        self._system_id = system_id
        for sender in self._senders.values():
            sender.srcSystem = system_id

    def sender(self, component_id: int) -> Any:
        """What a component of ours sends with: pymavlink's `MAVLink`, whose `*_send` methods write to this wire."""
        if component_id not in self._senders:
            end = self._senders[component_id] = self._end(component_id)
            end.send = partial(self._hold, end)
        return self._senders[component_id]

    def _hold(self, end: Any, message: Any, **version: Any) -> None:
        """Keep a message for `drain`: overtaken after packing it would be out of sequence, a replay where signed."""
        self._waiting.append((message, partial(mavlink.MAVLink.send, end, message, **version)))

    def _end(self, component_id: int) -> Any:
        end = mavlink.MAVLink(self._outbox, self._system_id, component_id)
        if self._signing is not None:
            self._signing.equip(end)
        return end

    def receive(self, data: bytes) -> list[Any]:
        """Messages in what has arrived, in any chunks; never raises, whatever the bytes.

        What no message can be made of is left out, and so is what a router has sent back to us, what is not signed
        where signing is on, and SETUP_SIGNING, which carries a key that nobody is to log.
        """
        parser = self._parser
        messages = parser.parse_buffer(data[-_MAX_BACKLOG:]) or []
        # pymavlink frees its buffer only when nothing is left in it, which may never happen
        del parser.buf[: parser.buf_index]
        parser.buf_index = 0
        return [m for m in messages if self._is_heard(m) and not self._is_echo(m)]

    def _is_heard(self, message: Any) -> bool:
        kind = message.get_type()
        # pymavlink hands on what it does not know before it has looked at signature and checksum
        is_unchecked = self._signing is not None and kind.startswith("UNKNOWN_")
        return kind not in {"BAD_DATA", "SETUP_SIGNING"} and not is_unchecked

    def _is_echo(self, message: Any) -> bool:
        return message.get_srcSystem() == self._system_id and message.get_srcComponent() in self._senders

    def drain(self) -> tuple[bytes, ...]:
        """All messages to be written since the last call: first those that are urgent, each kind in order.

        One that cannot be packed is left out, and logged where it is the first of its kind: a mistake in an answer must
        cost no setpoint and no last words.
        """
        waiting, self._waiting = self._waiting, []
        self._outbox.packets = []
        for message, pack in sorted(waiting, key=lambda held: not _is_urgent(held[0])):
            try:
                pack()
            except Exception:  # whatever it is, it is this one message's
                kind = message.get_type()
                if kind not in self._failed:
                    self._failed.add(kind)
                    logger.exception("%s cannot be packed, and is not sent", kind)
        return tuple(self._outbox.packets)


def _is_urgent(message: Any) -> bool:
    """Whether a message steers the vehicle, or asks for a time, whose answer would look late by what is ahead of it.

    A request for a flight mode counts, too: ahead of it, a setpoint alone may bring PX4 back to OFFBOARD.
    """
    match message.get_type():
        case "SET_POSITION_TARGET_LOCAL_NED":
            return True
        case "COMMAND_LONG":
            return bool(message.command == mavlink.MAV_CMD_DO_SET_MODE)
        case "TIMESYNC":
            return bool(message.tc1 == 0)
    return False
