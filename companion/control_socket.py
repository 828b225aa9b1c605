"""The local control socket: an operator's orders and questions, a JSON object a line each way.

Requests: {"do": "status"}, {"do": "select", "box": [x, y, w, h]} (without a box: the middle), {"do": "deselect"},
{"do": "engage"}, {"do": "disengage"}, {"do": "timing"} (the status with latency and punctuality). Every answer is
the status after the step that took the order, with what the operator was told in it ("texts"), or {"error": "..."}.
Nothing here blocks, and no client can make it raise.
"""

import json
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.errors import UsageError
from companion.types import Deselect, Disengage, Engage, OperatorCommand, Select
from mscf import Box

MAX_LINE = 4096  # bytes
MAX_CLIENTS = 8
MAX_PX = 1e6  # of a box; JSON carries numbers that no float holds
MODE = 0o660

_ORDERS: dict[str, OperatorCommand] = {"deselect": Deselect(), "engage": Engage(), "disengage": Disengage()}
ORDER_NAMES = ("status", "timing", "select", *_ORDERS)


def command_of(request: object) -> OperatorCommand | None:
    """What a request orders; None where it only asks for the status.

    Raises
    ------
    UsageError
        If it is no request; the text says what one looks like.
    """
    order = request.get("do") if isinstance(request, dict) else None
    if order in ("status", "timing"):
        return None
    if order == "select" and isinstance(request, dict):
        box = request.get("box")
        if box is None:
            return Select(None)
        is_box = isinstance(box, list) and len(box) == 4 and all(_is_number(value) for value in box)
        if not is_box or min(box[2:]) <= 0:
            raise UsageError(f"box = {box!r} must be [x, y, w, h] in pixels, w and h above 0")
        return Select(Box(*map(float, box)))
    if isinstance(order, str) and order in _ORDERS:
        return _ORDERS[order]
    raise UsageError(f"unknown request {order!r}: give do = {', '.join(ORDER_NAMES)}")


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < MAX_PX  # which no NaN is


@dataclass(slots=True, eq=False)
class _Client:
    connection: socket.socket
    received: bytes = b""
    is_asking: bool = False  # an answer is due after the next step
    wants_timing: bool = False  # in it


class ControlSocket:
    """Listens on a path; polled by the command loop."""

    def __init__(self, path: Path) -> None:
        """Listen.

        Raises
        ------
        OSError
            If the path cannot be used, or another process listens there.
        """
        self._path = path
        self._clients: list[_Client] = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _remove_stale(path)
            self._listener.bind(str(path))
            path.chmod(MODE)
            self._listener.listen(MAX_CLIENTS)
            self._listener.settimeout(0)
        except OSError:
            self._listener.close()
            raise

    def poll(self) -> tuple[OperatorCommand, ...]:
        """Orders that have come in; a wrong request is answered at once."""
        commands: list[OperatorCommand] = []
        for client in list(self._clients):
            commands += self._orders(client)
        while (newcomer := self._accepted()) is not None:
            commands += self._orders(newcomer)
        return tuple(commands)

    def _orders(self, client: _Client) -> list[OperatorCommand]:
        commands: list[OperatorCommand] = []
        for line in self._lines(client):
            try:
                request = json.loads(line)
                command = command_of(request)
            except (ValueError, RecursionError) as error:  # JSON's and ours
                self._send(client, {"error": str(error)})
                continue
            client.is_asking, client.wants_timing = True, request["do"] == "timing"
            if command is not None:
                commands.append(command)
        return commands

    def answer(self, status: dict[str, Any], timing: Callable[[], dict[str, float]]) -> None:
        """Answer all who asked since the last step; `timing` is called for who wants it: it takes a while."""
        for client in [client for client in self._clients if client.is_asking]:
            client.is_asking = False
            self._send(client, {**status, "timing": timing()} if client.wants_timing else status)

    @property
    def is_asked(self) -> bool:
        """Whether somebody waits for an answer."""
        return any(client.is_asking for client in self._clients)

    def close(self) -> None:
        """Close all, and remove the path."""
        for client in self._clients:
            client.connection.close()
        self._clients.clear()
        self._listener.close()
        self._path.unlink(missing_ok=True)

    def _accepted(self) -> _Client | None:
        """Who has connected, one at a time."""
        try:
            connection, _ = self._listener.accept()
        except OSError:  # nobody there, or no descriptor left: later
            return None
        if len(self._clients) >= MAX_CLIENTS:
            # who has been silent for longest: `disengage` must always get through
            self._drop(self._clients[0])
        connection.settimeout(0)
        self._clients.append(_Client(connection))
        return self._clients[-1]

    def _lines(self, client: _Client) -> list[bytes]:
        try:
            data = client.connection.recv(MAX_LINE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return []
        self._clients.remove(client)
        self._clients.append(client)  # the last one is the latest to have spoken
        *lines, client.received = (client.received + data).split(b"\n")
        if len(client.received) > MAX_LINE:
            self._send(client, {"error": f"a request must be a line of at most {MAX_LINE} bytes"})
            self._drop(client)
        return lines

    def _send(self, client: _Client, message: dict[str, Any]) -> None:
        try:
            client.connection.send(json.dumps(message).encode() + b"\n")
        except OSError:  # gone, or so slow that its buffer is full
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            client.connection.close()


def _remove_stale(path: Path) -> None:
    """Remove a socket that a killed process has left; one that is listened on stays, and `bind` fails."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            path.unlink(missing_ok=True)
        except OSError:
            return


def ask(path: Path, request: dict[str, Any], timeout_s: float = 3.0) -> dict[str, Any]:
    """Send a request to a running application and return its answer.

    Raises
    ------
    UsageError
        If nobody listens there, or no answer comes in time.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as answers:
                line = answers.readline()
    except OSError as error:
        raise UsageError(
            f"no answer from {path}: {error.strerror or error}; is mscf-companion running, with this control.socket?"
        ) from error
    if not line:
        raise UsageError(f"{path} closed the connection without an answer")
    answer: dict[str, Any] = json.loads(line)
    return answer
