import math
import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

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
from mscf.arrays import Image

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
    assert captured_at(driver_s * 1000, 100.0, is_trusted=False) == pytest.approx(wanted_s)


@pytest.mark.parametrize("driver_ms", [0.0, -1.0, 98_999.0, 100_001.0, 1.7e12, math.inf, math.nan])
def test_a_stamp_of_another_clock_or_none_is_not_believed(driver_ms: float) -> None:
    assert captured_at(driver_ms, 100.0, is_trusted=False) == 100.0


def test_a_frame_that_waited_is_old_where_the_drivers_stamps_were_right_before() -> None:
    assert captured_at(97_000.0, 100.0, is_trusted=True) == pytest.approx(97.0)
    assert captured_at(100_001.0, 100.0, is_trusted=True) == 100.0
    assert captured_at(math.nan, 100.0, is_trusted=True) == 100.0


class UsbCamera:
    """As OpenCV shows a V4L2 camera: frames of a stamp each, then none any more."""

    opened: ClassVar[list["UsbCamera"]] = []

    def __init__(self, source: str, backend: int) -> None:
        self.source, self.backend = source, backend
        self.is_released = False
        self.settings: dict[int, float] = {}
        self.stamps_ms = [0.0, 0.0, 0.0]
        self._calls: list[str] = []
        self.opened.append(self)

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return True

    def set(self, key: int, value: float) -> bool:
        self.settings[key] = value
        return True

    def grab(self) -> bool:
        self._calls.append("grab")
        return self._calls.count("grab") <= len(self.stamps_ms)

    def get(self, key: int) -> float:
        assert key == cv2.CAP_PROP_POS_MSEC
        return self.stamps_ms[min(self._calls.count("grab"), len(self.stamps_ms)) - 1]

    def retrieve(self) -> tuple[bool, Image]:
        assert self._calls[-1] == "grab"
        self._calls.append("retrieve")
        return True, np.zeros((480, 640, 3), np.uint8)

    def release(self) -> None:
        self.is_released = True


@pytest.fixture
def usb_camera(monkeypatch: pytest.MonkeyPatch) -> type[UsbCamera]:
    UsbCamera.opened.clear()
    monkeypatch.setattr(cv2, "VideoCapture", UsbCamera)
    return UsbCamera


CAMERA = CameraConfig(source="/dev/video2", width_px=640, height_px=480, frames_per_s=25.0, focal_px=500.0)


def test_a_v4l2_camera_is_asked_for_mjpg_in_the_configured_size_and_one_buffer(usb_camera: type[UsbCamera]) -> None:
    next(open_camera(CAMERA))
    (camera,) = usb_camera.opened
    assert (camera.source, camera.backend) == ("/dev/video2", cv2.CAP_V4L2)
    assert camera.settings == {
        cv2.CAP_PROP_FOURCC: int.from_bytes(b"MJPG", "little"),
        cv2.CAP_PROP_FRAME_WIDTH: 640,
        cv2.CAP_PROP_FRAME_HEIGHT: 480,
        cv2.CAP_PROP_FPS: 25.0,
        cv2.CAP_PROP_BUFFERSIZE: 1,
    }


def test_a_v4l2_camera_that_is_unplugged_is_released_and_opened_again(usb_camera: type[UsbCamera]) -> None:
    with pytest.raises(CameraLostError, match="unplugged"):
        list(open_camera(CAMERA))
    assert usb_camera.opened[0].is_released
    capture, frame = captured(CAMERA, lambda _: len(usb_camera.opened) > 1, threading.Event())
    assert frame.image.shape == (480, 640, 3)
    assert capture.failure is None


def test_a_v4l2_frame_carries_the_drivers_stamp(usb_camera: type[UsbCamera], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.capture.time.monotonic", lambda: 50.0)
    frames = open_camera(CAMERA)
    assert next(frames) is not None  # opens it
    usb_camera.opened[0].stamps_ms = [0.0, 49_960.0, 60_000.0, 40_000.0]
    stamps = [item[1] for item in (next(frames), next(frames), next(frames)) if item is not None]
    assert stamps == pytest.approx([49.96, 50.0, 40.0])  # one of no sense; the last one has waited


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
