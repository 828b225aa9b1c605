import signal
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from companion.app import MAX_BEAT_AGE_S, App
from companion.config import parse
from companion.controller import Controller
from companion.flight_record import CONTROL, VIDEO, Farewell, read_control
from companion.follower import StepError
from companion.notify import Notifier
from companion.replay import replay
from companion.types import Frame, Selection, TrackSample

CAMERA = "[camera]\nwidth_px = 64\nheight_px = 48\nfocal_px = 60\n"


class Systemd:
    """The other end of $NOTIFY_SOCKET."""

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._socket.settimeout(0)

    def said(self) -> dict[str, str]:
        """All fields since the last call."""
        fields: dict[str, str] = {}
        try:
            while True:
                fields |= dict(line.split("=", 1) for line in self._socket.recv(4096).decode().splitlines())
        except BlockingIOError:
            return fields

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    listener = Systemd(tmp_path / "notify")
    yield listener
    listener.close()


@pytest.fixture
def make(systemd: Systemd, tmp_path: Path) -> Iterator[Callable[[str], App]]:
    """Makes applications whose threads do not run: the test is the clock, the camera and the tracker."""
    made: list[App] = []

    def build(text: str) -> App:
        record = f'[record]\nfolder = "{tmp_path / "flights"}"\nmin_free_mb = 1\n'
        made.append(App(parse(CAMERA + text + record), Notifier(systemd.address), None))
        return made[-1]

    yield build
    for app in made:
        app._end()


def udp() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f'[link]\ndevice = "udpin:127.0.0.1:{probe.getsockname()[1]}"\n'


def beat(app: App, now_s: float, *threads: str) -> None:
    for name in threads:
        getattr(app, f"_{name}").beat.put(now_s)


@pytest.mark.parametrize("stuck", [(), ("capture",), ("vision",), ("capture", "vision")])
def test_the_watchdog_is_fed_only_while_every_thread_gets_round(
    make: Callable[[str], App], systemd: Systemd, stuck: tuple[str, ...]
) -> None:
    app = make(udp())
    beat(app, 100.0, "capture", "vision")
    app._step(100.0)
    assert "WATCHDOG" in systemd.said()
    for second in range(1, 6):
        now_s = 100.0 + second
        beat(app, now_s, *({"capture", "vision"} - {*stuck}))
        app._step(now_s)
        assert ("WATCHDOG" in systemd.said()) is (not stuck or second <= MAX_BEAT_AGE_S), second


def test_ready_is_said_once_and_with_the_port_open(
    make: Callable[[str], App], systemd: Systemd, tmp_path: Path
) -> None:
    app = make(f'[link]\ndevice = "{tmp_path}/port"\n')
    for second in range(3):
        app._step(100.0 + second)
        said = systemd.said()
        assert {"EXTEND_TIMEOUT_USEC", "STATUS"} == set(said)
    app = make(udp())
    app._step(100.0)
    assert systemd.said()["READY"] == "1"
    app._step(101.0)
    assert "READY" not in systemd.said()


def test_what_is_missing_is_said_and_is_no_reason_to_starve_the_watchdog(
    make: Callable[[str], App], systemd: Systemd
) -> None:
    app = make(udp())
    app._capture.fault.put("/dev/video0 does not exist")
    app._step(100.0)
    said = systemd.said()
    assert said["STATUS"] == (
        "idle, 0 frames/s, frame age none; no autopilot heard; camera: /dev/video0 does not exist"
    )
    assert "WATCHDOG" in said


class Broken:
    """Sees nothing and dies of it, as no part of the tracker is expected to."""

    def see(self, frame: Frame, selection: Selection, expected_xy: object) -> TrackSample:
        raise SystemError(f"out of order at frame {frame.seq}")


@pytest.fixture
def process() -> Iterator[None]:
    """What `App.run` changes of the process is as it was again."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    interval_s = sys.getswitchinterval()
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)
    sys.setswitchinterval(interval_s)


@pytest.fixture
def filmed(tmp_path: Path) -> str:
    """A camera that films a file, slowly enough for a thread to die before its end."""
    (tmp_path / "images").mkdir()
    for index in range(30):
        cv2.imwrite(str(tmp_path / "images" / f"{index}.png"), np.full((48, 64, 3), index, np.uint8))
    return f'source = "{tmp_path / "images"}"\n' + udp()


@pytest.mark.usefixtures("process")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # it is raised there as well
def test_what_kills_a_thread_is_raised_by_the_run(make: Callable[[str], App], filmed: str, systemd: Systemd) -> None:
    app = make(filmed)
    app._vision._vision = Broken()  # type: ignore[assignment]
    with pytest.raises(SystemError, match="out of order at frame"):
        app.run()
    assert not app._vision.is_alive()
    assert not app._capture.is_alive()
    assert systemd.said()["STOPPING"] == "1"


@pytest.mark.usefixtures("process")
def test_the_end_of_a_file_is_the_end_of_the_run(make: Callable[[str], App], filmed: str) -> None:
    app = make(filmed)
    assert app.run() == 0
    assert app._samples.value is not None


def recorded(tmp_path: Path) -> Path:
    """The one record that a run has left."""
    (folder,) = (tmp_path / "flights").iterdir()
    return folder


@pytest.mark.usefixtures("process")
def test_a_run_leaves_a_record_that_decides_again_as_it_did(
    make: Callable[[str], App], filmed: str, tmp_path: Path
) -> None:
    app = make(filmed + '[select]\nat_start = "centre"\ncentre_share = 0.3\n')
    assert app.run() == 0
    result = replay(recorded(tmp_path))
    assert result.difference is None
    assert result.steps > 10
    lines = (recorded(tmp_path) / CONTROL).read_text().splitlines()
    assert '"is":"Select"' in "".join(lines)
    assert lines[-1].startswith('{"farewell":')
    with av.open(str(recorded(tmp_path) / VIDEO)) as container:
        assert sum(1 for _ in container.decode(video=0)) > 5


@pytest.mark.usefixtures("process")
def test_a_controller_that_raises_ends_the_run_and_its_step_and_the_last_words_are_in_the_record(
    make: Callable[[str], App], filmed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count()

    def broken(*_: object) -> None:
        if next(calls) % 6 == 5:
            raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(Controller, "_ladder", broken)
    with pytest.raises(StepError, match="ZeroDivisionError: a mistake"):
        make(filmed).run()
    result = replay(recorded(tmp_path))
    assert (result.steps, result.difference, result.raised) == (6, None, "ZeroDivisionError: a mistake")
    assert result.is_whole


@pytest.mark.usefixtures("process")
def test_last_words_that_fail_are_logged_and_the_port_is_flushed_and_the_record_ended(
    make: Callable[[str], App],
    filmed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(Controller, "shut_down", broken)
    app = make(filmed)
    flushed: list[bytes] = []
    monkeypatch.setattr(app._link, "flush", lambda data, _: flushed.append(data))
    assert app.run() == 0
    assert flushed == [b""]
    assert caplog.messages.count("no last words") == 1
    *_, last = read_control(recorded(tmp_path))
    assert isinstance(last, Farewell)
    assert last.message_ids == ()
    assert not app._capture.is_alive()


@pytest.mark.usefixtures("process")
def test_without_a_place_for_the_record_the_run_goes_on_and_the_operator_is_told(
    make: Callable[[str], App], filmed: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "flights").write_text("a file")
    app = make(filmed)
    assert app.run() == 0
    assert caplog.messages.count("Record stopped: record.folder is no folder") == 1
    assert app._samples.value is not None


@pytest.mark.usefixtures("process")
def test_a_recorder_that_dies_does_not_end_the_run(
    make: Callable[[str], App], filmed: str, caplog: pytest.LogCaptureFixture
) -> None:
    app = make(filmed)
    assert app._recorder is not None
    app._recorder._steps._taken = None  # type: ignore[assignment]
    assert app.run() == 0
    assert caplog.messages.count("Record stopped: TypeError") == 1


@pytest.mark.usefixtures("process")
def test_where_nothing_is_to_be_recorded_nothing_is(make: Callable[[str], App], filmed: str, tmp_path: Path) -> None:
    app = make(filmed)
    app = App(replace(app._config, record=replace(app._config.record, enabled=False)), Notifier(None), None)
    assert app.run() == 0
    assert not (tmp_path / "flights").exists()
    assert app._record_status() == {"record": None, "record_steps_dropped": 0, "record_frames_dropped": 0}


def test_the_status_tells_the_record_while_there_is_one(make: Callable[[str], App], tmp_path: Path) -> None:
    app = make(udp())
    step = app._follower.step(100.0, b"", None)
    assert app._status(step, None, 100.0)["record"] is None
    recorder = app._recorder
    assert recorder is not None
    assert recorder._video is not None
    recorder._steps.folder = tmp_path / "flights" / "x"
    recorder._steps.dropped, recorder._video.dropped = 2, 3
    status = app._status(step, None, 100.0)
    assert status["record"] == str(tmp_path / "flights" / "x")
    assert (status["record_steps_dropped"], status["record_frames_dropped"]) == (2, 3)
