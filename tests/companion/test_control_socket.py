import json
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control_socket import MAX_CLIENTS, MAX_LINE, ControlSocket, ask, command_of
from companion.errors import UsageError
from companion.types import Deselect, Disengage, Engage, OperatorCommand, Select
from mscf import Box

STATUS = {"mode": "idle"}


@pytest.fixture
def control(tmp_path: Path) -> Iterator[ControlSocket]:
    control = ControlSocket(tmp_path / "control.sock")
    yield control
    control.close()


@pytest.fixture
def connect(tmp_path: Path) -> Iterator[Callable[[], socket.socket]]:
    ends: list[socket.socket] = []

    def make() -> socket.socket:
        end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        end.settimeout(5.0)
        end.connect(str(tmp_path / "control.sock"))
        ends.append(end)
        return end

    yield make
    for end in ends:
        end.close()


def answer_to(end: socket.socket) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(end.makefile("rb").readline())
    return answer


@pytest.mark.parametrize(
    ("request_", "command"),
    [
        ({"do": "status"}, None),
        ({"do": "select"}, Select(None)),
        ({"do": "select", "box": [1, 2.5, 30, 40]}, Select(Box(1, 2.5, 30, 40))),
        ({"do": "deselect"}, Deselect()),
        ({"do": "engage"}, Engage()),
        ({"do": "disengage"}, Disengage()),
    ],
)
def test_each_request_has_its_command(request_: dict[str, Any], command: OperatorCommand | None) -> None:
    assert command_of(request_) == command


@pytest.mark.parametrize(
    "request_",
    [
        None,
        [],
        "engage",
        {},
        {"do": "fly"},
        {"do": ["engage"]},
        {"do": "select", "box": [1, 2, 3]},
        {"do": "select", "box": [1, 2, 3, 0]},
        {"do": "select", "box": [1, 2, -3, 4]},
        {"do": "select", "box": [1, 2, float("nan"), 4]},
        {"do": "select", "box": [1, 2, True, 4]},
        {"do": "select", "box": [1, 2, 10**400, 4]},
        {"do": "select", "box": "1,2,3,4"},
    ],
)
def test_what_is_no_request_is_refused_in_one_line(request_: object) -> None:
    with pytest.raises(UsageError) as refusal:
        command_of(request_)
    assert "\n" not in str(refusal.value)


def test_an_order_is_answered_with_the_status_after_the_step(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    end = connect()
    end.sendall(b'{"do": "engage"}\n')
    assert control.poll() == (Engage(),)
    assert control.is_asked
    control.answer(STATUS, dict)
    assert answer_to(end) == STATUS
    assert not control.is_asked


def test_who_asks_for_the_timing_gets_it_with_the_status(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    plain, curious = connect(), connect()
    plain.sendall(b'{"do": "status"}\n')
    curious.sendall(b'{"do": "timing"}\n')
    assert control.poll() == ()
    control.answer(STATUS, lambda: {"overruns": 3.0})
    assert answer_to(plain) == STATUS
    assert answer_to(curious) == {**STATUS, "timing": {"overruns": 3.0}}


def test_a_request_may_come_in_pieces_and_several_at_once(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    end = connect()
    end.sendall(b'{"do": "dese')
    assert control.poll() == ()
    end.sendall(b'lect"}\n{"do": "disengage"}\n')
    assert control.poll() == (Deselect(), Disengage())


def test_a_wrong_request_is_answered_and_the_next_one_obeyed(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    end = connect()
    end.sendall(b'not json\n{"do": "fly"}\n{"do": "engage"}\n')
    assert control.poll() == (Engage(),)
    lines = end.makefile("rb")
    assert "error" in json.loads(lines.readline())
    assert "unknown request 'fly'" in json.loads(lines.readline())["error"]


def test_a_line_without_end_closes_the_connection(control: ControlSocket, connect: Callable[[], socket.socket]) -> None:
    end = connect()
    end.sendall(b"x" * (2 * MAX_LINE))
    for _ in range(4):
        assert control.poll() == ()
    assert "at most" in answer_to(end)["error"]


def test_a_client_that_leaves_is_forgotten(control: ControlSocket, connect: Callable[[], socket.socket]) -> None:
    for _ in range(3 * MAX_CLIENTS):
        end = connect()
        end.sendall(b'{"do": "status"}\n')
        control.poll()
        end.close()
        control.answer(STATUS, dict)
        control.poll()
    end = connect()
    end.sendall(b'{"do": "engage"}\n')
    assert control.poll() == (Engage(),)


def test_where_there_is_no_room_the_client_that_was_silent_for_longest_makes_some(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    ends = [connect() for _ in range(MAX_CLIENTS)]
    control.poll()
    ends[0].sendall(b'{"do": "status"}\n')
    control.poll()
    late = connect()
    late.sendall(b'{"do": "disengage"}\n')
    assert control.poll() == (Disengage(),)
    assert ends[1].recv(10) == b""
    for end in (ends[0], *ends[2:]):
        end.sendall(b'{"do": "engage"}\n')
    assert control.poll() == (Engage(),) * (MAX_CLIENTS - 1)


def test_an_order_that_was_written_before_the_crowd_came_is_heard(
    control: ControlSocket, connect: Callable[[], socket.socket]
) -> None:
    first = connect()
    control.poll()
    first.sendall(b'{"do": "disengage"}\n')
    for _ in range(MAX_CLIENTS):
        connect()
    assert control.poll() == (Disengage(),)


@given(st.lists(st.binary(max_size=200), max_size=8))
def test_no_bytes_make_it_raise(tmp_path_factory: pytest.TempPathFactory, chunks: list[bytes]) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "c.sock"
    control = ControlSocket(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as end:
        end.connect(str(path))
        for chunk in chunks:
            end.sendall(chunk)
            for command in control.poll():
                assert isinstance(command, Select | Deselect | Engage | Disengage)
        control.answer(STATUS, dict)
    control.close()


@pytest.mark.usefixtures("control")
def test_only_owner_and_group_may_connect(tmp_path: Path) -> None:
    assert stat.S_IMODE((tmp_path / "control.sock").stat().st_mode) == 0o660


def test_the_path_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as killed:
        killed.bind(str(path))
    ControlSocket(path).close()
    assert not path.exists()


@pytest.mark.usefixtures("control")
def test_the_path_of_a_running_process_is_not_taken_over(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="in use"):
        ControlSocket(tmp_path / "control.sock")


def test_a_file_that_is_no_socket_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(OSError, match="in use"):
        ControlSocket(path)
    assert path.read_text() == "mine"


def test_ask_returns_the_answer(tmp_path: Path, control: ControlSocket) -> None:
    answers: list[dict[str, Any]] = []
    asker = threading.Thread(target=lambda: answers.append(ask(tmp_path / "control.sock", {"do": "status"})))
    asker.start()
    while asker.is_alive():
        control.poll()
        control.answer(STATUS, dict)
    asker.join()
    assert answers == [STATUS]


def test_ask_says_when_nobody_is_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is mscf-companion running"):
        ask(tmp_path / "nobody.sock", {"do": "status"})
