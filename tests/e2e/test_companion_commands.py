"""The command `mscf-companion` as processes of its own, on the ground: what it says, and with which status it ends."""

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from sitl import Sitl

from companion.control_socket import ask
from companion.frame_stream import packed_header
from sim.camera import observe
from sim.realtime import fake_autopilot
from sim.scenarios import SCENARIOS
from sim.server import CameraServer, RealTime, UdpEnd
from sim.stages import stage

COMPANION = str(Path(sys.executable).with_name("mscf-companion"))
DEADLINE_S = 40.0  # of every wait: far beyond what a busy machine needs
FLIGHT_S = 240.0  # of a short flight with pictures
END_S = 10.0  # in which systemd wants a service to have ended
CAMERA = "[camera]\nwidth_px = 320\nheight_px = 240\nfocal_px = 277\nmount_pitch_deg = -30\n"

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder with a short path, as those of sockets must be."""
    with tempfile.TemporaryDirectory() as path:
        yield Path(path)


@pytest.fixture
def start(folder: Path) -> Iterator[Start]:
    """Starts commands whose errors go to files; what still runs at the end is killed."""
    running: list[subprocess.Popen[str]] = []

    def run(*words: str, **environ: str) -> subprocess.Popen[str]:
        with (folder / "stderr").open("w") as stderr:
            process = subprocess.Popen(
                [COMPANION, *words], stdout=subprocess.PIPE, stderr=stderr, text=True, env=os.environ | environ
            )
        running.append(process)
        return process

    yield run
    for process in running:
        process.kill()
        process.communicate()


def ended(*words: str, limit_s: float = DEADLINE_S, **environ: str) -> subprocess.CompletedProcess[str]:
    command, env = [COMPANION, *words], os.environ | environ
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=limit_s, env=env)


def written(folder: Path, text: str) -> str:
    path = folder / "config.toml"
    path.write_text(f'{CAMERA}{text}\n[control]\nsocket = "{folder / "control.sock"}"\n')
    return str(path)


def until(what: str, is_there: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_there():
        assert time.monotonic() < end_s, f"waited {DEADLINE_S:g} s for {what}"
        time.sleep(0.01)


class Systemd:
    """The other end of $NOTIFY_SOCKET."""

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self.said: list[dict[str, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)

    def hear(self, timeout_s: float) -> dict[str, str]:
        """The next message; empty if none comes in time."""
        self._socket.settimeout(timeout_s)
        try:
            text = self._socket.recv(4096).decode()
        except TimeoutError:
            return {}
        message = dict(line.split("=", 1) for line in text.splitlines())
        self.said.append(message)
        return message

    def until(self, field: str, text: str = "") -> dict[str, str]:
        """Hear until a field is said that contains a text."""
        end_s = time.monotonic() + DEADLINE_S
        while time.monotonic() < end_s:
            message = self.hear(DEADLINE_S)
            if text in message.get(field, "\0"):
                return message
        pytest.fail(f"no {field}={text} in {self.said}")

    def has_said(self, field: str) -> bool:
        return any(field in message for message in self.said)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def systemd(folder: Path) -> Iterator[Systemd]:
    listener = Systemd(folder / "notify")
    yield listener
    listener.close()


# ------------------------------------------------------------------------------------------------ usage
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[follow]\nmode = "folow"', "'spotlight' or 'follow' or 'overhead'"),
        ("[limits]\nsped_mps = 3", "did you mean limits.speed_mps?"),
        ("[follow]\nyaw_gain_per_s = 7.9", "unstable"),
        ("[folow]", "did you mean [follow]?"),
        ("[follow", "not valid TOML"),
    ],
)
def test_a_wrong_configuration_is_one_line_and_78_and_nothing_is_sent(folder: Path, text: str, says: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind(("127.0.0.1", 0))
        link = f'[link]\ndevice = "udpout:127.0.0.1:{autopilot.getsockname()[1]}"\n'
        done = ended("run", "-c", written(folder, link + text))
        autopilot.settimeout(0)
        with pytest.raises(BlockingIOError):
            autopilot.recv(100)
    assert done.returncode == 78
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("key", "says"),
    [('[link]\ndevice = "ttyACM0"', "path of a serial port"), ('[link]\ndevice = "tcp:h"', "HOST:PORT")],
)
def test_a_device_that_is_none_is_a_wrong_configuration(folder: Path, key: str, says: str) -> None:
    done = ended("run", "-c", written(folder, key))
    assert (done.returncode, len(done.stderr.splitlines())) == (78, 1)
    assert says in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["ctl", "status", "--socket", "/nowhere/control.sock"], "is mscf-companion running"),
        (["ctl", "select", "1,2,3"], "not a box"),
        (["ctl", "fly"], "invalid choice: 'fly'"),
        (["sim", "nosuch"], "unknown scenario 'nosuch'"),
        (["sim", "--external", "tcp:127.0.0.1:1", "--autopilot", "px4"], "says itself what it is"),
        (["sim", "sticks", "--external", "tcp:127.0.0.1:1"], "cannot be flown with --external"),
        (["sim", "--arm"], "--arm needs --external"),
        (["fly"], "invalid choice: 'fly'"),
        ([], "COMMAND"),
    ],
)
def test_wrong_usage_is_one_line_and_2(words: list[str], says: str) -> None:
    done = ended(*words)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert says in done.stderr


@pytest.mark.parametrize("vehicle", ["ardupilot", "px4"])
def test_an_example_passes_the_check(folder: Path, vehicle: str) -> None:
    example = ended("example", vehicle)
    assert example.returncode == 0
    path = folder / "config.toml"
    path.write_text(example.stdout)
    done = ended("check", "-c", str(path), "--signs")
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stdout


def test_a_check_without_the_camera_fails(folder: Path) -> None:
    done = ended("check", "-c", written(folder, f'source = "unix:{folder}/none"'), "--camera")
    assert done.returncode == 1
    assert re.search(r"^camera +FAILED: .*none cannot be connected", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["--autopilot", "px4"], "straight-px4"),
        (["--realtime", "--no-video", "--link", "tcp"], "straight-ardupilot-real-time"),
    ],
)
def test_a_flight_in_the_simulator_passes_and_leaves_its_report(tmp_path: Path, words: list[str], name: str) -> None:
    done = ended("sim", "straight", "--duration", "22", "--out", str(tmp_path), *words, limit_s=FLIGHT_S)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "PASSED    straight" in done.stdout
    folder = tmp_path / name
    assert f"page      {folder / 'index.html'}" in done.stdout
    assert {path.name for path in folder.iterdir()} >= {"index.html", "plots.png", "trace.csv", "verdict.json"}
    verdict = json.loads((folder / "verdict.json").read_text())
    assert (verdict["passed"], verdict["scenario"]) == (True, "straight")
    assert len(verdict["checks"]) >= 3
    if "--no-video" in words:
        assert "video" not in done.stdout
        assert "exit_status" in verdict["facts"]
        assert (folder / "application.log").is_file()
    else:
        assert f"video     {folder / 'flight.mp4'}" in done.stdout
        frames = cv2.VideoCapture(str(folder / "flight.mp4"))
        assert frames.get(cv2.CAP_PROP_FRAME_COUNT) == pytest.approx(22 * 20, abs=25)


@pytest.fixture
def px4_device() -> Iterator[str]:
    """A PX4 that somebody has flown up, behind a TCP port, as its SITL is."""
    sitl = Sitl(fake_autopilot(SCENARIOS["straight"], stage("straight", 7), "px4"))
    sitl.start()
    yield sitl.end.device
    sitl.close()


def test_with_a_sitl_in_its_place_the_report_carries_the_autopilots_own_name(px4_device: str, tmp_path: Path) -> None:
    words = ["--external", px4_device, "--duration", "8", "--no-video", "--out", str(tmp_path)]
    done = ended("sim", "straight", *words, limit_s=FLIGHT_S)
    assert "flying straight" in done.stdout
    assert "select OFFBOARD now" in done.stdout  # nobody does: nothing follows, and the checks fail
    assert done.returncode == 1
    assert "FAILED    straight, px4, external" in done.stdout
    assert (tmp_path / "straight-px4-external" / "verdict.json").is_file()


def test_check_reads_what_matters_from_px4_and_advises(px4_device: str, folder: Path) -> None:
    done = ended("check", "-c", written(folder, f'[link]\ndevice = "{px4_device}"'), "--link")
    assert done.returncode == 0, done.stdout
    assert "px4, AUTO.LOITER, armed" in done.stdout
    for line in ("COM_OF_LOSS_T = 1\n", "COM_OBL_RC_ACT = 0\n", "COM_RC_OVERRIDE = 1\n", "ADVICE: COM_OBL_RC_ACT = 0"):
        assert line in done.stdout


# ------------------------------------------------------------------------------------------------ both ends
class Ends(threading.Thread):
    """A camera and an autopilot that are simply there, seen from 14 m above a standing car."""

    def __init__(self, folder: Path) -> None:
        super().__init__(name="ends")
        place = stage("straight", 7)
        camera = replace(place.camera, size_hw=(240, 320), focal_px=277.0)
        self.autopilot = fake_autopilot(SCENARIOS["straight"], place, "ardupilot")
        self.realtime = RealTime(
            replace(place, camera=camera),
            self.autopilot,
            UdpEnd(),
            CameraServer(folder / "frames.sock"),
            world_s_of=lambda _: 0.0,
        )
        self._stop_asked = threading.Event()

    def run(self) -> None:
        self.realtime.start()
        while not self._stop_asked.is_set():
            self.realtime.shoot()

    def close(self) -> None:
        self._stop_asked.set()
        self.join()
        self.realtime.stop()


@pytest.fixture
def ends(folder: Path) -> Iterator[Ends]:
    both = Ends(folder)
    both.start()
    yield both
    both.close()


def test_check_measures_and_ctl_gives_orders(folder: Path, ends: Ends, start: Start) -> None:
    device, source = ends.realtime.end.device, ends.realtime.camera.source
    config = written(folder, f'source = "{source}"\n[link]\ndevice = "{device}"\n[follow]\nmode = "follow"')
    done = ended("check", "-c", config, "--camera", "--link", "--signs")
    assert done.returncode == 0, done.stdout
    measured = re.search(r"320 x 240 px, ([\d.]+) frames/s", done.stdout)
    assert measured is not None
    assert 10 < float(measured[1]) < 31
    assert "ardupilot, GUIDED, armed" in done.stdout
    attitudes = re.search(r"attitude (\d+)", done.stdout)
    assert attitudes is not None
    assert 20 < int(attitudes[1]) < 70  # asked for: unasked it sends 4
    assert "GUID_TIMEOUT = 3\n" in done.stdout
    assert "ADVICE: GUID_TIMEOUT = 3" in done.stdout
    signs = dict(re.findall(r"target (\w+) +-> (.*)", done.stdout))
    assert [*signs] == ["left", "right", "above", "below", "near", "far"]
    assert "turn left" in signs["left"]
    assert "turn right" in signs["right"]
    assert "back" in signs["near"]
    assert "forward" in signs["far"]

    path = folder / "control.sock"

    def ctl(*words: str) -> str:
        done = ended("ctl", *words, "--socket", str(path))
        assert done.returncode == 0, done.stderr
        return done.stdout

    running = start("run", "-c", config)
    until("the control socket", path.exists)
    # the armed autopilot is known, with the height and the picture that an engagement needs
    until("telemetry", lambda: ask(path, {"do": "status"})["height_m"] is not None)
    assert "ardupilot, GUIDED, armed True" in ctl("status")
    assert re.match(r"mode +idle\n", ctl("status"))
    assert "Engage refused: no target" in ctl("engage")
    place = ends.realtime.stage
    box = observe(place.world, place.camera, place.start, 0.0).box
    assert box is not None
    ctl("select", f"{box.x},{box.y},{box.w},{box.h}")
    until("the target", lambda: ask(path, {"do": "status"})["mode"] == "tracking")
    until("following", lambda: "following" in ctl("engage").splitlines()[0])
    assert '"mode": "following"' in ctl("status", "--json")
    assert "Follow ended: operator" in ctl("disengage")
    until("the brake", lambda: ends.autopilot.mode_name == "BRAKE")

    running.send_signal(signal.SIGINT)
    assert running.wait(END_S) == 0  # an end that was asked for, by whichever signal
    log = (folder / "stderr").read_text()
    assert "SIGINT: ending" in log
    assert re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} INFO ", log)
    assert "Traceback" not in log


def test_a_video_ends_the_run_well_and_the_journal_gets_priorities(folder: Path) -> None:
    video = cv2.VideoWriter(str(folder / "flight.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (320, 240))
    rng = np.random.default_rng(1)
    for _ in range(10):
        video.write(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8))
    video.release()
    config = written(folder, f'source = "{folder / "flight.mp4"}"\n[link]\ndevice = "{folder / "port"}"')
    done = ended("run", "-c", config, JOURNAL_STREAM="8:1")
    assert done.returncode == 0
    lines = done.stderr.splitlines()
    assert all(re.match(r"<[2-7]>\D", line) for line in lines)
    assert any(line.startswith("<4>link: ") for line in lines)
    assert lines[-1] == f"<6>{folder / 'flight.mp4'} has ended"


# ------------------------------------------------------------------------------------------------ sd_notify
def test_ready_waits_for_the_port_and_neither_camera_nor_autopilot_for_the_watchdog(
    folder: Path, start: Start, systemd: Systemd
) -> None:
    port = folder / "port"
    config = written(folder, f'source = "unix:{folder}/none"\n[link]\ndevice = "{port}"')
    running = start("run", "-c", config, NOTIFY_SOCKET=systemd.address)
    for _ in range(2):
        waiting = systemd.until("EXTEND_TIMEOUT_USEC")
        assert int(waiting["EXTEND_TIMEOUT_USEC"]) > 5_000_000
        assert f"waiting: link: {port} cannot be opened" in waiting["STATUS"]
    assert not systemd.has_said("READY")
    assert not systemd.has_said("WATCHDOG")

    master, slave = os.openpty()
    port.symlink_to(os.ttyname(slave))
    systemd.until("READY")
    status = systemd.until("STATUS", "idle")["STATUS"]
    assert re.match(r"idle, 0 frames/s, frame age none; no autopilot heard; camera: unix:.*none", status)
    for _ in range(4):
        systemd.until("WATCHDOG")

    running.terminate()
    systemd.until("STOPPING")
    assert running.wait(END_S) == 0
    os.close(master)
    os.close(slave)


def test_a_stuck_thread_ends_the_watchdog_but_does_not_keep_the_process_from_ending(
    folder: Path, start: Start, systemd: Systemd
) -> None:
    images = folder / "images"
    images.mkdir()
    os.mkfifo(images / "0.png")  # reading it waits until somebody writes
    config = written(folder, f'source = "{images}"\n[link]\ndevice = "udpin:127.0.0.1:0"'.replace(":0", f":{port()}"))
    running = start("run", "-c", config, NOTIFY_SOCKET=systemd.address)
    systemd.until("WATCHDOG")
    said_s = time.monotonic()
    end_s = said_s + DEADLINE_S
    while time.monotonic() < said_s + 2.5:
        if "WATCHDOG" in systemd.hear(0.5):
            said_s = time.monotonic()
        assert said_s < end_s, "it is stuck, and says that all is well"
    assert "mode" in ask(folder / "control.sock", {"do": "status"})  # the command loop goes on

    running.terminate()
    systemd.until("STOPPING")
    assert running.wait(END_S) == 0


def test_a_thread_that_dies_ends_the_process(folder: Path, start: Start, systemd: Systemd) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as camera:
        camera.bind(str(folder / "frames.sock"))
        camera.listen(1)
        camera.settimeout(DEADLINE_S)
        config = written(folder, f'source = "unix:{folder}/frames.sock"\n[link]\ndevice = "udpin:127.0.0.1:{port()}"')
        running = start("run", "-c", config, NOTIFY_SOCKET=systemd.address)
        connection, _ = camera.accept()
        with connection:
            systemd.until("READY")
            pages = int(Path(f"/proc/{running.pid}/statm").read_text().split()[0])
            most = pages * resource.getpagesize() + 64 * 2**20
            resource.prlimit(running.pid, resource.RLIMIT_AS, (most, most))
            connection.sendall(packed_header((8192, 8192), 1.0))  # for which there is no memory
            assert running.wait(END_S) == 1
    log = (folder / "stderr").read_text()
    assert "MemoryError" in log.splitlines()[-1]


def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
