import contextlib
import os
import select
import socket
import tty
from collections.abc import Callable, Iterator

import pytest
import serial
from pymavlink.dialects.v20 import common as mavlink

from companion.errors import LinkLostError, UsageError
from companion.link import CLIENT_TIMEOUT_S, MAX_PEERS, MIN_QUEUE, PEER_TIMEOUT_S, Link, check_device, open_port


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


HELLO = bytes([0xFD, 3, 0, 0, 0, 1, 1, 0, 0, 0]) + b"abc" + b"xx"  # shaped as a MAVLink 2 message


def test_udpin_answers_who_has_spoken(udp_peer: socket.socket) -> None:
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    assert port.read(0.0) == b""
    port.write(b"nobody hears this")
    udp_peer.sendto(HELLO, ("127.0.0.1", number))
    assert until(lambda: port.read(1.0), 5) == HELLO
    port.write(b"setpoint")
    assert udp_peer.recv(100) == b"setpoint"
    port.close()


V1 = bytes.fromhex("fe 02 00 01 01 00 aa bb cc dd")
SIGNED = bytes([0xFD, 1, 1, 0, 0, 1, 1, 0, 0, 0]) + bytes(1 + 2 + 13)


@pytest.mark.parametrize(
    ("datagram", "kept"),
    [
        (HELLO + HELLO, HELLO + HELLO),
        (HELLO + HELLO[:-1], HELLO),
        (HELLO + HELLO[:9], HELLO),
        (b"\xfd", b""),
        (b"\xfe", b""),
        (b"noise" + HELLO, HELLO),
        (V1 + HELLO + V1[:-1], V1 + HELLO),
        (SIGNED + HELLO, SIGNED + HELLO),
        (b"", b""),
    ],
)
def test_of_a_datagram_only_whole_messages_are_read(udp_peer: socket.socket, datagram: bytes, kept: bytes) -> None:
    """Else the next datagram, of whomever, would be taken for the rest."""
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    udp_peer.sendto(datagram, ("127.0.0.1", number))
    udp_peer.sendto(HELLO, ("127.0.0.1", number))
    data = b""
    while len(data) < len(kept + HELLO):
        data += until(lambda: port.read(0.0), 5)
    assert data == kept + HELLO
    port.close()


def test_udpin_forgets_a_peer_that_fell_silent(udp_peer: socket.socket) -> None:
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    udp_peer.sendto(HELLO, ("127.0.0.1", number))
    until(lambda: port.read(1.0), 5)
    port.read(1.0 + PEER_TIMEOUT_S)
    port.write(b"late")
    udp_peer.settimeout(0)
    with pytest.raises(BlockingIOError):
        udp_peer.recv(100)
    port.close()


def test_udpout_hears_nobody_else_and_sends_each_message_once(udp_peer: socket.socket) -> None:
    port = open_port(f"udpout:localhost:{udp_peer.getsockname()[1]}", 0)
    port.write(b"one")
    _, address = udp_peer.recvfrom(10)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.sendto(b"engage!", address)
        udp_peer.sendto(b"hello", address)
        assert until(lambda: port.read(0.0), 5) == b"hello"
        port.write(b"two")
        assert udp_peer.recv(10) == b"two"
        udp_peer.settimeout(0)
        stranger.settimeout(0)
        for end in (udp_peer, stranger):
            with pytest.raises(BlockingIOError):
                end.recv(10)
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


class Hall:
    """A server's link, whose clock is at 100 s, and those who come to it."""

    def __init__(self) -> None:
        self._number = free_port(socket.SOCK_STREAM)
        self.link = Link(f"tcpin:127.0.0.1:{self._number}", 0)
        self.link.read(100.0)
        self.ends: list[socket.socket] = []

    def come(self) -> socket.socket:
        """Somebody connects; the loopback has it in the server's queue when this returns."""
        end = socket.create_connection(("127.0.0.1", self._number), timeout=5.0)
        self.ends.append(end)
        return end

    def hear(self, end: socket.socket, word: bytes, now_s: float) -> bytes:
        """What the link reads once an end has spoken."""
        end.sendall(word)
        return until(lambda: self.link.read(now_s), len(word))

    def has_gone(self, end: socket.socket, now_s: float) -> bool:
        """Whether the server closes a connection when it reads."""
        end.settimeout(0.0)
        for _ in range(20000):  # so often that the loopback has time to deliver
            self.link.read(now_s)
            try:
                return end.recv(100) == b""
            except BlockingIOError:
                continue
            except ConnectionResetError:  # closed with something unread
                return True
        return False


@pytest.fixture
def hall() -> Iterator[Hall]:
    hall = Hall()
    yield hall
    hall.link.close()
    for end in hall.ends:
        end.close()


def test_tcpin_turns_away_whoever_comes_while_the_first_one_speaks(
    hall: Hall, caplog: pytest.LogCaptureFixture
) -> None:
    autopilot = hall.come()
    for k in range(10):
        now_s = 101.0 + k * (CLIENT_TIMEOUT_S - 0.1)
        assert hall.hear(autopilot, b"alive", now_s) == b"alive"
        stranger = hall.come()
        stranger.sendall(b"engage!")
        assert hall.has_gone(stranger, now_s + CLIENT_TIMEOUT_S - 0.2)
    hall.link.write(b"setpoint")
    assert autopilot.recv(100) == b"setpoint"
    assert not hall.link.fault
    assert [record.message for record in caplog.records if "turned away" in record.message] == [
        "link: turned away 127.0.0.1: another client is connected, and speaks"
    ]


def test_tcpin_lets_nobody_in_before_the_one_who_has_just_come_can_have_spoken(hall: Hall) -> None:
    autopilot = hall.come()
    hall.link.read(101.0)
    assert hall.has_gone(hall.come(), 101.05)
    assert hall.hear(autopilot, b"hello", 101.1) == b"hello"


def test_after_a_stall_of_ours_what_has_come_meanwhile_keeps_the_first_ones_place(hall: Hall) -> None:
    autopilot = hall.come()
    assert hall.hear(autopilot, b"hello", 101.0) == b"hello"
    autopilot.sendall(b"alive")
    stranger = hall.come()
    assert select.select([hall.link._port._socket], [], [], 5.0)[0]  # type: ignore[union-attr]
    assert until(lambda: hall.link.read(101.0 + 2 * CLIENT_TIMEOUT_S), 5) == b"alive"
    assert hall.has_gone(stranger, 101.0 + 2 * CLIENT_TIMEOUT_S)


def test_tcpin_gives_a_silent_ones_place_to_the_next(hall: Hall) -> None:
    silent = hall.come()
    assert hall.hear(silent, b"hello", 101.0) == b"hello"
    assert hall.hear(hall.come(), b"again", 101.0 + CLIENT_TIMEOUT_S) == b"again"
    assert hall.has_gone(silent, 101.0 + CLIENT_TIMEOUT_S)


def test_a_client_that_is_alone_may_be_silent_for_as_long_as_it_likes(hall: Hall) -> None:
    quiet = hall.come()
    hall.link.read(101.0)
    assert hall.hear(quiet, b"late", 1000.0) == b"late"


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


def setpoint(number: int) -> bytes:
    """A message whose time is its number."""
    mav = mavlink.MAVLink(None)
    numbers = number, 1, 1, 1, 1479, *[0.0] * 3, *[1.5] * 3, *[0.0] * 4, 0.25
    return bytes(mav.set_position_target_local_ned_encode(*numbers).pack(mav))


class SlowPort:
    """Takes so many bytes and no more, until it is emptied."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.taken = b""

    def read(self, now_s: float) -> bytes:
        return b""

    def write(self, data: bytes) -> int:
        part = data[: self.room]
        self.taken += part
        self.room -= len(part)
        return len(part)

    def close(self) -> None: ...


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> tuple[Link, SlowPort]:
    port = SlowPort(0)
    monkeypatch.setattr("companion.link.open_port", lambda *_: port)
    link = Link("/dev/slow", 57600)
    link.read(0.0)
    return link, port


@pytest.mark.parametrize("is_signed", [False, True])
@pytest.mark.parametrize("room", [0, 1, 9, 10, 64, 65, 66, 100, 129, 130, 195])
def test_of_what_a_slow_port_does_not_take_only_a_cut_message_is_finished(
    slow: tuple[Link, SlowPort], room: int, *, is_signed: bool
) -> None:
    link, port = slow
    messages = [setpoint(number) for number in range(4)]
    if is_signed:
        messages = [message[:2] + b"\x01" + message[3:] + bytes(13) for message in messages]
    length = len(messages[0])
    port.room = room
    link.write(b"".join(messages[:3]))
    port.room = 10000
    link.write(messages[3])
    begun = -(-room // length)
    assert port.taken == b"".join([*messages[:begun][:3], messages[3]])
    assert link.dropped_bytes == max(3 - begun, 0) * length


def test_a_cut_message_may_take_many_writes_and_what_comes_meanwhile_is_dropped(slow: tuple[Link, SlowPort]) -> None:
    link, port = slow
    for number in range(5):
        port.room = 15
        link.write(setpoint(number))
    assert port.taken == setpoint(0) + setpoint(4)[:10]
    assert link.dropped_bytes == sum(len(setpoint(number)) for number in (1, 2, 3))


def test_setpoints_do_not_queue_in_a_tcp_connection_that_nobody_reads() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = Link(f"tcp:127.0.0.1:{server.getsockname()[1]}", 0)
        link.read(0.0)
        connection, _ = server.accept()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        was_taken = [link.write(setpoint(number)) for number in range(5000)]
        assert not was_taken[-1]
        assert link.dropped_bytes > 0
        connection.settimeout(5.0)
        waiting = len(setpoint(0)) * sum(was_taken)
        assert len(until(lambda: connection.recv(1 << 20), waiting)) == waiting
        while not link.write(setpoint(7)):  # acknowledged a little later
            pass
        assert connection.recv(100) == setpoint(7)
        connection.close()
        link.close()


def test_one_peer_that_cannot_be_reached_does_not_keep_the_others_from_hearing(udp_peer: socket.socket) -> None:
    number = free_port(socket.SOCK_DGRAM)
    link = Link(f"udpin:127.0.0.1:{number}", 0)
    link.read(0.0)
    udp_peer.sendto(HELLO, ("127.0.0.1", number))
    until(lambda: link.read(1.0), 5)
    peers = link._port._peers  # type: ignore[union-attr]
    link._port._peers = {("255.255.255.255", 9): 1.0, **peers}  # type: ignore[union-attr]  # EACCES, like ENETUNREACH
    assert link.write(b"setpoint")
    assert udp_peer.recv(100) == b"setpoint"
    assert not link.fault
    link.close()


def test_a_crowd_of_peers_does_not_grow_and_the_latest_are_kept() -> None:
    number = free_port(socket.SOCK_DGRAM)
    port = open_port(f"udpin:127.0.0.1:{number}", 0)
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(MAX_PEERS + 4)]
    for end in ends:
        end.sendto(b"x", ("127.0.0.1", number))
        until(lambda: port.read(1.0), 1)
    port.write(b"setpoint")
    for end in ends:
        end.settimeout(0)
    heard = [end for end in ends if b"setpoint" in _received(end)]
    assert heard == ends[4:]
    for end in ends:
        end.close()
    port.close()


def _received(end: socket.socket) -> bytes:
    try:
        return end.recv(100)
    except BlockingIOError:
        return b""


def test_last_words_are_waited_for_and_follow_the_message_that_was_cut(slow: tuple[Link, SlowPort]) -> None:
    link, port = slow
    port.room = 7
    link.write(setpoint(0))

    class Emptied(SlowPort):
        def write(self, data: bytes) -> int:
            self.room = 20  # emptied as fast as it is filled
            return super().write(data)

    quick = Emptied(0)
    quick.taken = port.taken
    link._port = quick
    link.flush(setpoint(1) + setpoint(2), patience_s=10.0)
    assert quick.taken == setpoint(0) + setpoint(1) + setpoint(2)


def test_last_words_do_not_wait_for_ever(slow: tuple[Link, SlowPort]) -> None:
    link, port = slow
    link.flush(setpoint(0), patience_s=0.02)
    assert port.taken == b""


def test_setpoints_do_not_queue_in_the_driver_of_a_slow_serial_port(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = Link(os.ttyname(slave), 9600)
    link.read(0.0)
    monkeypatch.setattr(serial.Serial, "out_waiting", MIN_QUEUE + 1)
    link.write(setpoint(0))
    monkeypatch.setattr(serial.Serial, "out_waiting", MIN_QUEUE)
    link.write(setpoint(1))
    assert os.read(master, 1000) == setpoint(1)
    link.close()
    os.close(master)
    os.close(slave)


def test_a_serial_port_is_read_to_the_last_byte_after_a_stall() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = Link(os.ttyname(slave), 115200)
    link.read(0.0)
    os.set_blocking(master, False)
    written = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            written += os.write(master, bytes(4096))
    assert written > 4096  # more than one read brings
    assert len(link.read(0.1)) == min(written, 65536)
    link.close()
    os.close(master)
    os.close(slave)


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
