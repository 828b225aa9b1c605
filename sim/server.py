"""Both ends of the loop in real time, for an application that is a process of its own.

The autopilot's end is a UDP, TCP or serial (pseudo-terminal) port that the application opens as it would a real
one; the camera's end is the frame socket of `companion.frame_stream`. Stamps are CLOCK_MONOTONIC, which both processes
share.
"""

import errno
import os
import socket
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from companion.frame_stream import packed_header
from companion.latest import Latest
from mscf.arrays import Image
from sim.autopilot import FakeAutopilot
from sim.camera import Truth, render
from sim.external import ExternalAutopilot
from sim.stages import Stage
from sim.world import Pose

FRAME_S = 1 / 30
STEP_S = 0.005  # of the autopilot: its messages leave as punctually as a real one's
_READ_SIZE = 65536
_POLL_S = 0.2
KINDS = ("udp", "tcp", "serial")


class End(Protocol):
    """The autopilot's end of a link; neither call blocks or raises because the other side is not there."""

    @property
    def device(self) -> str: ...  # what the application opens
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class UdpEnd:
    """Sends to a port of this machine, as a router does; hears what comes back."""

    def __init__(self) -> None:
        # a port that is free now: nobody else asks for it within this run
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._peer = probe.getsockname()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0)
        self.device = f"udpin:127.0.0.1:{self._peer[1]}"

    def read(self) -> bytes:
        """What has come."""
        data = b""
        while True:
            try:
                data += self._socket.recv(_READ_SIZE)
            except BlockingIOError:
                return data
            except ConnectionRefusedError:  # nobody listens yet
                continue

    def write(self, data: bytes) -> None:
        """Send, or lose it where nobody listens."""
        try:
            self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpEnd:
    """A server for one client, as ArduPilot's simulation is."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0)
        self._socket: socket.socket | None = None
        self.device = f"tcp:127.0.0.1:{self._listener.getsockname()[1]}"

    def read(self) -> bytes:
        """What has come; accepts a client that comes back."""
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            pass
        else:
            self._drop()
            connection.settimeout(0)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket = connection
        if self._socket is None:
            return b""
        try:
            data = self._socket.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> None:
        """Send what the client takes."""
        if self._socket is None:
            return
        try:
            self._socket.send(data)
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def close(self) -> None:
        """Close both sockets."""
        self._drop()
        self._listener.close()


class SerialEnd:
    """A pseudo-terminal; the application opens its other side as a serial port."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()  # keeping the slave open keeps the line up without an application
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)

    def read(self) -> bytes:
        """What has come."""
        try:
            return os.read(self._master, _READ_SIZE)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send what the line takes; a line that nobody reads is full."""
        try:
            os.write(self._master, data)
        except OSError as error:
            if error.errno not in {errno.EAGAIN, errno.EIO}:
                raise

    def close(self) -> None:
        """Close both sides."""
        os.close(self._master)
        os.close(self._slave)


def open_end(kind: str) -> End:
    """The autopilot's end of a link of one of `KINDS`."""
    ends: dict[str, Callable[[], End]] = {"udp": UdpEnd, "tcp": TcpEnd, "serial": SerialEnd}
    return ends[kind]()


class CameraServer(threading.Thread):
    """Sends frames to whoever connects to a Unix socket, the newest one; a slow reader misses frames."""

    def __init__(self, path: Path) -> None:
        super().__init__(name="camera server")
        self.frames: Latest[tuple[Image, float]] = Latest()
        self.is_plugged = threading.Event()
        self.is_plugged.set()
        self._path = path
        self._stop_asked = threading.Event()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen(1)
        self._listener.settimeout(_POLL_S)

    @property
    def source(self) -> str:
        """What the application's camera.source has to be."""
        return f"unix:{self._path}"

    def run(self) -> None:
        """Serve one reader after the other."""
        while not self._stop_asked.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            with connection:
                connection.settimeout(2.0)
                self._serve(connection)

    def _serve(self, connection: socket.socket) -> None:
        while not self._stop_asked.is_set():
            if not self.is_plugged.is_set():
                return  # the reader sees the connection close, as when a camera is pulled out
            frame = self.frames.take(_POLL_S)
            if frame is None:
                continue
            image, captured_s = frame
            try:
                connection.sendall(packed_header((image.shape[0], image.shape[1]), captured_s))
                connection.sendall(image.data)
            except OSError:
                return

    def close(self) -> None:
        """Stop serving and remove the path."""
        self._stop_asked.set()
        if self.ident is not None:
            self.join()
        self._listener.close()
        self._path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame as it was taken: what a report needs."""

    time_s: float  # of the exposure, since the start of the run
    captured_s: float  # its stamp, on the monotonic clock
    image: Image
    truth: Truth
    pose: Pose


class RealTime:
    """A stage and an autopilot that run by the wall, with a camera and a link for another process.

    The autopilot runs in a thread of its own, so that a frame that takes long delays no message. `shoot` renders
    the next frame when it is due and returns it.
    """

    def __init__(
        self,
        stage: Stage,
        autopilot: FakeAutopilot | ExternalAutopilot,
        end: End,
        camera: CameraServer,
        *,
        world_s_of: Callable[[float], float] = lambda time_s: time_s,
        gain: Callable[[float], float] = lambda _: 1.0,
    ) -> None:
        self.stage, self.autopilot, self.end, self.camera = stage, autopilot, end, camera
        self.is_link_cut = False
        self.is_frozen = False  # the camera shows one picture again and again
        self._last: Image | None = None
        self._world_s_of = world_s_of
        self._gain = gain
        self.lock = threading.Lock()  # to be held around the autopilot
        self._start_s = time.monotonic()
        self._flown_s = 0.0
        self._frame = 0
        self._stop_asked = threading.Event()
        self._thread = threading.Thread(target=self._fly, name="autopilot")

    @property
    def time_s(self) -> float:
        """Since the start."""
        return time.monotonic() - self._start_s

    @property
    def world_s(self) -> float:
        """Time of the world's movers."""
        return self._world_s_of(self.time_s)

    def start(self) -> None:
        """Let time run."""
        self._start_s = time.monotonic()
        self.camera.start()
        self._thread.start()

    def stop(self) -> None:
        """End all threads and close both ends."""
        self._stop_asked.set()
        if self._thread.ident is not None:
            self._thread.join()
        self.camera.close()
        self.end.close()

    def _fly(self) -> None:
        while not self._stop_asked.is_set():
            data = self.end.read()
            now_s = self.time_s
            with self.lock:
                if data and not self.is_link_cut:
                    self.autopilot.receive(data)
                sent = self.autopilot.step(max(now_s - self._flown_s, 0.0))
            self._flown_s = max(now_s, self._flown_s)
            if sent and not self.is_link_cut:
                self.end.write(sent)
            time.sleep(max(STEP_S - (self.time_s - now_s), 0.0))

    def shoot(self) -> Shot:
        """Wait for the next frame's time, take it, and hand it to the camera."""
        self._frame = max(self._frame + 1, int(self.time_s / FRAME_S))
        time.sleep(max(self._frame * FRAME_S - self.time_s, 0.0))
        with self.lock:
            pose = self.autopilot.camera_pose
            at_close = pose.moved(
                self.stage.camera.exposure_s, self.autopilot.velocity_ned_mps, *self.autopilot.camera_rates_radps
            )
        time_s = self.time_s
        image, truth = render(
            self.stage.world,
            self.stage.carried_camera,
            pose,
            self._world_s_of(time_s),
            pose_at_close=at_close,
            exposure_gain=self._gain(time_s),
            noise_time_s=time_s,
        )
        image.setflags(write=False)
        self._last = self._last if self.is_frozen and self._last is not None else image
        # a camera's stamp: when the frame is complete; camera.latency_ms is what came before
        captured_s = time.monotonic()
        self.camera.frames.put((self._last, captured_s))
        return Shot(time_s, captured_s, image, truth, pose)
