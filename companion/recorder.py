"""The recorder: two threads between the flight and its record, which no disk and no encoder can hold up.

One writes the steps, one the video. What is put in waits in the bounded queue of each; what does not fit is dropped and
counted. A thread that dies or hangs takes neither the other nor the flight with it: the operator is told, once.
"""

import errno
import logging
import os
import threading
import time
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from companion.config import Config
from companion.flight_folders import NoRoomError, check_free, make_room, new_folder
from companion.flight_record import VIDEO, FlightRecord
from companion.follower import FailedStep, Step
from companion.types import Frame, Severity, Text, TrackSample
from mscf.arrays import Image
from mscf.errors import OutputError
from mscf.overlay import draw_box, draw_text
from mscf.recording import LiveVideoFile

logger = logging.getLogger(__name__)
MAX_STEPS = 1200  # that wait: a minute at 20 Hz
MAX_FRAMES = 4
NICE = 10  # of these threads alone
TIDY_S = 5.0
STALLED_S = 5.0  # without anything taken; a card that is slow to sync needs a second or two
MAX_TEXT = 50  # characters of a status text
_TAKE_S = 0.1
_FULL, _NO_FOLDER, _NOT_WRITABLE = "disk full", "record.folder is no folder", "record.folder cannot be written"
_WORDS = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EEXIST: _NO_FOLDER,
    errno.ENOTDIR: _NO_FOLDER,
    errno.ENOENT: "record.folder is gone",
    errno.EACCES: _NOT_WRITABLE,
    errno.EPERM: _NOT_WRITABLE,
    errno.EROFS: _NOT_WRITABLE,
}
_GOOD_BGR, _POOR_BGR, _LIGHT_BGR = (80, 220, 80), (40, 160, 255), (255, 255, 255)

_Item = TypeVar("_Item")


class Recorder:
    """Writes the record of one run; its folder is made by a thread of its own.

    Parameters
    ----------
    flights : folder of all flights.
    """

    def __init__(self, config: Config, flights: Path) -> None:
        self._config = config
        self._notices: SimpleQueue[Text] = SimpleQueue()
        self._steps = _StepWriter(config, flights, self._notices)
        has_video = config.record.video != "none"
        self._video = _VideoWriter(config, flights, self._notices, self._steps) if has_video else None
        self._writers = (self._steps, self._video) if self._video is not None else (self._steps,)
        self._frame_due_s = float("-inf")
        self._mode = ""
        self._said: set[str] = set()

    @property
    def folder(self) -> Path | None:
        """Of this flight, once it is there."""
        return self._steps.folder

    @property
    def is_recording(self) -> bool:
        """Whether steps end in the folder."""
        return self.folder is not None and not self._steps.is_over

    @property
    def steps_dropped(self) -> int:
        """How many steps found no place in the queue."""
        return self._steps.dropped

    @property
    def frames_dropped(self) -> int:
        """How many frames, of those that are for the video, found no place in the queue."""
        return self._video.dropped if self._video is not None else 0

    def start(self) -> None:
        """Begin to write."""
        for writer in self._writers:
            writer.start()

    def put_step(self, step: Step) -> None:
        """Hand a step over; for the command loop, which it neither delays nor fails."""
        self._mode = step.control.mode.value
        self._steps.put((step, self._steps.dropped))
        if self._steps.dropped:
            self._say_once("Record behind: steps are lost")
        if self._steps.is_stalled(step.inputs.now_s):
            self._say_once("Record stalled")
        if self._video is not None and self._video.is_stalled(step.inputs.now_s):
            self._say_once("Video of the record stalled")

    def put_frame(self, frame: Frame, sample: TrackSample) -> None:
        """Hand over a frame with what was seen in it; for the vision thread. Most are not for the video."""
        if self._video is None:
            return
        period_s, captured_s = 1 / self._config.record.video_frames_per_s, frame.captured_s
        if captured_s < self._frame_due_s - period_s / 4:  # a camera is not that punctual
            return
        # on a grid, so that frames that come at another rate are not thinned too much
        next_s = self._frame_due_s + period_s
        self._frame_due_s = next_s if next_s > captured_s else captured_s + period_s
        self._video.put((frame, sample, self._mode))

    def put_failed(self, failed: FailedStep) -> None:
        """Hand over the step whose controller raised, the last one; before `end`."""
        self._steps.failed = failed

    def put_farewell(self, now_s: float, packets: Sequence[bytes]) -> None:
        """Hand over the last words; before `end`."""
        self._steps.farewell = now_s, packets

    def notices(self) -> tuple[Text, ...]:
        """What the operator is to be told, since the last call."""
        found = []
        with suppress(Empty):
            while True:
                found.append(self._notices.get_nowait())
        return tuple(found)

    def end(self, limit_s: float) -> None:
        """Write what waits, finish the video, and end; at most for a time."""
        end_s = time.monotonic() + limit_s
        for writer in self._writers:
            writer.stop_asked.set()
        for writer in self._writers:
            if writer.ident is not None:
                writer.join(max(end_s - time.monotonic(), 0.0))
            writer.is_over = True

    def _say_once(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._notices.put(Text(Severity.WARNING, words))


# ------------------------------------------------------------------------------------------------ the threads
class _Writer(threading.Thread, Generic[_Item]):
    """Writes what is put into its queue until it is told to stop, or something goes wrong, which it says.

    Parameters
    ----------
    name : as the operator is to read it.
    limit : how many items may wait.
    flights : folder of all flights.
    """

    def __init__(self, name: str, limit: int, flights: Path, notices: SimpleQueue[Text]) -> None:
        # joined like any other, but one that is stuck in a disk must not keep the process from ending
        super().__init__(name=name, daemon=True)
        self.dropped = 0
        self.stop_asked = threading.Event()
        self.is_over = False  # nothing more is taken
        self._limit = limit
        self._flights = flights
        self._notices = notices
        self._waiting: SimpleQueue[_Item] = SimpleQueue()
        self._taken = 0
        self._seen, self._moved_s = -1, 0.0  # how many were taken when that was looked at, and since when
        self._tidied_s = float("-inf")

    def put(self, item: _Item) -> None:
        """Hand over; never waits. For one thread alone."""
        if self.is_over:
            return
        if self._waiting.qsize() >= self._limit:
            self.dropped += 1
        else:
            self._waiting.put(item)

    def is_stalled(self, now_s: float) -> bool:
        """Whether something waits, and nothing was taken for `STALLED_S` of calls."""
        if self.is_over or self._waiting.empty() or self._taken != self._seen:
            self._seen, self._moved_s = self._taken, now_s
        return now_s - self._moved_s >= STALLED_S

    def run(self) -> None:
        """Body of the thread; nothing leaves it."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        try:
            self._begin()
            self._tidied_s = time.monotonic()
            while not (self.stop_asked.is_set() and self._waiting.empty()):
                with suppress(Empty):
                    item = self._waiting.get(timeout=_TAKE_S)
                    self._taken += 1
                    self._write(item)
                if time.monotonic() - self._tidied_s >= TIDY_S:
                    self._tidied_s = time.monotonic()
                    self._tidy()
            self._finish()
        except (OSError, OutputError) as error:
            logger.warning("%s stopped: %s", self.name, _in_full(error, self._flights))
            self._say_stopped(_why(error))
        except Exception as error:  # the thread's top: a record is no reason to end a flight
            logger.exception(self.name)
            self._say_stopped(type(error).__name__)
        self.is_over = True
        with suppress(OSError, OutputError):
            self._close()

    def _say_stopped(self, why: str) -> None:
        self._notices.put(Text(Severity.WARNING, f"{self.name} stopped: {why}"[:MAX_TEXT]))

    @abstractmethod
    def _begin(self) -> None: ...

    @abstractmethod
    def _write(self, item: _Item) -> None: ...

    @abstractmethod
    def _tidy(self) -> None:
        """What is to be done now and then."""

    @abstractmethod
    def _finish(self) -> None:
        """Write what comes last."""

    @abstractmethod
    def _close(self) -> None:
        """Let go; whatever has happened."""


class _StepWriter(_Writer[tuple[Step, int]]):
    """Makes the folder, and writes steps, each of which comes with how many were dropped before."""

    def __init__(self, config: Config, flights: Path, notices: SimpleQueue[Text]) -> None:
        super().__init__("Record", MAX_STEPS, flights, notices)
        self.folder: Path | None = None  # of this flight, once it is there
        self.has_begun = threading.Event()  # or failed to
        self.failed: FailedStep | None = None
        self.farewell: tuple[float, Sequence[bytes]] | None = None
        self._config = config
        self._record: FlightRecord | None = None
        self._gap = 0

    def run(self) -> None:
        """Body of the thread."""
        try:
            super().run()
        finally:
            self.has_begun.set()

    def _begin(self) -> None:
        self._flights.mkdir(parents=True, exist_ok=True)
        make_room(self._flights, None, self._config.record, time.time())
        start_s, start_us = time.monotonic(), time.time_ns() // 1000
        folder = new_folder(self._flights, datetime.fromtimestamp(start_us / 1e6, UTC))
        self._record = FlightRecord(folder, self._config, start_s, start_us)
        self.folder = folder
        logger.info("record %s", folder)
        self.has_begun.set()

    def _write(self, item: tuple[Step, int]) -> None:
        assert self._record is not None
        step, dropped = item
        self._write_gap(dropped)
        self._record.add(step)

    def _write_gap(self, dropped: int) -> None:
        assert self._record is not None
        if dropped != self._gap:
            self._record.add_gap(dropped - self._gap)
            self._gap = dropped

    def _tidy(self) -> None:
        """Make room, look whether there is some, and see all on disk."""
        assert self._record is not None
        make_room(self._flights, self._record.folder, self._config.record, time.time())
        self._record.sync()

    def _finish(self) -> None:
        assert self._record is not None
        self._write_gap(self.dropped)
        if self.failed is not None:
            self._record.add_failed(self.failed)
        if self.farewell is not None:
            self._record.add_farewell(*self.farewell)

    def _close(self) -> None:
        if self._record is not None:
            self._record.close()


class _VideoWriter(_Writer[tuple[Frame, TrackSample, str]]):
    """Writes frames, with what was seen and the mode then, into the folder that is made for the steps."""

    def __init__(self, config: Config, flights: Path, notices: SimpleQueue[Text], steps: _StepWriter) -> None:
        super().__init__("Video", MAX_FRAMES, flights, notices)
        self._config, self._steps = config.record, steps
        self._file: LiveVideoFile | None = None

    def run(self) -> None:
        """Body of the thread."""
        self._steps.has_begun.wait()
        if self._steps.folder is not None:
            super().run()
        self.is_over = True

    def _begin(self) -> None:
        assert self._steps.folder is not None
        self._file = LiveVideoFile(self._steps.folder / VIDEO, self._config.video_frames_per_s)

    def _write(self, item: tuple[Frame, TrackSample, str]) -> None:
        assert self._file is not None
        frame, sample, mode = item
        picture = drawn(frame.image, sample, mode) if self._config.video == "overlay" else frame.image
        self._file.write(picture, frame.captured_s)

    def _tidy(self) -> None:
        """A video must fill no disk, also when nobody else looks; two at once would remove the same flights."""
        if self._steps.is_over:
            make_room(self._flights, self._steps.folder, self._config, time.time())
        else:
            check_free(self._flights, self._config)

    def _finish(self) -> None:
        """`_close` does."""

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()


def _in_full(error: OSError | OutputError, flights: Path) -> str:
    """What went wrong, with path and mend, for the log."""
    if isinstance(error, OutputError):
        return str(error)
    if isinstance(error, NoRoomError):
        return str(error.strerror)
    words = _WORDS.get(error.errno or 0, "")
    mend = f"; {words}: free some" if words == _FULL else f"; {words}: give one that can be written" if words else ""
    return f"{error.filename or flights}: {error.strerror or error}{mend}"


def _why(error: OSError | OutputError) -> str:
    """What went wrong, in few words."""
    if isinstance(error, NoRoomError):
        return error.brief
    # ours names the path and the mend, which is more than a status text holds
    cause = error.__cause__ or error if isinstance(error, OutputError) else error
    if isinstance(cause, ImportError):
        return "no PyAV"
    if isinstance(cause, OSError) and cause.errno is not None:
        return _WORDS.get(cause.errno, cause.strerror or "").lower()
    return str(cause)


# ------------------------------------------------------------------------------------------------ the overlay
def drawn(image: Image, sample: TrackSample, mode: str) -> Image:
    """Copy of a frame, (H, W, 3) BGR uint8, with the box and a line of what was made of it."""
    picture = image.copy()
    unit = max(image.shape[0] / 720, 0.5)  # sizes below are for 720 rows
    if sample.box is not None and sample.box.is_finite:
        draw_box(picture, sample.box, _GOOD_BGR if sample.is_measured else _POOR_BGR, max(1, round(2 * unit)))
    status = sample.status.name.lower() if sample.status is not None else "none"
    text = f"{mode} | target {status}, confidence {sample.confidence:.2f}" if sample.status is not None else mode
    # at the top: players have their controls at the bottom
    draw_text(picture, text, (round(12 * unit), round(30 * unit)), _LIGHT_BGR, unit)
    return picture
