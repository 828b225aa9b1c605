import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.notify import Notifier


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(0)
        yield listener


def test_fields_are_sent_as_lines_of_one_datagram(systemd: socket.socket) -> None:
    notifier = Notifier(systemd.getsockname())
    notifier.send(READY="1", STATUS="idle, 30 frames/s")
    assert systemd.recv(200) == b"READY=1\nSTATUS=idle, 30 frames/s"
    notifier.close()


def test_an_abstract_address_is_understood() -> None:
    name = f"mscf-notify-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name)
        listener.settimeout(0)
        notifier = Notifier("@" + name)
        notifier.send(WATCHDOG="1")
        assert listener.recv(100) == b"WATCHDOG=1"
        notifier.close()


@pytest.mark.parametrize("address", [None, ""])
def test_without_systemd_nothing_happens(address: str | None) -> None:
    notifier = Notifier(address)
    notifier.send(READY="1")
    notifier.close()


def test_a_systemd_that_is_gone_is_no_reason_to_stop(tmp_path: Path) -> None:
    notifier = Notifier(str(tmp_path / "nobody"))
    notifier.send(WATCHDOG="1")
    notifier.close()


def test_a_systemd_that_does_not_read_blocks_nobody(systemd: socket.socket) -> None:
    notifier = Notifier(systemd.getsockname())
    for _ in range(10000):
        notifier.send(WATCHDOG="1")
    notifier.close()


def test_children_do_not_inherit_the_address(monkeypatch: pytest.MonkeyPatch, systemd: socket.socket) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", systemd.getsockname())
    notifier = Notifier.from_environment()
    assert "NOTIFY_SOCKET" not in os.environ
    notifier.send(READY="1")
    assert systemd.recv(100) == b"READY=1"
    notifier.close()
