"""The bytes of one link: MAVLink 2 messages in, messages of all our components out. Sans-I/O: no port, no clock.

There is one parser, whoever of us a message is for, and one sender a component: each has its own sequence numbers. What
the senders write leaves in the order in which it was written.
"""

import os
from typing import Any

os.environ.setdefault("MAVLINK20", "1")  # read by pymavlink at import; version 1 cannot carry what we send

from pymavlink.dialects.v20 import common as mavlink

_MAX_BACKLOG = 65536  # bytes handed to the parser at once; a longer read is old


class _Outbox:
    """What pymavlink writes to, a message at a time; its sequence numbers advance only in `send`."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []

    def write(self, packet: bytes) -> None:
        self.packets.append(bytes(packet))


class Wire:
    """The link's messages; `system_id` is the vehicle's, which all our components share."""

    def __init__(self, system_id: int = 1) -> None:
        self._outbox = _Outbox()
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders: dict[int, Any] = {}
        self._system_id = system_id

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
            self._senders[component_id] = mavlink.MAVLink(self._outbox, self._system_id, component_id)
        return self._senders[component_id]

    def receive(self, data: bytes) -> list[Any]:
        """Messages in what has arrived, in any chunks; never raises, whatever the bytes.

        What no message can be made of is left out, and so is what a router has sent back to us.
        """
        parser = self._parser
        messages = parser.parse_buffer(data[-_MAX_BACKLOG:]) or []
        # pymavlink frees its buffer only when nothing is left in it, which may never happen
        del parser.buf[: parser.buf_index]
        parser.buf_index = 0
        return [m for m in messages if m.get_type() != "BAD_DATA" and not self._is_echo(m)]

    def _is_echo(self, message: Any) -> bool:
        return message.get_srcSystem() == self._system_id and message.get_srcComponent() in self._senders

    def drain(self) -> tuple[bytes, ...]:
        """All messages to be written since the last call, in order."""
        packets, self._outbox.packets = tuple(self._outbox.packets), []
        return packets
