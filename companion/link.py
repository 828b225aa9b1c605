"""The port to the autopilot: serial, UDP or TCP, never blocking, opened again when it breaks.

Device notation is pymavlink's. Its own `mavutil` is not used: it sleeps while it reconnects, times out on the wall
clock and keeps a global connection, none of which the command loop can bear.
"""

import contextlib
import errno
import fcntl
import logging
import math
import os
import socket
import stat
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import serial

from companion.errors import LinkLostError, UsageError

logger = logging.getLogger(__name__)
RETRY_S = 1.0
MAX_QUEUE_S = 0.1  # of data that waits in a serial port's driver; more would be old when it leaves
MIN_QUEUE = 512  # bytes that may wait there in any case, and in a TCP connection: what one step may write
MAX_PEERS = 8
PEER_TIMEOUT_S = 10.0  # after which a silent UDP client is written to no more
CLIENT_TIMEOUT_S = (
    3.0  # for which a TCP client may be silent and keep its place: an autopilot's heartbeats are no later
)
_READ_SIZE = 65536
_MOST_PACKETS = 1000  # at a read: empty ones never fill it
_FLUSH_WAIT_S = 0.005
_HEADER, _CHECKSUM, _SIGNATURE, _IS_SIGNED = 10, 2, 13, 1  # of a MAVLink 2 message
_HEADER_V1 = 6
_MARKERS = b"\xfe\xfd"  # of MAVLink 1 and 2
_SCHEMES = ("udpin", "udpout", "tcp", "tcpin")


class Port(Protocol):
    """An open port; no call blocks, and reads and writes raise OSError where it is broken.

    Opening looks a host's name up, which may take a while: on a vehicle, give numbers.
    """

    def read(self, now_s: float) -> bytes: ...
    def write(self, data: bytes) -> int: ...
    def close(self) -> None: ...


class _UdpServer:
    """Answers everybody who has spoken lately."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = _udp()
        try:
            self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise
        self._peers: dict[tuple[str, int], float] = {}  # when it was heard last

    def read(self, now_s: float) -> bytes:
        data = b""
        for packet, peer in _packets(self._socket):
            data += _whole(packet)
            self._peers.pop(peer, None)  # the last one is the latest to have spoken
            self._peers[peer] = now_s
            if len(self._peers) > MAX_PEERS:
                del self._peers[next(iter(self._peers))]
        self._peers = {peer: seen_s for peer, seen_s in self._peers.items() if now_s - seen_s < PEER_TIMEOUT_S}
        return data

    def write(self, data: bytes) -> int:
        sent = not self._peers
        for peer in self._peers:
            try:
                self._socket.sendto(data, peer)
            except OSError:  # full, not there, no way to it: the others are to hear it all the same
                continue
            sent = True
        return len(data) if sent else 0

    def close(self) -> None:
        self._socket.close()


class _UdpClient:
    """Speaks to one address, looked up once, and hears nobody else."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = _udp()
        try:
            self._socket.connect(address)
        except OSError:
            self._socket.close()
            raise

    def read(self, now_s: float) -> bytes:
        return b"".join(packet for packet, _ in _packets(self._socket))

    def write(self, data: bytes) -> int:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):  # lost, as any datagram may be
            self._socket.send(data)
        return len(data)

    def close(self) -> None:
        self._socket.close()


class _TcpPort:
    """A client, or a server for one client at a time.

    Who has connected keeps its place until it closes or has been silent for 3 s: nobody else who can reach the port is
    to take that of an autopilot that obeys us. One that comes back sooner is turned away, too, and has to try again.
    """

    def __init__(self, address: tuple[str, int], *, is_server: bool) -> None:
        self._listener: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._heard_s = -math.inf  # when the client was taken in, or spoke last
        self._has_refused = False  # another one, since then
        if is_server:
            self._listener = socket.create_server(address, backlog=1)
            self._listener.settimeout(0)
        else:
            self._socket = socket.create_connection(address, timeout=0.02)
            _prepare_tcp(self._socket)

    def read(self, now_s: float) -> bytes:
        data = self._received(now_s)  # first: after a stall of ours, what it has said meanwhile keeps it its place
        if self._listener is not None and self._has_taken_in(self._listener, now_s):
            data += self._received(now_s)
        return data

    def _has_taken_in(self, listener: socket.socket, now_s: float) -> bool:
        """Whether a client is new; one at most for whom there is no place is turned away."""
        try:
            connection, (host, *_) = listener.accept()
        except OSError:  # nobody, or gone again: no reason to lose who is there
            return False
        if self._socket is not None and now_s - self._heard_s < CLIENT_TIMEOUT_S:
            connection.close()
            if not self._has_refused:  # said once: who tries again and again would fill the log
                logger.warning("link: turned away %s: another client is connected, and speaks", host)
            self._has_refused = True
            return False
        if self._socket is not None:
            self._socket.close()
        _prepare_tcp(connection)
        self._socket, self._heard_s, self._has_refused = connection, now_s, False
        return True

    def _received(self, now_s: float) -> bytes:
        data = b""
        while self._socket is not None and len(data) < _READ_SIZE:  # to the last byte, as a serial port is
            try:
                part = self._socket.recv(_READ_SIZE)
            except BlockingIOError:
                break
            except OSError:
                part = b""
            if not part:
                self._drop()
            data += part
        if data:
            self._heard_s = now_s
        return data

    def write(self, data: bytes) -> int:
        if self._socket is None:
            return len(data)
        try:
            if _queued(self._socket) > MIN_QUEUE:
                return 0
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop()
            return len(data)

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._listener is None:
            raise ConnectionResetError(errno.ECONNRESET, "the other side closed the connection")

    def close(self) -> None:
        for end in (self._socket, self._listener):
            if end is not None:
                end.close()


class _SerialPort:
    def __init__(self, path: str, baud: int) -> None:
        self._serial = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
        self._most_queued = max(MIN_QUEUE, round(MAX_QUEUE_S * baud / 10))  # a byte takes ten bits

    def read(self, now_s: float) -> bytes:
        # to the last byte: after a stall, what is left behind would be taken for news at the next step
        data = b""
        while len(data) < _READ_SIZE and (part := self._serial.read(_READ_SIZE)):
            data += part
        return data

    def write(self, data: bytes) -> int:
        if self._serial.out_waiting > self._most_queued:
            return 0
        # not the library's own write: with a full buffer it tries for ever, whatever its time-out
        try:
            return os.write(self._serial.fileno(), data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        self._serial.close()


def _udp() -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.settimeout(0)
    return end


def _packets(end: socket.socket) -> Iterator[tuple[bytes, tuple[str, int]]]:
    """What has come, with the sender of each; no more than a read is to bring."""
    size = 0
    for _ in range(_MOST_PACKETS):
        try:
            packet, peer = end.recvfrom(_READ_SIZE)
        except BlockingIOError:
            return
        except ConnectionRefusedError:  # ICMP's answer to what was sent before: nobody listens there
            continue
        yield packet, peer
        size += len(packet)
        if size >= _READ_SIZE:
            return


def _queued(end: socket.socket) -> int:
    """Bytes that were sent and not yet acknowledged."""
    return int.from_bytes(fcntl.ioctl(end, termios.TIOCOUTQ, bytes(4)), sys.byteorder)


def _prepare_tcp(connection: socket.socket) -> None:
    connection.settimeout(0)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a setpoint must not wait for the next


def check_device(device: str) -> None:
    """Raise UsageError where `device` is no device notation; whether it is there is another matter."""
    scheme, *rest = device.split(":")
    if scheme in _SCHEMES:
        if len(rest) != 2 or not rest[0] or not rest[1].isdigit() or not 0 < int(rest[1]) < 65536:
            raise UsageError(f"{device!r} must be {scheme}:HOST:PORT with a port in 1..65535")
    elif not device.startswith("/"):
        schemes = ", ".join(f"{scheme}:HOST:PORT" for scheme in _SCHEMES)
        raise UsageError(f"{device!r} is no link: give {schemes}, or the path of a serial port")


def open_port(device: str, baud: int) -> Port:
    """Open a port.

    Raises
    ------
    LinkLostError
        If it cannot be opened; the text says how to mend it.
    """
    scheme, *rest = device.split(":")
    try:
        if scheme in _SCHEMES:
            address = (rest[0], int(rest[1]))
            if scheme.startswith("udp"):
                return _UdpServer(address) if scheme == "udpin" else _UdpClient(address)
            return _TcpPort(address, is_server=scheme == "tcpin")
        if not stat.S_ISCHR(Path(device).stat().st_mode):
            raise LinkLostError(f"{device} is no serial port")
        return _SerialPort(device, baud)
    except serial.SerialException as error:
        raise LinkLostError(f"{device} cannot be opened: {error}") from error
    except OSError as error:
        raise LinkLostError(f"{device} cannot be opened: {error.strerror or error}") from error


def _whole(datagram: bytes) -> bytes:
    """The messages that are whole in a datagram.

    What a stranger has cut off, by mistake or not, would swallow the beginning of the next one's.
    """
    messages, start = b"", 0
    while start < len(datagram):
        size = _size(datagram[start : start + _HEADER])
        if start + size > len(datagram):
            break
        messages += datagram[start : start + size] if datagram[start] in _MARKERS else b""
        start += size
    return messages


def _size(header: bytes) -> int:
    """Of the message that begins so, of either version: an old autopilot begins with the first. 1 where none does."""
    if header[0] not in _MARKERS:
        return 1
    if header[0] == _MARKERS[1]:
        return _HEADER if len(header) < _HEADER else _length(header, 0)
    return _HEADER_V1 + _CHECKSUM + (header[1] if len(header) > 1 else 0)


def _length(data: bytes, start: int) -> int:
    """Of the MAVLink 2 message that starts there; what is cut off of it is counted, too."""
    header = data[start : start + _HEADER]
    if len(header) < _HEADER:
        return len(header)
    return _HEADER + header[1] + _CHECKSUM + (_SIGNATURE if header[2] & _IS_SIGNED else 0)


class Link:
    """A port that is opened again when it breaks; reads and writes never block and never raise."""

    def __init__(self, device: str, baud: int) -> None:
        self.fault = "not opened yet"  # why it is not open; empty: it is
        self.dropped_bytes = 0
        self._device = device
        self._baud = baud
        self._port: Port | None = None
        self._tried_s = float("-inf")
        self._rest = b""  # of the message that was cut

    def read(self, now_s: float) -> bytes:
        """What has arrived; opens the port where it is not, once a second."""
        if self._port is None:
            self._open(now_s)
        if self._port is None:
            return b""
        try:
            return self._port.read(now_s)
        except (OSError, serial.SerialException) as error:
            self._lose(error)
            return b""

    def write(self, data: bytes) -> bool:
        """Send what the port takes; of the rest, only that of a message that was cut is kept.

        A setpoint that waited would be old when it leaves, and the next one follows in a period of the loop.

        Parameters
        ----------
        data : whole MAVLink 2 messages.

        Returns
        -------
        Whether no message was dropped.
        """
        if self._port is None:
            return not data
        if not (data or self._rest):
            return True
        waiting = self._rest + data
        sent = self._send(waiting)
        end = len(self._rest)
        while end < sent:
            end += _length(waiting, end)
        self._rest = waiting[sent:end]
        self.dropped_bytes += len(waiting) - end
        return self._port is not None and end == len(waiting)

    def flush(self, data: bytes, patience_s: float) -> None:
        """Send last words, every one; waits for the port, `patience_s` at most."""
        waiting, end_s = self._rest + data, time.monotonic() + patience_s
        while self._port is not None and waiting and time.monotonic() < end_s:
            sent = self._send(waiting)
            waiting = waiting[sent:]
            if not sent:
                time.sleep(_FLUSH_WAIT_S)

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _send(self, data: bytes) -> int:
        """How many bytes the port has taken."""
        assert self._port is not None
        try:
            return self._port.write(data)
        except (OSError, serial.SerialException) as error:
            self._lose(error)
            return 0

    def _open(self, now_s: float) -> None:
        if now_s - self._tried_s < RETRY_S:
            return
        self._tried_s = now_s
        try:
            self._port = open_port(self._device, self._baud)
        except LinkLostError as error:
            if str(error) != self.fault:
                self.fault = str(error)
                logger.warning("link: %s", self.fault)
            return
        self.fault, self._rest = "", b""
        logger.info("link %s is open", self._device)

    def _lose(self, error: Exception) -> None:
        self.fault = f"{self._device} broke: {getattr(error, 'strerror', None) or error}"
        logger.warning("link: %s", self.fault)
        self.close()
