import errno
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from companion import recorder as module
from companion.config import Config, parse
from companion.flight_record import VIDEO, Farewell, FlightRecord, Gap, RecordedFailure, RecordedStep, read_control
from companion.follower import FailedStep, Step
from companion.recorder import MAX_FRAMES, MAX_STEPS, MAX_TEXT, NICE, STALLED_S, Recorder, drawn
from companion.types import Frame, Severity, Text, TrackSample
from mscf import Box, TrackStatus
from mscf.errors import OutputError
from mscf.recording import LiveVideoFile
from sim.eyes import TrueEyes
from sim.scenarios import SCENARIOS, fly

LIMIT_S = 40.0  # of every wait: far beyond what a busy machine needs
BEHIND, STALLED = "Record behind: steps are lost", "Record stalled"
SAMPLE = TrackSample(0, 0.0, 0.0, (48, 64), 1, TrackStatus.TRACKING, is_measured=True, box=Box(20, 10, 16, 12))


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    found: list[Step] = []
    fly(replace(SCENARIOS["straight"], duration_s=3.0), "ardupilot", TrueEyes, recorder=found.append)
    return found


def config_of(**record: object) -> Config:
    config = parse("[camera]\nfocal_px = 900\n")
    return replace(config, record=replace(config.record, min_free_mb=1.0, **record))  # type: ignore[arg-type]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Recorder]]:
    """Starts recorders that are ended whatever happens."""
    running: list[Recorder] = []

    def begin(**record: object) -> Recorder:
        running.append(Recorder(config_of(**record), tmp_path / "flights"))
        running[-1].start()
        return running[-1]

    yield begin
    for recorder in running:
        recorder.end(LIMIT_S)
        assert not any(writer.is_alive() for writer in recorder._writers)


def frame_at(captured_s: float, level: int = 100) -> Frame:
    return Frame(np.full((48, 64, 3), level, np.uint8), 0, captured_s)


def until(is_there: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not is_there():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def told(recorder: Recorder) -> list[str]:
    """All that the operator is told, once it has ended."""
    recorder.end(LIMIT_S)
    texts = recorder.notices()
    assert all(text.severity is Severity.WARNING and len(text.text) <= MAX_TEXT for text in texts)
    return [text.text for text in texts]


def texts_of(recorder: Recorder) -> list[str]:
    return [text.text for text in recorder.notices()]


def waiting_frames(recorder: Recorder) -> int:
    assert recorder._video is not None
    return recorder._video._waiting.qsize()


def times_s(path: Path) -> list[float]:
    with av.open(str(path)) as container:
        return [float(frame.time) for frame in container.decode(video=0)]


def folder_of(recorder: Recorder) -> Path:
    until(lambda: recorder.folder is not None)
    assert recorder.folder is not None
    return recorder.folder


# ------------------------------------------------------------------------------------------------ what is kept
def test_steps_and_frames_end_in_the_record(start: Callable[..., Recorder], steps: list[Step]) -> None:
    recorder = start(video="plain", video_frames_per_s=10)
    folder = folder_of(recorder)
    assert recorder.is_recording
    for step in steps:
        recorder.put_step(step)
    recorder.put_frame(frame_at(5.0), SAMPLE)
    recorder.put_frame(frame_at(5.5), SAMPLE)
    assert told(recorder) == []
    assert not recorder.is_recording
    assert (recorder.steps_dropped, recorder.frames_dropped) == (0, 0)
    entries = [entry for entry in read_control(folder) if isinstance(entry, RecordedStep)]
    assert [entry.inputs for entry in entries] == [step.inputs for step in steps]
    assert times_s(folder / VIDEO) == [0.0, 0.5]


@pytest.mark.parametrize(("camera_hz", "wanted"), [(30, 20), (60, 20), (10, 20), (25, 20), (5, 10)])
def test_frames_are_thinned_before_they_wait(camera_hz: int, wanted: int, tmp_path: Path) -> None:
    recorder = Recorder(config_of(video="plain", video_frames_per_s=10), tmp_path)
    for k in range(2 * camera_hz):
        recorder.put_frame(frame_at(100 + k / camera_hz), SAMPLE)
    # one more where the next one is all but due at the end
    assert waiting_frames(recorder) + recorder.frames_dropped in {wanted, wanted + 1}


def test_a_frame_is_drawn_upon_only_in_the_record(start: Callable[..., Recorder]) -> None:
    recorder = start(video="overlay")
    folder = folder_of(recorder)
    frame = frame_at(0.0)
    recorder.put_frame(frame, SAMPLE)
    assert told(recorder) == []
    assert (frame.image == 100).all()
    with av.open(str(folder / VIDEO)) as container:
        picture = next(container.decode(video=0)).to_ndarray(format="bgr24")
    assert np.ptp(picture) > 60


def test_without_a_video_no_frame_waits(start: Callable[..., Recorder]) -> None:
    recorder = start(video="none")
    folder = folder_of(recorder)
    recorder.put_frame(frame_at(0.0), SAMPLE)
    assert told(recorder) == []
    assert not (folder / VIDEO).exists()


def test_only_the_threads_of_the_recorder_are_nice(start: Callable[..., Recorder]) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    recorder = start(video="plain")
    folder_of(recorder)
    for writer in recorder._writers:
        until(lambda number=writer.native_id or -1: os.getpriority(os.PRIO_PROCESS, number) == max(before, NICE))  # type: ignore[misc]
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def test_the_last_words_are_the_last_line(start: Callable[..., Recorder], steps: list[Step]) -> None:
    recorder = start(video="none")
    folder = folder_of(recorder)
    recorder.put_step(steps[0])
    recorder.put_farewell(steps[0].inputs.now_s + 1, ())
    recorder.end(LIMIT_S)
    assert [type(entry).__name__ for entry in read_control(folder)] == ["RecordedStep", "Farewell"]


# ------------------------------------------------------------------------------------------------ what goes wrong
class Full(FlightRecord):
    """Writes to a disk that is full."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self._control.close()
        self._control = open("/dev/full", "wb")  # noqa: PTH123, SIM115


class FullForVideo(FlightRecord):
    """Has a place for the video on a disk that is full."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        (self.folder / VIDEO).symlink_to("/dev/full")


needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system to write to")


@needs_full
def test_a_full_disk_ends_the_record_with_one_text(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FlightRecord", Full)
    recorder = start(video="plain")
    for _ in range(MAX_STEPS // len(steps)):
        for step in steps:
            recorder.put_step(step)
        recorder.put_frame(frame_at(0.0), SAMPLE)
    until(lambda: not recorder._steps.is_alive())
    assert not recorder.is_recording
    recorder.put_step(steps[0])
    recorder.put_frame(frame_at(1.0), SAMPLE)
    assert recorder._steps._waiting.qsize() <= MAX_STEPS
    assert told(recorder) == ["Record stopped: disk full"]


@needs_full
def test_the_video_goes_on_without_the_steps(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FlightRecord", Full)
    recorder = start(video="plain", video_frames_per_s=10)
    folder = folder_of(recorder)
    for k in range(MAX_STEPS):
        recorder.put_step(steps[k % len(steps)])
    until(lambda: not recorder._steps.is_alive())
    for k in range(3):
        recorder.put_frame(frame_at(k / 10), SAMPLE)
    assert told(recorder) == ["Record stopped: disk full"]
    assert times_s(folder / VIDEO) == [0.0, 0.1, 0.2]


@needs_full
def test_the_steps_go_on_where_the_video_finds_the_disk_full(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.setattr(module, "FlightRecord", FullForVideo)
    recorder = start(video="plain", video_frames_per_s=10)
    folder = folder_of(recorder)
    assert recorder._video is not None
    for k in range(400):
        if recorder._video.is_over:
            break
        recorder.put_frame(Frame(rng.integers(0, 256, (480, 640, 3), np.uint8), k, k / 10), SAMPLE)
        until(lambda: waiting_frames(recorder) == 0 or recorder._video.is_over)  # type: ignore[union-attr]
    for step in steps:
        recorder.put_step(step)
    assert recorder.is_recording
    assert told(recorder) == ["Video stopped: disk full"]
    assert len(list(read_control(folder))) == len(steps)


@pytest.mark.parametrize(
    ("error", "why"), [(OutputError("the encoder has died"), "the encoder has died"), (ValueError(""), "ValueError")]
)
def test_a_dead_encoder_ends_the_video_alone(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch, error: Exception, why: str
) -> None:
    class Dead(LiveVideoFile):
        def write(self, frame: object, time_s: float) -> None:
            raise error

    monkeypatch.setattr(module, "LiveVideoFile", Dead)
    recorder = start(video="plain")
    folder = folder_of(recorder)
    for step in steps:
        recorder.put_step(step)
        recorder.put_frame(frame_at(step.inputs.now_s), SAMPLE)
    assert told(recorder) == [f"Video stopped: {why}"]
    assert len(list(read_control(folder))) == len(steps)


def test_without_pyav_there_is_no_video_and_it_is_said_once(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    recorder = start(video="plain")
    folder = folder_of(recorder)
    for step in steps:
        recorder.put_step(step)
        recorder.put_frame(frame_at(step.inputs.now_s), SAMPLE)
    assert told(recorder) == ["Video stopped: no PyAV"]
    assert len(list(read_control(folder))) == len(steps)


def test_what_cannot_be_recorded_ends_the_record_and_nothing_else(
    start: Callable[..., Recorder], steps: list[Step]
) -> None:
    recorder = start(video="none")
    recorder.put_step(replace(steps[0], control=replace(steps[0].control, notes=object())))  # type: ignore[arg-type]
    until(lambda: not recorder._steps.is_alive())
    assert told(recorder) == ["Record stopped: TypeError"]


def test_a_file_in_place_of_the_folder_is_told(
    start: Callable[..., Recorder], steps: list[Step], tmp_path: Path
) -> None:
    (tmp_path / "flights").write_text("mine")
    recorder = start()
    recorder.put_step(steps[0])
    assert told(recorder) == ["Record stopped: record.folder is no folder"]
    assert (tmp_path / "flights").read_text() == "mine"


def test_a_disk_with_too_little_room_is_not_begun_upon(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    config = config_of()
    recorder = Recorder(replace(config, record=replace(config.record, min_free_mb=1e6)), tmp_path)
    recorder.start()
    assert told(recorder) == ["Record stopped: below record.min_free_mb"]
    assert list(tmp_path.iterdir()) == []
    (line,) = caplog.messages
    for words in ("Record stopped: ", str(tmp_path), "MB free, record.min_free_mb = 1e+06: free some, or set it lower"):
        assert words in line


@pytest.mark.parametrize(
    ("video", "wanted"),
    [
        ("none", ["Record stopped: below record.min_free_mb"]),
        ("plain", ["Record stopped: below record.min_free_mb", "Video stopped: below record.min_free_mb"]),
    ],
)
def test_a_disk_that_fills_up_meanwhile_is_noticed(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch, video: str, wanted: list[str]
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video=video)
    folder_of(recorder)
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=999_999))
    until(lambda: not any(writer.is_alive() for writer in recorder._writers))
    assert sorted(told(recorder)) == wanted


def test_a_video_fills_no_disk_while_the_steps_hang(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, is_back = threading.Event(), threading.Event()

    def hang(_: FlightRecord) -> None:
        hangs.set()
        is_back.wait(LIMIT_S)

    monkeypatch.setattr(module, "TIDY_S", 0.0)
    monkeypatch.setattr(FlightRecord, "sync", hang)
    recorder = start(video="plain")
    try:
        assert hangs.wait(LIMIT_S)
        usage = shutil.disk_usage("/")
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=999_999))
        until(lambda: recorder._video is not None and recorder._video.is_over)
        assert texts_of(recorder) == ["Video stopped: below record.min_free_mb"]
        assert recorder.is_recording
    finally:
        is_back.set()


def test_a_record_that_was_removed_meanwhile_is_noticed(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video="none")
    folder = folder_of(recorder)
    folder.rename(folder.with_name("elsewhere"))
    until(lambda: not recorder._steps.is_alive())
    assert told(recorder) == ["Record stopped: record.folder is gone"]


def test_a_flight_that_alone_is_too_large_ends_its_record(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video="none", max_total_mb=0.1)
    folder = folder_of(recorder)
    (folder / "ballast").write_bytes(bytes(200_000))
    until(lambda: not recorder._steps.is_alive())
    assert told(recorder) == ["Record stopped: record.max_total_mb reached"]
    assert (folder / "ballast").exists()


def test_a_video_whose_steps_have_ended_is_no_larger_than_a_flight_may_be(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video="plain", max_total_mb=0.1)
    folder = folder_of(recorder)
    recorder.put_step(replace(steps[0], control=replace(steps[0].control, notes=object())))  # type: ignore[arg-type]
    until(lambda: not recorder._steps.is_alive())
    assert recorder._video is not None
    assert recorder._video.is_alive()
    (folder / "ballast").write_bytes(bytes(200_000))
    until(lambda: not recorder._video.is_alive())  # type: ignore[union-attr]
    assert told(recorder) == ["Record stopped: TypeError", "Video stopped: record.max_total_mb reached"]


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR, errno.ENOSPC])
def test_what_stops_a_record_has_its_mend_in_a_status_text_and_its_path_in_the_log(
    start: Callable[..., Recorder],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
    number: int,
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(module, "make_room", refuse)
    (text,) = told(start(video="none"))
    assert ("disk full" if number == errno.ENOSPC else "record.folder") in text
    (line,) = caplog.messages
    assert line.startswith(f"Record stopped: {tmp_path / 'flights'}: {os.strerror(number)}; ")
    assert text.removeprefix("Record stopped: ") in line


def test_the_step_that_the_controller_failed_in_comes_after_the_others_and_before_the_last_words(
    start: Callable[..., Recorder], steps: list[Step]
) -> None:
    recorder = start(video="none")
    folder = folder_of(recorder)
    recorder.put_step(steps[0])
    recorder.put_failed(FailedStep(steps[1].inputs, steps[1].received, "ValueError: x"))
    recorder.put_farewell(steps[1].inputs.now_s, ())
    recorder.end(LIMIT_S)
    _, failure, farewell = read_control(folder)
    assert failure == RecordedFailure(steps[1].inputs, "ValueError: x")
    assert farewell == Farewell(steps[1].inputs.now_s, ())


def test_inputs_that_cannot_be_recorded_cost_neither_the_exception_nor_the_last_words(
    start: Callable[..., Recorder], steps: list[Step]
) -> None:
    recorder = start(video="none")
    folder = folder_of(recorder)
    recorder.put_failed(FailedStep(replace(steps[1].inputs, track=object()), (), "AttributeError: x"))  # type: ignore[arg-type]
    recorder.put_farewell(steps[1].inputs.now_s, ())
    assert told(recorder) == []
    failure, farewell = read_control(folder)
    assert failure == RecordedFailure(None, "AttributeError: x")
    assert farewell == Farewell(steps[1].inputs.now_s, ())


class Blocked(FlightRecord):
    """Writes to a pipe that nobody reads yet, as to a disk that hangs."""

    reader = -1

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self._control.close()
        Blocked.reader, writer = os.pipe()
        self._control = os.fdopen(writer, "wb")


def at(step: Step, now_s: float) -> Step:
    return replace(step, inputs=replace(step.inputs, now_s=now_s))


def test_a_disk_that_hangs_holds_nobody_up_and_the_video_goes_on(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FlightRecord", Blocked)
    recorder = start(video="plain", video_frames_per_s=10)
    folder = folder_of(recorder)
    put = 0
    while not recorder.steps_dropped:  # a pipe holds 64 kB, the queue MAX_STEPS
        recorder.put_step(at(steps[put % len(steps)], 0.0))
        put += 1
        assert put < 2 * MAX_STEPS
    assert put > MAX_STEPS
    assert texts_of(recorder) == [BEHIND]
    recorder.put_step(at(steps[0], STALLED_S - 0.1))
    assert texts_of(recorder) == []
    recorder.put_step(at(steps[0], STALLED_S + 0.1))
    assert texts_of(recorder) == [STALLED]
    recorder.put_step(at(steps[0], 3 * STALLED_S))
    assert texts_of(recorder) == []  # each is said once
    assert recorder.steps_dropped == 4
    for k in range(20):
        recorder.put_frame(frame_at(k / 10), SAMPLE)
        until(lambda: waiting_frames(recorder) == 0)
    recorder.end(0.0)  # it hangs on: nobody waits for it
    assert recorder._steps.is_alive()
    until(lambda: not recorder._video.is_alive())  # type: ignore[union-attr]
    assert len(times_s(folder / VIDEO)) == 20
    with os.fdopen(Blocked.reader, "rb") as pipe:
        lines = pipe.read().splitlines()  # the disk is back
    assert len(lines) == put
    assert lines[-1] == b'{"missing":4}'


def test_an_encoder_that_hangs_takes_no_step_with_it(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, is_back = threading.Event(), threading.Event()

    class Hanging(LiveVideoFile):
        def write(self, frame: object, time_s: float) -> None:
            hangs.set()
            is_back.wait(LIMIT_S)

    monkeypatch.setattr(module, "LiveVideoFile", Hanging)
    recorder = start(video="plain", video_frames_per_s=10)
    folder = folder_of(recorder)
    count = MAX_STEPS + 300
    try:
        recorder.put_frame(frame_at(0.0), SAMPLE)
        assert hangs.wait(LIMIT_S)
        for k in range(count):
            recorder.put_step(at(steps[k % len(steps)], k / 20))
            recorder.put_frame(frame_at(1 + k / 20), SAMPLE)
            if k % 100 == 0:
                until(recorder._steps._waiting.empty)
        assert texts_of(recorder) == ["Video of the record stalled"]
        assert recorder.steps_dropped == 0
        assert waiting_frames(recorder) == MAX_FRAMES
        assert recorder.frames_dropped > 0
        recorder.end(0.0)
        until(lambda: not recorder._steps.is_alive())
        assert recorder._video is not None
        assert recorder._video.is_alive()
        assert len(list(read_control(folder))) == count
    finally:
        is_back.set()


def test_a_folder_that_is_long_in_coming_holds_nobody_up(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    is_back = threading.Event()
    monkeypatch.setattr(module, "make_room", lambda *_: is_back.wait(LIMIT_S))
    recorder = start(video="plain", video_frames_per_s=10)
    try:
        for k in range(3):
            recorder.put_frame(frame_at(k / 10), SAMPLE)
            recorder.put_step(at(steps[k], k * STALLED_S))
        assert texts_of(recorder) == [STALLED, "Video of the record stalled"]
        assert not recorder.is_recording
    finally:
        is_back.set()
    folder = folder_of(recorder)
    assert told(recorder) == []
    assert len(list(read_control(folder))) == 3
    assert times_s(folder / VIDEO) == [0.0, 0.1, 0.2]


def test_who_is_slow_but_takes_something_is_not_stalled(steps: list[Step], tmp_path: Path) -> None:
    recorder = Recorder(config_of(video="none"), tmp_path)
    for k in range(300):  # 15 s of flight; the test is the thread, which is always behind
        recorder.put_step(at(steps[0], k / 20))
        if k % 80 == 79:
            recorder._steps._waiting.get()
            recorder._steps._taken += 1
    assert texts_of(recorder) == []
    recorder.put_step(at(steps[0], 300 / 20 + STALLED_S))
    assert texts_of(recorder) == [STALLED]


def test_who_has_nothing_to_take_is_not_stalled(steps: list[Step], tmp_path: Path) -> None:
    recorder = Recorder(config_of(video="plain"), tmp_path)
    for k in range(300):
        recorder.put_step(at(steps[0], k / 20))
        recorder._steps._waiting.get()  # and the camera is away
        recorder._steps._taken += 1
    assert texts_of(recorder) == []


def test_steps_that_were_dropped_leave_a_gap_that_says_how_many(steps: list[Step], tmp_path: Path) -> None:
    recorder = Recorder(config_of(video="none"), tmp_path)
    for k in range(MAX_STEPS + 5):
        recorder.put_step(steps[k % len(steps)])
    assert recorder.steps_dropped == 5
    recorder.start()
    folder = folder_of(recorder)
    until(recorder._steps._waiting.empty)
    recorder.put_step(steps[0])
    until(recorder._steps._waiting.empty)
    recorder._steps.dropped += 2
    assert told(recorder) == [BEHIND]
    entries = list(read_control(folder))
    assert len(entries) == MAX_STEPS + 3
    assert (entries[-3], entries[-1]) == (Gap(5), Gap(2))


def test_one_that_was_never_started_ends_at_once(tmp_path: Path) -> None:
    Recorder(config_of(), tmp_path / "flights").end(LIMIT_S)
    assert not (tmp_path / "flights").exists()


# ------------------------------------------------------------------------------------------------ the overlay
@pytest.mark.parametrize("size_hw", [(48, 64), (720, 1280), (2160, 3840)])
def test_the_box_is_drawn_where_it_is(size_hw: tuple[int, int]) -> None:
    image, (rows, cols) = np.full((*size_hw, 3), 90, np.uint8), size_hw
    box = Box(cols / 2, rows / 2, cols / 4, rows / 4)
    picture = drawn(image, replace(SAMPLE, box=box), "following")
    assert (image == 90).all()
    assert picture.shape == image.shape
    assert (picture[rows // 2, cols * 5 // 8] != 90).any()
    assert (picture[rows * 5 // 8, cols // 2] != 90).any()
    assert (picture[rows * 5 // 8, cols * 5 // 8] == 90).all()


@pytest.mark.parametrize(
    "box", [None, Box(np.nan, 0, 1, 1), Box(1e300, -1e300, 1e300, 1), Box(-5, -5, 500, 500), Box(0, 0, 0, 0)]
)
def test_no_box_makes_the_overlay_raise(box: Box | None) -> None:
    for status in (None, *TrackStatus):
        picture = drawn(np.zeros((48, 64, 3), np.uint8), replace(SAMPLE, box=box, status=status), "")
        assert picture.shape == (48, 64, 3)


def test_a_text_for_the_operator_fits_into_one_status_text(tmp_path: Path) -> None:
    recorder = Recorder(config_of(), tmp_path)
    recorder._steps._say_stopped("x" * 100)
    assert recorder.notices() == (Text(Severity.WARNING, ("Record stopped: " + "x" * 100)[:50]),)
    assert recorder.notices() == ()
