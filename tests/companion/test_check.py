import re
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from io import BytesIO, StringIO
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion import check
from companion.check import check_camera, check_link, check_record, print_signs
from companion.config import parse
from companion.frame_stream import packed_header

CAMERA = "[camera]\nwidth_px = 64\nheight_px = 48\nfocal_px = 60\nmount_pitch_deg = -30\n"
SHORT_S = 0.3  # instead of seconds, where a test waits for as long as the check looks


@pytest.fixture
def out(monkeypatch: pytest.MonkeyPatch) -> StringIO:
    """What the check prints; it looks for a short time only."""
    for name in ("CAMERA_S", "CAMERA_WAIT_S", "LINK_S", "LINK_WAIT_S"):
        monkeypatch.setattr(check, name, SHORT_S)
    return StringIO()


@pytest.fixture
def serve() -> Iterator[Callable[[socket.socket, Callable[[socket.socket], None]], None]]:
    """Accepts one client on a listener and sends it something until it leaves."""
    threads: list[threading.Thread] = []

    def start(listener: socket.socket, send: Callable[[socket.socket], None]) -> None:
        def run() -> None:
            with listener, listener.accept()[0] as connection:
                try:
                    while True:
                        send(connection)
                except OSError:  # it has left
                    return

        listener.settimeout(10.0)
        threads.append(threading.Thread(target=run))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join()


# ------------------------------------------------------------------------------------------------ the camera
@pytest.mark.parametrize(
    ("size", "is_right", "warns"), [((64, 48), True, False), ((128, 96), True, True), ((128, 128), False, True)]
)
def test_a_picture_of_another_size_is_said_and_one_of_another_shape_is_wrong(
    tmp_path: Path, out: StringIO, size: tuple[int, int], *, is_right: bool, warns: bool
) -> None:
    for index in range(5):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((48, 64, 3), index, np.uint8))
    text = f'width_px = {size[0]}\nheight_px = {size[1]}\nfocal_px = 60\nsource = "{tmp_path}"\npace = "fast"'
    assert check_camera(parse("[camera]\n" + text), out) is is_right
    assert "64 x 48 px" in out.getvalue()
    assert ("WARNING: camera.width_px" in out.getvalue()) is warns


@pytest.mark.parametrize("stamp", ["now", "wall", "boot", "constant"])
def test_only_stamps_of_the_monotonic_clock_are_right(
    out: StringIO, serve: Callable[[socket.socket, Callable[[socket.socket], None]], None], stamp: str
) -> None:
    since = count()
    stamps: dict[str, Callable[[], float]] = {
        "now": time.monotonic,
        "wall": time.time,  # ahead by decades: a check that waits for those stamps to pass never ends
        "boot": lambda: 1.0 + next(since) / 30,
        "constant": lambda: 1e-9,
    }
    body = bytes(48 * 64 * 3)
    with tempfile.TemporaryDirectory() as folder:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(f"{folder}/frames")
        listener.listen(1)
        serve(listener, lambda reader: reader.sendall(packed_header((48, 64), stamps[stamp]()) + body))
        is_right = check_camera(parse(f'{CAMERA}source = "unix:{folder}/frames"'), out)
    assert is_right is (stamp == "now")
    assert ("CLOCK_MONOTONIC" in out.getvalue()) is (stamp != "now")


def test_a_camera_that_is_missing_or_gives_one_picture_is_one_line(tmp_path: Path, out: StringIO) -> None:
    assert not check_camera(parse(f'{CAMERA}source = "unix:{tmp_path}/none"'), out)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((48, 64, 3), np.uint8))
    assert not check_camera(parse(f'{CAMERA}source = "{tmp_path}"'), out)
    lines = out.getvalue().splitlines()
    assert [line[:17] for line in lines] == ["camera    FAILED:"] * 2
    assert "gave 1 frames" in lines[1]


# ------------------------------------------------------------------------------------------------ the record
def test_a_record_that_can_be_written_is_said_with_its_folder_and_nothing_is_left_of_the_trial(
    tmp_path: Path, out: StringIO
) -> None:
    config = parse(f'{CAMERA}[record]\nfolder = "{tmp_path}/flights"\nmin_free_mb = 1\n')
    assert check_record(config, {}, out)
    assert re.fullmatch(rf"record    {tmp_path}/flights: can be written, \d+ MB free\n", out.getvalue())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_who_asks_is_said_not_to_be_the_services(tmp_path: Path, out: StringIO) -> None:
    config = parse(f"{CAMERA}[record]\nmin_free_mb = 1\n")
    assert check_record(config, {"XDG_STATE_HOME": str(tmp_path)}, out)
    assert out.getvalue().splitlines()[1:] == ["          of who runs this; the service has a folder of its own"]
    out.truncate(0)
    assert check_record(config, {"STATE_DIRECTORY": str(tmp_path)}, out)
    assert "the service" not in out.getvalue()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ('folder = "{}/taken/flights"', "cannot be made or written: Not a directory; set record.folder"),
        ('folder = "{}"\nmin_free_mb = 1e6', "MB free, record.min_free_mb = 1e+06: free some, or set it lower"),
    ],
)
def test_a_record_that_would_not_be_written_is_one_line(
    tmp_path: Path, out: StringIO, settings: str, said: str
) -> None:
    (tmp_path / "taken").write_text("mine")
    assert not check_record(parse(f"{CAMERA}[record]\n{settings.format(tmp_path)}\n"), {}, out)
    (line,) = out.getvalue().splitlines()
    assert line.startswith(f"record    FAILED: {tmp_path}")
    assert line.endswith(said)


@pytest.mark.parametrize(("video", "warns"), [("overlay", True), ("plain", True), ("none", False)])
def test_a_film_that_cannot_be_encoded_is_said_where_one_is_wanted(
    tmp_path: Path, out: StringIO, monkeypatch: pytest.MonkeyPatch, video: str, *, warns: bool
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    config = parse(f'{CAMERA}[record]\nfolder = "{tmp_path}"\nmin_free_mb = 1\nvideo = "{video}"\n')
    assert check_record(config, {}, out)
    wanted = f'          WARNING: no film: record.video = "{video}" needs PyAV: pip install av, or set "none"'
    assert out.getvalue().splitlines()[1:] == [wanted] * warns


def test_where_nothing_is_recorded_nothing_is_tried(out: StringIO) -> None:
    config = parse(f'{CAMERA}[record]\nenabled = false\nfolder = "/dev/null/flights"\n')
    assert check_record(config, {}, out)
    assert out.getvalue() == "record    none: record.enabled = false\n"


# ------------------------------------------------------------------------------------------------ the link
def test_a_link_that_is_missing_or_silent_is_one_line(tmp_path: Path, out: StringIO) -> None:
    assert not check_link(parse(f'{CAMERA}[link]\ndevice = "{tmp_path}/none"'), out)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        assert not check_link(parse(f'{CAMERA}[link]\ndevice = "tcp:127.0.0.1:{port}"'), out)
    lines = out.getvalue().splitlines()
    assert [line[:17] for line in lines] == ["link      FAILED:"] * 2
    assert "no autopilot was heard" in lines[1]


@pytest.mark.parametrize(("kind", "is_right"), [("QUADROTOR", True), ("FIXED_WING", False)])
def test_only_a_multicopter_is_right(
    out: StringIO,
    serve: Callable[[socket.socket, Callable[[socket.socket], None]], None],
    kind: str,
    *,
    is_right: bool,
) -> None:
    heartbeat = mavlink.MAVLink_heartbeat_message(getattr(mavlink, f"MAV_TYPE_{kind}"), 3, 1, 4, 3, 3)
    data = heartbeat.pack(mavlink.MAVLink(BytesIO(), 1, 1))
    listener = socket.create_server(("127.0.0.1", 0))
    serve(listener, lambda reader: reader.sendall(data))
    assert check_link(parse(f'{CAMERA}[link]\ndevice = "tcp:127.0.0.1:{listener.getsockname()[1]}"'), out) is is_right
    assert ("not a multicopter" in out.getvalue()) is not is_right
    assert "GUID_TIMEOUT = no answer" in out.getvalue()


# ------------------------------------------------------------------------------------------------ the signs
SIGNS = {
    "spotlight": ("turn left", "turn right", "stand", "stand", "stand", "stand"),
    "follow": ("turn left", "turn right", "forward", "back", "back", "forward"),
    "overhead": ("left", "right", "forward", "back", "stand", "stand"),
}


@pytest.mark.parametrize("axes", ["none", "pitch_yaw"])
@pytest.mark.parametrize("mode", SIGNS)
def test_the_signs_are_those_of_the_flight_controller(mode: str, axes: str) -> None:
    out = StringIO()
    pitch = "-90" if mode == "overhead" else "-30"
    camera = f"[camera]\nwidth_px = 640\nheight_px = 480\nfocal_px = 600\nmount_pitch_deg = {pitch}\n"
    print_signs(parse(f'{camera}[follow]\nmode = "{mode}"\n[gimbal]\naxes = "{axes}"'), out)
    lines = out.getvalue().splitlines()[1:]
    assert [line.split()[1] for line in lines] == ["left", "right", "above", "below", "near", "far"]
    for line, wanted in zip(lines, SIGNS[mode], strict=True):
        assert wanted in line.partition("-> ")[2], line
