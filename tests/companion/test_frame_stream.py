import socket
from collections.abc import Iterator

import numpy as np
import pytest

from companion.errors import CameraLostError
from companion.frame_stream import HEADER, MAGIC, frames, packed_header


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with ours, theirs:
        ours.settimeout(0.05)
        yield ours, theirs


def picture(seed: int, size_hw: tuple[int, int] = (12, 16)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*size_hw, 3), dtype=np.uint8)


def test_frames_arrive_as_they_were_sent_with_their_time(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = pair
    for seed in (1, 2):
        theirs.sendall(packed_header((12, 16), 100.5 + seed) + picture(seed).tobytes())
    stream = frames(ours)
    for seed in (1, 2):
        received = next(stream)
        assert received is not None
        np.testing.assert_array_equal(received[0], picture(seed))
        assert received[1] == pytest.approx(100.5 + seed)


def test_a_frame_in_pieces_is_put_together_and_waiting_is_reported(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = pair
    data = packed_header((12, 16), 1.0) + picture(3).tobytes()
    stream = frames(ours)
    assert next(stream) is None  # nothing within the time-out
    theirs.sendall(data[:7])
    assert next(stream) is None
    theirs.sendall(data[7:300])
    assert next(stream) is None
    theirs.sendall(data[300:])
    received = next(stream)
    assert received is not None
    np.testing.assert_array_equal(received[0], picture(3))


def test_a_time_of_zero_is_not_known(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = pair
    theirs.sendall(packed_header((12, 16), 0.0) + picture(4).tobytes())
    received = next(frames(ours))
    assert received is not None
    assert received[1] is None


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "closed by the other side"),
        (packed_header((12, 16), 1.0), "closed within a frame"),
        (packed_header((12, 16), 1.0) + b"\0" * 50, "closed within a frame"),
        (HEADER.pack(b"HTTP", 16, 12, 0), "sends no frames"),
        (HEADER.pack(MAGIC, 0, 12, 0), "sends no frames"),
        (HEADER.pack(MAGIC, 100000, 100000, 0), "sends no frames"),
    ],
)
def test_what_is_no_stream_of_frames_is_a_lost_camera(
    pair: tuple[socket.socket, socket.socket], data: bytes, says: str
) -> None:
    ours, theirs = pair
    theirs.sendall(data)
    theirs.close()
    with pytest.raises(CameraLostError, match=says):
        next(frames(ours))
