"""The recorder: a thread between the flight and its record, which no disk and no encoder can hold up.

What is put in waits in bounded queues; what does not fit is dropped and counted. Whatever goes wrong here ends the
record, or the video alone, with one text for the operator, and nothing else.
"""

import errno
import itertools
import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, SimpleQueue

import cv2

from companion.config import Config, RecordConfig
from companion.flight_record import ABOUT, KIND, VIDEO, FlightRecord
from companion.follower import Step
from companion.types import Frame, Severity, Text, TrackSample
from mscf.arrays import Image
from mscf.errors import OutputError
from mscf.recording import LiveVideoFile

logger = logging.getLogger(__name__)
MAX_STEPS = 1200  # that wait: a minute at 20 Hz
MAX_FRAMES = 4
NICE = 10  # of this thread alone
TIDY_S = 5.0
FOLDER = "mscf-companion/flights"  # below the user's own state folder
MAX_TEXT = 50  # characters of a status text
_MB = 1e6
_TAKE_S = 0.1
_SET_CLOCK_S = datetime(2025, 1, 1, tzinfo=UTC).timestamp()  # a clock that says less was never set
_WORDS = {errno.ENOSPC: "disk full", errno.EDQUOT: "disk full"}
_GOOD_BGR, _POOR_BGR, _LIGHT_BGR, _DARK_BGR = (80, 220, 80), (40, 160, 255), (255, 255, 255), (0, 0, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def flights_folder(config: RecordConfig, environ: Mapping[str, str]) -> Path:
    """Where all flights are recorded: as configured, else as systemd or the user's session says."""
    if config.folder:
        return Path(config.folder)
    if environ.get("STATE_DIRECTORY"):  # systemd's; the first of several
        return Path(environ["STATE_DIRECTORY"].split(":")[0], "flights")
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME", "/tmp"), ".local", "state")  # noqa: S108 - no home
    return Path(home, FOLDER)


class Recorder(threading.Thread):
    """Writes the record of one run; its folder is made when the thread starts.

    Parameters
    ----------
    flights : folder of all flights.
    """

    def __init__(self, config: Config, flights: Path) -> None:
        # joined like any other, but one that is stuck in a disk must not keep the process from ending
        super().__init__(name="recorder", daemon=True)
        self.folder: Path | None = None  # of this flight, once it is there
        self.steps_dropped = 0
        self.frames_dropped = 0
        self._config = config
        self._flights = flights
        self._steps: SimpleQueue[tuple[Step, int]] = SimpleQueue()  # with how many were dropped before
        self._frames: SimpleQueue[tuple[Frame, TrackSample]] = SimpleQueue()
        self._notices: SimpleQueue[Text] = SimpleQueue()
        self._farewell: tuple[float, Sequence[bytes]] | None = None
        self._stop_asked = threading.Event()
        self._is_over = False  # nothing more is taken
        self._has_video = config.record.video != "none"
        self._frame_due_s = float("-inf")
        self._record: FlightRecord | None = None
        self._video: LiveVideoFile | None = None
        self._mode = ""
        self._gap = 0
        self._tidied_s = float("-inf")

    # ----------------------------------------------------------------------------------- for the other threads
    @property
    def is_recording(self) -> bool:
        """Whether steps end in the folder."""
        return self.folder is not None and not self._is_over

    def put_step(self, step: Step) -> None:
        """Hand a step over; for the command loop, which it neither delays nor fails."""
        if self._is_over:
            return
        if self._steps.qsize() >= MAX_STEPS:
            self.steps_dropped += 1
        else:
            self._steps.put((step, self.steps_dropped))

    def put_frame(self, frame: Frame, sample: TrackSample) -> None:
        """Hand over a frame with what was seen in it; for the vision thread. Most are not for the video."""
        if self._is_over or not self._has_video:
            return
        period_s, captured_s = 1 / self._config.record.video_frames_per_s, frame.captured_s
        if captured_s < self._frame_due_s - period_s / 4:  # a camera is not that punctual
            return
        # on a grid, so that frames that come at another rate are not thinned too much
        next_s = self._frame_due_s + period_s
        self._frame_due_s = next_s if next_s > captured_s else captured_s + period_s
        if self._frames.qsize() >= MAX_FRAMES:
            self.frames_dropped += 1
        else:
            self._frames.put((frame, sample))

    def put_farewell(self, now_s: float, packets: Sequence[bytes]) -> None:
        """Hand over the last words; before `end`."""
        self._farewell = now_s, packets

    def notices(self) -> tuple[Text, ...]:
        """What the operator is to be told, since the last call."""
        found = []
        with suppress(Empty):
            while True:
                found.append(self._notices.get_nowait())
        return tuple(found)

    def end(self, limit_s: float) -> None:
        """Write what waits, finish the video, and end; at most for a time."""
        self._stop_asked.set()
        if self.ident is not None:
            self.join(limit_s)
        self._is_over = True

    # ----------------------------------------------------------------------------------- the thread
    def run(self) -> None:
        """Body of the thread; nothing leaves it."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        try:
            self._begin()
            while not (self._stop_asked.is_set() and self._steps.empty() and self._frames.empty()):
                self._write_steps()
                self._write_frames()
                self._tidy()
            self._write_end()
        except OSError as error:
            logger.warning("record: %s", error)
            self._say_stopped("Record", _why(error))
        except Exception as error:  # the thread's top: a record is no reason to end a flight
            logger.exception("record")
            self._say_stopped("Record", type(error).__name__)
        self._is_over = True
        self._close()

    def _begin(self) -> None:
        record = self._config.record
        self._flights.mkdir(parents=True, exist_ok=True)
        remove_old(self._flights, None, record, time.time())
        self._check_space()
        start_s, start_us = time.monotonic(), time.time_ns() // 1000
        folder = new_folder(self._flights, datetime.fromtimestamp(start_us / 1e6, UTC))
        self._record = FlightRecord(folder, self._config, start_s, start_us)
        self.folder = folder
        self._tidied_s = start_s
        logger.info("record %s", folder)
        if self._has_video:
            with self._ending_video():
                self._video = LiveVideoFile(folder / VIDEO, record.video_frames_per_s)

    def _write_steps(self) -> None:
        """All that wait; where none does, the next one."""
        assert self._record is not None
        with suppress(Empty):
            step, dropped = self._steps.get(timeout=_TAKE_S)
            while True:
                self._write_gap(dropped)
                self._record.add(step)
                self._mode = step.control.mode.value
                step, dropped = self._steps.get_nowait()

    def _write_gap(self, dropped: int) -> None:
        assert self._record is not None
        if dropped != self._gap:
            self._record.add_gap(dropped - self._gap)
            self._gap = dropped

    def _write_end(self) -> None:
        assert self._record is not None
        self._write_gap(self.steps_dropped)
        if self._farewell is not None:
            self._record.add_farewell(*self._farewell)

    def _write_frames(self) -> None:
        for _ in range(self._frames.qsize()):
            frame, sample = self._frames.get_nowait()
            if self._video is None:
                continue
            with self._ending_video():
                is_drawn = self._config.record.video == "overlay"
                picture = drawn(frame.image, sample, self._mode) if is_drawn else frame.image
                self._video.write(picture, frame.captured_s)

    @contextmanager
    def _ending_video(self) -> Iterator[None]:
        """What fails ends the video alone, unless nothing else can be written either."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - whatever an encoder raises, the record can do without
            self._has_video, self._video = False, None
            cause = error.__cause__
            if isinstance(cause, OSError) and cause.errno in _WORDS:
                raise cause from None
            logger.warning("video: %s", error)
            self._say_stopped("Video", "no PyAV" if isinstance(cause, ImportError) else _why(cause or error))

    def _tidy(self) -> None:
        """Now and then: make room, look whether there is some, and see it on disk."""
        assert self._record is not None
        now_s = time.monotonic()
        if now_s - self._tidied_s < TIDY_S:
            return
        self._tidied_s = now_s
        record = self._config.record
        used_mb = remove_old(self._flights, self._record.folder, record, time.time()) / _MB
        if used_mb > record.max_total_mb:  # this flight alone
            raise OSError(errno.EFBIG, "record.max_total_mb reached")
        self._check_space()
        self._record.sync()

    def _check_space(self) -> None:
        free_mb, least_mb = shutil.disk_usage(self._flights).free / _MB, self._config.record.min_free_mb
        if free_mb < least_mb:
            logger.warning("record: %.0f MB free in %s, record.min_free_mb = %g", free_mb, self._flights, least_mb)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _say_stopped(self, what: str, why: str) -> None:
        self._notices.put(Text(Severity.WARNING, f"{what} stopped: {why}"[:MAX_TEXT]))

    def _close(self) -> None:
        for thing in (self._video, self._record):
            with suppress(OSError, OutputError):
                if thing is not None:
                    thing.close()


def _why(error: BaseException) -> str:
    """A system's error in few words."""
    if isinstance(error, OSError) and error.errno is not None:
        return _WORDS.get(error.errno, error.strerror or "").lower()
    return str(error)


# ------------------------------------------------------------------------------------------------ the folders
def new_folder(flights: Path, start: datetime) -> Path:
    """Make the folder of a flight, named by its start and a number that is above all others there.

    The number, not the time, says which flight was later: many a companion computer has no clock of its own.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    first = 1 + max((_number(path) for path in _records(flights)), default=0)
    for number in itertools.count(first):  # another process may be about to make the same
        folder = flights / f"{start:%Y%m%dT%H%M%SZ}-{number:04d}"
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise AssertionError(first)  # numbers do not end


def _records(flights: Path) -> list[Path]:
    """Folders of flights, the oldest first; what else lies there is not ours."""
    with os.scandir(flights) as entries:
        folders = [Path(entry.path) for entry in entries if entry.is_dir(follow_symlinks=False)]
    return sorted(filter(_is_record, folders), key=lambda path: (_number(path), path.name))


def _is_record(folder: Path) -> bool:
    try:
        about = json.loads((folder / ABOUT).read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(about, dict) and about.get("record") == KIND


def _number(folder: Path) -> int:
    last = folder.name.rpartition("-")[2]
    return int(last) if last.isascii() and last.isdigit() else 0


def remove_old(flights: Path, running: Path | None, config: RecordConfig, now_s: float) -> float:
    """Remove records that are too old, then the oldest ones that do not fit; never the running one.

    Parameters
    ----------
    now_s : since 1970 UTC.

    Returns
    -------
    Bytes of all that remain.
    """
    sizes: dict[Path, float] = {}
    for folder in _records(flights):
        size, written_s = _measured(folder)
        # of an age that rests on a clock that was not set then, nothing follows
        is_old = written_s > _SET_CLOCK_S and now_s - written_s > config.max_age_days * 86400
        if is_old and folder != running and _is_removed(folder):
            continue
        sizes[folder] = size
    for folder in list(sizes):
        if sum(sizes.values()) <= config.max_total_mb * _MB:
            break
        if folder != running and _is_removed(folder):
            del sizes[folder]
    return sum(sizes.values())


def _measured(folder: Path) -> tuple[float, float]:
    """Bytes, and when the last one was written, since 1970 UTC."""
    size, written_s = 0, 0.0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            status = path.lstat()
            size += status.st_size
            written_s = max(written_s, status.st_mtime)
    return size, written_s


def _is_removed(folder: Path) -> bool:
    """Remove a record; `ABOUT` goes last, so that one half removed is still known as ours."""
    try:
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name != ABOUT:
                path.unlink()
        (folder / ABOUT).unlink()
        folder.rmdir()
    except OSError as error:
        logger.warning("record: %s cannot be removed: %s", folder, error.strerror)
        return False
    logger.info("record: removed %s", folder)
    return True


# ------------------------------------------------------------------------------------------------ the overlay
def drawn(image: Image, sample: TrackSample, mode: str) -> Image:
    """Copy of a frame, (H, W, 3) BGR uint8, with the box and a line of what was made of it."""
    picture = image.copy()
    unit = max(image.shape[0] / 720, 0.5)  # sizes below are for 720 rows
    if sample.box is not None and sample.box.is_finite:
        # a box far outside would overflow OpenCV's fixed-point coordinates
        limit = 4.0 * max(image.shape)
        box = sample.box
        corners = (box.x, box.y, box.x + box.w - 1, box.y + box.h - 1)
        left, top, right, bottom = (round(min(max(value, -limit), limit)) for value in corners)
        color = _GOOD_BGR if sample.is_measured else _POOR_BGR
        cv2.rectangle(picture, (left, top), (right, bottom), color, max(1, round(2 * unit)), cv2.LINE_AA)
    status = sample.status.name.lower() if sample.status is not None else "none"
    text = f"{mode} | target {status}, confidence {sample.confidence:.2f}" if sample.status is not None else mode
    origin = round(12 * unit), round(30 * unit)  # at the top: players have their controls at the bottom
    # dark under light: legible on any ground
    for color, width in ((_DARK_BGR, 4), (_LIGHT_BGR, 1.5)):
        cv2.putText(picture, text, origin, _FONT, 0.7 * unit, color, max(1, round(width * unit)), cv2.LINE_AA)
    return picture
