import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from companion.errors import CameraLostError
from companion.frame_stream import frames
from companion.link import Link
from sim.ardupilot import ArduCopter
from sim.autopilot import FakeAutopilot, Start
from sim.server import KINDS, CameraServer, End, RealTime, UdpEnd, open_end
from sim.stages import stage

DEADLINE_S = 20.0


def until(what: str, is_there: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_there():
        assert time.monotonic() < end_s, f"waited {DEADLINE_S:g} s for {what}"


def arrived(read: Callable[[], bytes], wanted: bytes) -> bool:
    """Read until all of it has come; the loopback needs a moment."""
    data = bytearray()
    until(f"{wanted!r}", lambda: len(data.__iadd__(read())) >= len(wanted))
    return data == wanted


@pytest.fixture(params=KINDS)
def end(request: pytest.FixtureRequest) -> Iterator[End]:
    opened = open_end(request.param)
    yield opened
    opened.close()


def test_bytes_go_both_ways_to_an_application_that_comes_and_comes_back(end: End) -> None:
    for word in (shaped(b"first"), shaped(b"again")):
        with closing(Link(end.device, 115200)) as link:
            link.read(0.0)
            assert not link.fault
            until("a greeting", partial(is_greeted, end, link))
            link.write(word)
            assert arrived(end.read, word)
        end.write(b"into the void")


def is_greeted(end: End, link: Link) -> bool:
    end.read()  # which lets a client in
    end.write(shaped(b"hello"))
    return b"hello" in link.read(0.0)


def shaped(payload: bytes) -> bytes:
    """Bytes in the form of a MAVLink 2 message: of datagrams nothing else is read."""
    return bytes([0xFD, len(payload), *[0] * 8]) + payload + bytes(2)


def test_an_end_neither_blocks_nor_raises_while_nobody_is_there(end: End) -> None:
    for _ in range(200):  # more than a pseudo-terminal takes
        end.write(bytes(100))
        assert end.read() == b""


# ------------------------------------------------------------------------------------------------ the camera
@pytest.fixture
def camera() -> Iterator[CameraServer]:
    with tempfile.TemporaryDirectory() as folder:  # short, as the paths of sockets must be
        server = CameraServer(Path(folder) / "frames.sock")
        yield server
        server.close()
        assert not (Path(folder) / "frames.sock").exists()


def connected(camera: CameraServer) -> socket.socket:
    reader = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    reader.settimeout(DEADLINE_S)
    reader.connect(camera.source.removeprefix("unix:"))
    return reader


def picture(number: int) -> np.ndarray:
    return np.full((720, 1280, 3), number, np.uint8)  # larger than what a socket keeps


def test_a_slow_reader_misses_frames_and_gets_the_newest_in_order(camera: CameraServer) -> None:
    camera.start()
    with connected(camera) as reader:
        for number in range(50):
            camera.frames.put((picture(number), 1.0 + number))
        stream = frames(reader)
        stamps = []
        while not stamps or stamps[-1] < 50.0:
            received = next(stream)
            assert received is not None
            image, stamp = received
            assert stamp is not None
            np.testing.assert_array_equal(image, picture(round(stamp) - 1))
            stamps.append(stamp)
    assert stamps == sorted(set(stamps))
    assert len(stamps) < 50


def test_a_reader_sees_an_unplugged_camera_close_and_a_plugged_one_deliver_again(camera: CameraServer) -> None:
    camera.start()
    for number in (1, 2):
        camera.is_plugged.set()
        with connected(camera) as reader:
            camera.frames.put((picture(number), float(number)))
            stream = frames(reader)
            received = next(stream)
            assert received is not None
            assert received[1] == float(number)
            camera.is_plugged.clear()
            with pytest.raises(CameraLostError, match="closed"):
                next(stream)


def test_a_reader_that_leaves_makes_room_for_the_next(camera: CameraServer) -> None:
    camera.start()
    for number in (1, 2):
        with connected(camera) as reader:
            reader.settimeout(0.05)
            until("a frame", partial(is_served, camera, frames(reader), number))


def is_served(camera: CameraServer, stream: Iterator[object], number: int) -> bool:
    # anew each time: until the server notices that the reader before has left, frames are lost on it
    camera.frames.put((picture(number), 1.0))
    return next(stream) is not None


def test_a_camera_that_was_never_started_closes(camera: CameraServer) -> None:
    assert not camera.is_alive()  # the fixture closes it


# ------------------------------------------------------------------------------------------------ both
@pytest.fixture
def realtime(camera: CameraServer) -> Iterator[RealTime]:
    """A vehicle that hovers before a world that stands still."""
    place = stage("straight", 7)
    small = replace(place, camera=replace(place.camera, size_hw=(120, 160), focal_px=138.5))
    autopilot = FakeAutopilot(ArduCopter, start=Start(pos_ned_m=place.start.pos_ned_m, mode="GUIDED"))
    both = RealTime(small, autopilot, UdpEnd(), camera, world_s_of=lambda _: 0.0)
    both.start()
    yield both
    both.stop()


def test_the_autopilot_runs_by_the_wall_and_is_never_ahead_of_it(realtime: RealTime) -> None:
    until("time to pass", lambda: realtime.autopilot.time_s > 0.3)
    with realtime.lock:
        assert realtime.autopilot.time_s <= realtime.time_s


def test_frames_are_never_early_and_their_stamps_rise(realtime: RealTime) -> None:
    shots = [realtime.shoot() for _ in range(6)]
    assert shots[5].time_s - shots[0].time_s > 4 / 30
    assert all(after.captured_s > before.captured_s for before, after in pairwise(shots))
    assert shots[-1].captured_s <= time.monotonic()
    assert shots[-1].truth.box is not None


def test_a_world_that_stands_still_never_gives_the_same_picture_twice(realtime: RealTime) -> None:
    before, after = realtime.shoot(), realtime.shoot()
    assert before.pose == after.pose
    assert not np.array_equal(before.image, after.image)


def test_a_frozen_camera_delivers_one_picture_with_new_stamps(realtime: RealTime, camera: CameraServer) -> None:
    first = realtime.shoot()
    realtime.is_frozen = True
    for _ in range(2):
        shot = realtime.shoot()
        delivered = camera.frames.value
        assert delivered is not None
        assert delivered[0] is first.image
        assert delivered[1] == shot.captured_s


def test_nothing_passes_a_cut_link_and_everything_a_mended_one(realtime: RealTime) -> None:
    realtime.is_link_cut = True
    with closing(Link(realtime.end.device, 0)) as link:
        link.read(0.0)
        cut_until_s = realtime.autopilot.time_s + 1.2  # a heartbeat is due every second
        until("time to pass", lambda: realtime.autopilot.time_s > cut_until_s)
        assert link.read(0.0) == b""
        realtime.is_link_cut = False
        until("telemetry", lambda: link.read(0.0) != b"")
