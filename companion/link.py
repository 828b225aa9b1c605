"""The port to the autopilot: serial, UDP or TCP, never blocking, opened again when it breaks.

Device notation is pymavlink's. Its own `mavutil` is not used: it sleeps while it reconnects, times out on the wall
clock and keeps a global connection, none of which the command loop can bear.
"""

import errno
import logging
import os
import socket
import stat
from pathlib import Path
from typing import Protocol

import serial

from companion.errors import LinkLostError, UsageError

logger = logging.getLogger(__name__)
RETRY_S = 1.0
MAX_BACKLOG = 4096  # bytes that wait for a slow port; more would be old when they leave
PEER_TIMEOUT_S = 10.0  # after which a silent UDP client is written to no more
_READ_SIZE = 65536
_MOST_PACKETS = 1000  # at a read: empty ones never fill it
_SCHEMES = ("udpin", "udpout", "tcp", "tcpin")


class Port(Protocol):
    """An open port; neither call blocks, and either raises OSError where it is broken."""

    def read(self, now_s: float) -> bytes: ...
    def write(self, data: bytes) -> int: ...
    def close(self) -> None: ...


class _UdpPort:
    def __init__(self, address: tuple[str, int], *, is_server: bool) -> None:
        self._socket = _bound_udp(address) if is_server else _udp()
        self._peers: dict[tuple[str, int], float] = {} if is_server else {address: float("inf")}

    def read(self, now_s: float) -> bytes:
        data = b""
        for _ in range(_MOST_PACKETS):
            if len(data) >= _READ_SIZE:
                break
            try:
                packet, peer = self._socket.recvfrom(_READ_SIZE)
            except BlockingIOError:
                break
            except ConnectionRefusedError:  # ICMP's answer to what was sent before: nobody listens yet
                continue
            data += packet
            if self._peers.get(peer) != float("inf"):
                self._peers[peer] = now_s
        self._peers = {peer: seen_s for peer, seen_s in self._peers.items() if now_s - seen_s < PEER_TIMEOUT_S}
        return data

    def write(self, data: bytes) -> int:
        for peer in self._peers:
            try:
                self._socket.sendto(data, peer)
            except (BlockingIOError, ConnectionRefusedError):
                continue
        return len(data)

    def close(self) -> None:
        self._socket.close()


class _TcpPort:
    """A client, or a server for one client at a time."""

    def __init__(self, address: tuple[str, int], *, is_server: bool) -> None:
        self._listener: socket.socket | None = None
        self._socket: socket.socket | None = None
        if is_server:
            self._listener = socket.create_server(address, backlog=1)
            self._listener.settimeout(0)
        else:
            self._socket = socket.create_connection(address, timeout=0.02)
            _prepare_tcp(self._socket)

    def read(self, now_s: float) -> bytes:
        if self._listener is not None:
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                pass
            else:
                if self._socket is not None:
                    self._socket.close()  # a client that comes back replaces what is left of itself
                self._socket = connection
                _prepare_tcp(connection)
        if self._socket is None:
            return b""
        try:
            data = self._socket.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> int:
        if self._socket is None:
            return len(data)
        try:
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

    def read(self, now_s: float) -> bytes:
        return bytes(self._serial.read(_READ_SIZE))

    def write(self, data: bytes) -> int:
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


def _bound_udp(address: tuple[str, int]) -> socket.socket:
    end = _udp()
    try:
        end.bind(address)
    except OSError:
        end.close()
        raise
    return end


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
                return _UdpPort(address, is_server=scheme == "udpin")
            return _TcpPort(address, is_server=scheme == "tcpin")
        if not stat.S_ISCHR(Path(device).stat().st_mode):
            raise LinkLostError(f"{device} is no serial port")
        return _SerialPort(device, baud)
    except serial.SerialException as error:
        raise LinkLostError(f"{device} cannot be opened: {error}") from error
    except OSError as error:
        raise LinkLostError(f"{device} cannot be opened: {error.strerror or error}") from error


class Link:
    """A port that is opened again when it breaks; reads and writes never block and never raise."""

    def __init__(self, device: str, baud: int) -> None:
        self.fault = "not opened yet"  # why it is not open; empty: it is
        self.dropped_bytes = 0
        self._device = device
        self._baud = baud
        self._port: Port | None = None
        self._tried_s = float("-inf")
        self._backlog = b""

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

    def write(self, data: bytes) -> None:
        """Send, or keep what a slow port does not take yet; what would be old by then is dropped whole."""
        if self._port is None or not (data or self._backlog):
            return
        if len(self._backlog) > MAX_BACKLOG:
            self.dropped_bytes += len(data)
            data = b""
        waiting = self._backlog + data
        try:
            sent = self._port.write(waiting)
        except (OSError, serial.SerialException) as error:
            self._lose(error)
            return
        self._backlog = waiting[sent:]

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

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
        self.fault, self._backlog = "", b""
        logger.info("link %s is open", self._device)

    def _lose(self, error: Exception) -> None:
        self.fault = f"{self._device} broke: {getattr(error, 'strerror', None) or error}"
        logger.warning("link: %s", self.fault)
        self.close()
