"""The capture thread: from a camera, file or socket to the newest frame.

It never gives up on a camera: one that is missing or breaks is tried again every second. Files end.
"""

import logging
import math
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# read by OpenCV when it opens a camera: one that hangs must not hang the thread for ten seconds
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")

import cv2
import numpy as np

from companion.config import CameraConfig
from companion.errors import CameraLostError
from companion.frame_stream import frames as stream_frames
from companion.latest import Latest
from companion.types import Frame
from mscf import MscfError
from mscf.arrays import Image
from mscf.source import open_source

logger = logging.getLogger(__name__)
RETRY_S = 1.0
MAX_STAMP_AGE_S = 1.0
_SOCKET_TIMEOUT_S = 0.2
UNIX = "unix:"

Captured = tuple[Image, float] | None  # None: nothing yet, but the thread is well


class Capture(threading.Thread):
    """Reads frames until it is stopped or its source ends, and puts the newest where vision takes it."""

    def __init__(self, config: CameraConfig, frames: Latest[Frame], stop: threading.Event) -> None:
        # joined like any other, but one that is stuck in a driver must not keep the process from ending
        super().__init__(name="capture", daemon=True)
        self.failure: BaseException | None = None
        self.beat: Latest[float] = Latest()  # when the thread last got round
        self.fault: Latest[str] = Latest()  # why there are no frames; empty: there are
        self.has_ended = False
        self._config = config
        self._frames = frames
        self._stop_asked = stop

    def run(self) -> None:
        """Body of the thread; what kills it is kept for the main thread."""
        try:
            self._capture()
        except BaseException as error:  # the thread's top: the main thread raises it again
            self.failure = error
            raise

    def _capture(self) -> None:
        seq, said = 0, ""
        while not self._stop_asked.is_set():
            self.beat.put(time.monotonic())
            try:
                for captured in open_camera(self._config):
                    self.beat.put(time.monotonic())
                    if self._stop_asked.is_set():
                        return
                    if captured is None:
                        continue
                    if said or not seq:
                        logger.info("camera %s delivers frames", self._config.source)
                    said = ""
                    self.fault.put("")
                    image, captured_s = captured
                    image.setflags(write=False)
                    self._frames.put(Frame(image, seq, captured_s))
                    seq += 1
                self.has_ended = True
                return  # noqa: TRY300 - a file's end, not a failure
            except (CameraLostError, MscfError, OSError) as error:
                if str(error) != said:
                    said = str(error)
                    logger.warning("camera: %s", said)
                self.fault.put(said)
                self._stop_asked.wait(RETRY_S)


def open_camera(config: CameraConfig) -> Iterator[Captured]:
    """Frames of the configured source with their times of capture, on the monotonic clock.

    Raises
    ------
    CameraLostError, MscfError, OSError
        If it cannot be opened, or breaks.
    """
    if config.source.startswith(UNIX):
        return _socket_frames(config.source.removeprefix(UNIX))
    if config.source.startswith("/dev/"):  # a udev rule may have given it another name
        return _v4l2_frames(config)
    return _file_frames(config)


def _v4l2_frames(config: CameraConfig) -> Iterator[Captured]:
    """A V4L2 camera: MJPG, one buffer, read as fast as it delivers so that no frame grows old in a queue."""
    capture = cv2.VideoCapture(config.source, cv2.CAP_V4L2)
    try:
        if not capture.isOpened():
            raise CameraLostError(f"{config.source} cannot be opened: is it there, free, and readable (group video)?")
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, config.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, config.height_px)
        capture.set(cv2.CAP_PROP_FPS, config.frames_per_s)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        is_stamped = False  # by the driver
        while True:
            is_grabbed = capture.grab()
            now_s = time.monotonic()  # before decoding, which takes its time
            captured_s = captured_at(capture.get(cv2.CAP_PROP_POS_MSEC), now_s, is_trusted=is_stamped)
            is_stamped = is_stamped or captured_s != now_s
            is_read, image = capture.retrieve() if is_grabbed else (False, None)
            if not is_read or image is None:
                raise CameraLostError(f"{config.source} delivers no frames any more: was it unplugged?")
            yield np.asarray(image, dtype=np.uint8), captured_s
    finally:
        capture.release()


def captured_at(driver_ms: float, now_s: float, *, is_trusted: bool) -> float:
    """When a V4L2 frame was captured: the driver's own stamp, which is taken before the frame waits to be read.

    Drivers of cameras stamp on the monotonic clock; a first stamp that is a second old on it, or more, is of another
    clock. Once one was right, a later one that is older is a frame that has waited, and no news.
    """
    age_s = now_s - driver_ms / 1000
    return now_s - age_s if 0 <= age_s < (math.inf if is_trusted else MAX_STAMP_AGE_S) else now_s


def _socket_frames(path: str) -> Iterator[Captured]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_SOCKET_TIMEOUT_S)
        try:
            connection.connect(path)
        except OSError as error:
            raise CameraLostError(f"{UNIX}{path} cannot be connected: {error.strerror}") from error
        for received in stream_frames(connection):
            if received is None:
                yield None
            else:
                image, captured_s = received
                yield image, time.monotonic() if captured_s is None else captured_s


def _file_frames(config: CameraConfig) -> Iterator[Captured]:
    """A video or a folder of images; paced, frames appear at the rate at which they were filmed."""
    source = open_source(str(Path(config.source)))
    start_s = time.monotonic()
    for index, image in enumerate(source):
        if config.pace == "rate":
            wait_s = start_s + index / source.frames_per_s - time.monotonic()
            while wait_s > 0:
                time.sleep(min(wait_s, _SOCKET_TIMEOUT_S))
                yield None
                wait_s = start_s + index / source.frames_per_s - time.monotonic()
        yield image, time.monotonic()
