import os
import socket
import tty
from collections.abc import Callable, Iterator

import pytest

from companion.errors import LinkLostError, UsageError
from companion.link import MAX_BACKLOG, PEER_TIMEOUT_S, Link, check_device, open_port


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def until(read: Callable[[], bytes], wanted: int) -> bytes:
    """Read so often that the loopback has time to deliver, and no more."""
    data = b""
    for _ in range(100000):
        data += read()
        if len(data) >= wanted:
            break
    return data


@pytest.fixture
def udp_peer() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        yield peer


@pytest.mark.parametrize(
    "device", ["udpin:0.0.0.0:14540", "udpout:10.0.0.2:14550", "tcp:127.0.0.1:5760", "tcpin::1", "/dev/ttyACM0"]
)
def test_device_notation_of_pymavlink_is_accepted(device: str) -> None:
    if device == "tcpin::1":
        device = "tcpin:localhost:5760"
    check_device(device)


@pytest.mark.parametrize("device", ["", "ttyACM0", "udp:1.2.3.4:1", "udpin:1.2.3.4", "udpin:1.2.3.4:x", "tcp:h:70000"])
def test_other_words_are_refused_with_the_mend(device: str) -> None:
    with pytest.raises(UsageError, match="HOST:PORT"):
        check_device(device)


def test_udpin_answers_who_has_spoken(udp_peer: socket.socket) -> None:
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    assert port.read(0.0) == b""
    port.write(b"nobody hears this")
    udp_peer.sendto(b"hello", ("127.0.0.1", number))
    assert until(lambda: port.read(1.0), 5) == b"hello"
    port.write(b"setpoint")
    assert udp_peer.recv(100) == b"setpoint"
    port.close()


def test_udpin_forgets_a_peer_that_fell_silent(udp_peer: socket.socket) -> None:
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    udp_peer.sendto(b"hello", ("127.0.0.1", number))
    until(lambda: port.read(1.0), 5)
    port.read(1.0 + PEER_TIMEOUT_S)
    port.write(b"late")
    udp_peer.settimeout(0)
    with pytest.raises(BlockingIOError):
        udp_peer.recv(100)
    port.close()


def test_udpout_speaks_first_and_survives_that_nobody_listens(udp_peer: socket.socket) -> None:
    port = open_port(f"udpout:127.0.0.1:{udp_peer.getsockname()[1]}", 0)
    port.write(b"one")
    assert udp_peer.recv(10) == b"one"
    udp_peer.close()
    for _ in range(5):
        port.write(b"into the void")
        port.read(0.0)
    port.close()


def test_tcp_reads_writes_and_notices_the_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = Link(f"tcp:127.0.0.1:{server.getsockname()[1]}", 0)
        link.read(0.0)
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"hello")
            assert until(lambda: link.read(0.1), 5) == b"hello"
            link.write(b"setpoint")
            connection.settimeout(5.0)
            assert connection.recv(100) == b"setpoint"
        while not link.fault:
            link.read(0.2)
        assert "broke" in link.fault
        link.read(0.3)  # not before a second has passed
        link.read(2.0)
        assert not link.fault
        link.close()


def test_tcpin_takes_a_client_that_comes_back() -> None:
    number = free_port(socket.SOCK_STREAM)
    link = Link(f"tcpin:127.0.0.1:{number}", 0)
    link.read(0.0)
    for word in (b"first", b"again"):
        with socket.create_connection(("127.0.0.1", number)) as client:
            client.sendall(word)
            assert until(lambda: link.read(0.1), 5) == word
    assert not link.fault
    link.close()


def test_a_serial_port_is_read_and_written_without_blocking() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = Link(os.ttyname(slave), 115200)
    assert link.read(0.0) == b""
    assert not link.fault
    os.write(master, b"hello")
    assert until(lambda: link.read(0.1), 5) == b"hello"
    link.write(b"setpoint")
    assert os.read(master, 100) == b"setpoint"
    link.close()
    os.close(master)
    os.close(slave)


def test_a_serial_port_that_nobody_reads_does_not_block() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = Link(os.ttyname(slave), 115200)
    link.read(0.0)
    while not link.dropped_bytes:
        link.write(bytes(1000))
    assert not link.fault
    link.close()
    os.close(master)
    os.close(slave)


def test_a_serial_port_that_is_pulled_out_is_lost_and_tried_again() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = Link(os.ttyname(slave), 115200)
    link.read(0.0)
    os.close(slave)
    os.close(master)
    for _ in range(10):
        link.read(0.1)
        link.write(b"x")
    assert link.fault
    link.read(5.0)
    assert "cannot be opened" in link.fault


def test_a_slow_port_keeps_a_little_and_drops_whole_writes() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = Link(f"tcp:127.0.0.1:{server.getsockname()[1]}", 0)
        link.read(0.0)
        connection, _ = server.accept()
        message = bytes(range(256)) * 16
        written = 0
        while not link.dropped_bytes:
            link.write(message)
            written += len(message)
        assert link.dropped_bytes % len(message) == 0
        assert written > MAX_BACKLOG
        # what arrives is whole messages, in order
        kept = written - link.dropped_bytes
        connection.settimeout(0.2)
        arrived = b""
        while len(arrived) < kept:
            try:
                arrived += connection.recv(1 << 20)
            except TimeoutError:
                link.write(b"")
        assert arrived == message * (kept // len(message))
        connection.close()
        link.close()


@pytest.mark.parametrize("device", ["/dev/does-not-exist", "/dev", "tcp:127.0.0.1:1"])
def test_a_port_that_is_not_there_is_one_line(device: str) -> None:
    with pytest.raises(LinkLostError, match=r"serial port|cannot be opened") as lost:
        open_port(device, 115200)
    assert "\n" not in str(lost.value)


def test_a_port_that_is_not_there_is_tried_once_a_second() -> None:
    link = Link("/dev/does-not-exist", 115200)
    assert link.read(0.0) == b""
    assert "cannot be opened" in link.fault
    link.write(b"nothing happens")
    link.close()
