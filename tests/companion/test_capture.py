import math
import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.capture import Capture, captured_at, open_camera
from companion.config import CameraConfig
from companion.errors import CameraLostError
from companion.frame_stream import packed_header
from companion.latest import Latest
from companion.types import Frame
from mscf import MscfError

FAST = CameraConfig(pace="fast", focal_px=500.0)


@pytest.fixture
def images_dir(tmp_path: Path) -> Path:
    folder = tmp_path / "img"
    folder.mkdir()
    for index in range(5):
        cv2.imwrite(str(folder / f"{index:03}.png"), np.full((24, 32, 3), 10 * index, np.uint8))
    return folder


def captured(config: CameraConfig, ready: Callable[[Capture], bool], stop: threading.Event) -> tuple[Capture, Frame]:
    frames: Latest[Frame] = Latest()
    capture = Capture(config, frames, stop)
    capture.start()
    frame = frames.take(10.0)
    while not ready(capture):
        frame = frames.take(0.1) or frame
    stop.set()
    capture.join(10.0)
    assert not capture.is_alive()
    assert frame is not None
    return capture, frame


def test_a_folder_of_images_ends(images_dir: Path) -> None:
    config = replace(FAST, source=str(images_dir))
    capture, frame = captured(config, lambda capture: capture.has_ended, threading.Event())
    assert capture.failure is None
    assert frame.image.shape == (24, 32, 3)
    assert not frame.image.flags.writeable


def test_frames_are_numbered_and_stamped_in_order(images_dir: Path) -> None:
    taken = [item for item in open_camera(replace(FAST, source=str(images_dir))) if item is not None]
    assert [int(image[0, 0, 0]) for image, _ in taken] == [0, 10, 20, 30, 40]
    stamps = [stamp for _, stamp in taken]
    assert stamps == sorted(stamps)


def test_a_paced_folder_takes_as_long_as_it_was_filmed(images_dir: Path) -> None:
    stamps = [item[1] for item in open_camera(replace(FAST, source=str(images_dir), pace="rate")) if item is not None]
    assert stamps[-1] - stamps[0] >= 4 / 30 - 1e-3


def test_a_missing_camera_is_tried_again_and_the_thread_stays_well() -> None:
    stop = threading.Event()
    capture = Capture(replace(FAST, source="/dev/video-none"), Latest(), stop)
    capture.start()
    while not capture.fault.value:
        capture.fault.take(0.1)
    assert "does not exist" in capture.fault.value or "cannot be opened" in capture.fault.value
    assert capture.is_alive()
    assert capture.beat.value is not None
    stop.set()
    capture.join(10.0)
    assert capture.failure is None


@pytest.mark.parametrize("source", ["/dev/video99", "unix:/nowhere/frames.sock", "nothing.mp4"])
def test_what_is_not_there_is_one_line(source: str) -> None:
    with pytest.raises((CameraLostError, MscfError)) as lost:
        next(iter(open_camera(replace(FAST, source=source))))
    assert "\n" not in str(lost.value)


@pytest.mark.parametrize(("driver_s", "wanted_s"), [(99.96, 99.96), (100.0, 100.0), (99.01, 99.01)])
def test_a_drivers_own_stamp_is_the_time_of_capture(driver_s: float, wanted_s: float) -> None:
    assert captured_at(driver_s * 1000, 100.0) == pytest.approx(wanted_s)


@pytest.mark.parametrize("driver_ms", [0.0, -1.0, 98_999.0, 100_001.0, 1.7e12, math.inf, math.nan])
def test_a_stamp_of_another_clock_or_none_is_not_believed(driver_ms: float) -> None:
    assert captured_at(driver_ms, 100.0) == 100.0


def test_a_frame_socket_that_closes_is_connected_again(tmp_path: Path) -> None:
    path = tmp_path / "frames.sock"
    image = np.random.default_rng(1).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen(1)
        stop = threading.Event()
        frames: Latest[Frame] = Latest()
        capture = Capture(replace(FAST, source=f"unix:{path}"), frames, stop)
        capture.start()
        for round_ in range(2):
            connection, _ = listener.accept()
            with connection:
                connection.sendall(packed_header((24, 32), 50.0 + round_) + image.tobytes())
                frame = frames.take(10.0)
            assert frame is not None
            assert frame.captured_s == pytest.approx(50.0 + round_)
            assert frame.seq == round_
            np.testing.assert_array_equal(frame.image, image)
        stop.set()
        capture.join(10.0)
    assert capture.failure is None
