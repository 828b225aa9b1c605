"""Frames over a Unix socket: for cameras that V4L2 does not show, and for the simulator.

A program that has pictures (libcamera, GStreamer, a simulator) listens on a stream socket; the application connects
and reads. A frame is a header, then height x width x 3 bytes, BGR, row by row. The header, little-endian:
magic `MSF1`, uint32 width, uint32 height, uint64 nanoseconds of CLOCK_MONOTONIC at capture (0: not known).
"""

import socket
import struct
from collections.abc import Generator, Iterator

import numpy as np

from companion.errors import CameraLostError
from mscf.arrays import Image

HEADER = struct.Struct("<4sIIQ")
MAGIC = b"MSF1"
MAX_SIDE_PX = 8192


def packed_header(size_hw: tuple[int, int], captured_s: float) -> bytes:
    """Header of a frame."""
    return HEADER.pack(MAGIC, size_hw[1], size_hw[0], round(captured_s * 1e9))


def frames(connection: socket.socket) -> Iterator[tuple[Image, float | None] | None]:
    """Frames with their time of capture (None: not known); None where nothing came within the socket's time-out.

    Raises
    ------
    CameraLostError
        If the other side closes, or sends what is no frame.
    """
    header = bytearray(HEADER.size)
    while True:
        if not (yield from _filled(connection, memoryview(header))):
            raise CameraLostError("the frame socket was closed by the other side")
        magic, width, height, captured_ns = HEADER.unpack(header)
        if magic != MAGIC or not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX):
            raise CameraLostError(f"the frame socket sends no frames: header {bytes(header[:12])!r}")
        image = np.empty((height, width, 3), np.uint8)
        if not (yield from _filled(connection, image.reshape(-1).data)):
            raise CameraLostError("the frame socket was closed within a frame")
        yield image, captured_ns / 1e9 if captured_ns else None


def _filled(connection: socket.socket, view: memoryview) -> Generator[None, None, bool]:
    """Fill a buffer; yields None at each time-out; returns whether it was filled."""
    done = 0
    while done < len(view):
        try:
            count = connection.recv_into(view[done:])
        except TimeoutError:
            yield None
            continue
        if not count:
            return False
        done += count
    return True
