import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import av
import numpy as np
import pytest

from companion import recorder as module
from companion.config import Config, RecordConfig, parse
from companion.flight_record import ABOUT, CONTROL, KIND, VIDEO, FlightRecord, Gap, RecordedStep, read_control
from companion.follower import Step
from companion.recorder import MAX_FRAMES, MAX_STEPS, MAX_TEXT, Recorder, drawn, flights_folder, new_folder, remove_old
from companion.types import Frame, Severity, Text, TrackSample
from mscf import Box, TrackStatus
from mscf.errors import OutputError
from mscf.recording import LiveVideoFile
from sim.eyes import TrueEyes
from sim.scenarios import SCENARIOS, fly

LIMIT_S = 40.0  # of every wait: far beyond what a busy machine needs
NOW = datetime(2026, 3, 1, 12, 30, 5, tzinfo=UTC)
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
        assert not recorder.is_alive()


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
    assert recorder._frames.qsize() + recorder.frames_dropped in {wanted, wanted + 1}


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


def test_only_the_recorder_is_nice(start: Callable[..., Recorder]) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    recorder = start(video="none")
    folder_of(recorder)
    assert recorder.native_id is not None
    assert os.getpriority(os.PRIO_PROCESS, recorder.native_id) == min(before + 10, 19) or before > 10
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
    """So does the encoder."""

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
    for _ in range(40):
        for step in steps:
            recorder.put_step(step)
        recorder.put_frame(frame_at(0.0), SAMPLE)
    until(lambda: not recorder.is_alive())
    assert not recorder.is_recording
    recorder.put_step(steps[0])
    recorder.put_frame(frame_at(1.0), SAMPLE)
    assert recorder._steps.qsize() <= MAX_STEPS
    assert told(recorder) == ["Record stopped: disk full"]


@needs_full
def test_a_disk_that_is_full_for_the_video_is_full_for_all(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.setattr(module, "FlightRecord", FullForVideo)
    recorder = start(video="plain", video_frames_per_s=10)
    for k in range(400):
        if not recorder.is_alive():
            break
        recorder.put_frame(Frame(rng.integers(0, 256, (480, 640, 3), np.uint8), k, k / 10), SAMPLE)
        until(lambda: recorder._frames.empty() or not recorder.is_alive())
    assert told(recorder) == ["Record stopped: disk full"]


@pytest.mark.parametrize("kind", [OutputError, ValueError])
def test_a_dead_encoder_ends_the_video_alone(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    class Dead(LiveVideoFile):
        def write(self, frame: object, time_s: float) -> None:
            raise kind("the encoder has died")

    monkeypatch.setattr(module, "LiveVideoFile", Dead)
    recorder = start(video="plain")
    folder = folder_of(recorder)
    for step in steps:
        recorder.put_step(step)
        recorder.put_frame(frame_at(step.inputs.now_s), SAMPLE)
    assert told(recorder) == ["Video stopped: the encoder has died"]
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
    recorder.put_step(replace(steps[0], control=object()))  # type: ignore[arg-type]
    until(lambda: not recorder.is_alive())
    assert told(recorder) == ["Record stopped: TypeError"]


def test_a_file_in_place_of_the_folder_is_told(
    start: Callable[..., Recorder], steps: list[Step], tmp_path: Path
) -> None:
    (tmp_path / "flights").write_text("mine")
    recorder = start()
    recorder.put_step(steps[0])
    assert told(recorder) == ["Record stopped: file exists"]
    assert (tmp_path / "flights").read_text() == "mine"


def test_a_disk_with_too_little_room_is_not_begun_upon(tmp_path: Path) -> None:
    config = config_of()
    recorder = Recorder(replace(config, record=replace(config.record, min_free_mb=1e6)), tmp_path)
    recorder.start()
    assert told(recorder) == ["Record stopped: disk full"]
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_meanwhile_is_noticed(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video="none")
    folder_of(recorder)
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: usage._replace(free=999_999))
    until(lambda: not recorder.is_alive())
    assert told(recorder) == ["Record stopped: disk full"]


def test_a_flight_that_alone_is_too_large_ends_its_record(
    start: Callable[..., Recorder], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TIDY_S", 0.0)
    recorder = start(video="none", max_total_mb=0.1)
    folder = folder_of(recorder)
    (folder / "ballast").write_bytes(bytes(200_000))
    until(lambda: not recorder.is_alive())
    assert told(recorder) == ["Record stopped: record.max_total_mb reached"]
    assert (folder / "ballast").exists()


class Blocked(FlightRecord):
    """Writes to a pipe that nobody reads yet, as to a disk that hangs."""

    reader = -1

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self._control.close()
        Blocked.reader, writer = os.pipe()
        self._control = os.fdopen(writer, "wb")


def test_a_writer_that_hangs_holds_nobody_up_and_what_is_dropped_is_counted(
    start: Callable[..., Recorder], steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FlightRecord", Blocked)
    recorder = start(video="plain", video_frames_per_s=60)
    folder_of(recorder)
    put = 0
    while not recorder.steps_dropped:  # a pipe holds 64 kB, the queue MAX_STEPS
        recorder.put_step(steps[put % len(steps)])
        recorder.put_frame(frame_at(float(put)), SAMPLE)
        put += 1
    assert put > MAX_STEPS
    assert recorder.frames_dropped > 0
    assert recorder._frames.qsize() <= MAX_FRAMES
    recorder.end(0.0)  # it hangs on: nobody waits for it
    assert recorder.is_alive()
    with os.fdopen(Blocked.reader, "rb") as pipe:
        lines = pipe.read().splitlines()  # the disk is back
    assert len(lines) == put
    assert lines[-1] == b'{"missing":1}'


def test_steps_that_were_dropped_leave_a_gap_that_says_how_many(steps: list[Step], tmp_path: Path) -> None:
    recorder = Recorder(config_of(video="none"), tmp_path)
    for k in range(MAX_STEPS + 5):
        recorder.put_step(steps[k % len(steps)])
    assert recorder.steps_dropped == 5
    recorder.start()
    folder = folder_of(recorder)
    until(recorder._steps.empty)
    recorder.put_step(steps[0])
    until(recorder._steps.empty)
    recorder.steps_dropped += 2
    assert told(recorder) == []
    entries = list(read_control(folder))
    assert len(entries) == MAX_STEPS + 3
    assert (entries[-3], entries[-1]) == (Gap(5), Gap(2))


def test_one_that_was_never_started_ends_at_once(tmp_path: Path) -> None:
    Recorder(config_of(), tmp_path / "flights").end(LIMIT_S)
    assert not (tmp_path / "flights").exists()


# ------------------------------------------------------------------------------------------------ the folders
def flight(flights: Path, number: int, *, size: int = 1000, age_days: float = 0.0) -> Path:
    """A record of a size and an age."""
    folder = flights / f"20260101T000000Z-{number:04d}"
    folder.mkdir(parents=True)
    (folder / ABOUT).write_text(json.dumps({"record": KIND}))
    (folder / CONTROL).write_bytes(bytes(size))
    written_s = NOW.timestamp() - age_days * 86400
    for path in folder.iterdir():
        os.utime(path, (written_s, written_s))
    return folder


def limits(total_mb: float = 1.0, days: float = 30.0) -> RecordConfig:
    return RecordConfig(max_total_mb=total_mb, max_age_days=days)


def left(flights: Path) -> list[int]:
    return sorted(int(path.name[-4:]) for path in flights.iterdir())


def test_the_oldest_flights_go_until_the_rest_fits(tmp_path: Path) -> None:
    for number in (1, 2, 3, 10):
        flight(tmp_path, number, size=400_000)
    used = remove_old(tmp_path, None, limits(1.0), NOW.timestamp())
    assert left(tmp_path) == [3, 10]
    assert 800_000 < used < 1_000_000


def test_the_running_flight_is_never_removed(tmp_path: Path) -> None:
    running = flight(tmp_path, 1, size=2_000_000, age_days=90)
    flight(tmp_path, 2)
    assert remove_old(tmp_path, running, limits(1.0), NOW.timestamp()) > 1e6
    assert left(tmp_path) == [1]


def test_flights_go_when_they_are_too_old(tmp_path: Path) -> None:
    for number, age_days in ((1, 31.0), (2, 29.0), (3, 40.0)):
        flight(tmp_path, number, age_days=age_days)
    remove_old(tmp_path, None, limits(), NOW.timestamp())
    assert left(tmp_path) == [2]


def test_a_clock_that_was_not_set_makes_no_flight_old(tmp_path: Path) -> None:
    flight(tmp_path, 1, age_days=NOW.timestamp() / 86400)  # written in 1970
    flight(tmp_path, 2)
    remove_old(tmp_path, None, limits(), NOW.timestamp())
    assert left(tmp_path) == [1, 2]
    remove_old(tmp_path, None, limits(), 0.0)
    assert left(tmp_path) == [1, 2]


def test_what_is_no_record_of_ours_stays(tmp_path: Path) -> None:
    flights, elsewhere = tmp_path / "flights", flight(tmp_path / "elsewhere", 7, age_days=99)
    flights.mkdir()
    (flights / "link-0001").symlink_to(elsewhere)
    (flights / "notes.txt").write_text("mine")
    for name, about in (("holidays", None), ("other-0002", '{"record": "other"}'), ("bad-0003", "{")):
        (flights / name).mkdir()
        if about is not None:
            (flights / name / ABOUT).write_text(about)
    before = sorted(flights.iterdir())
    for path in before:
        os.utime(path, (1e9, 1e9))
    remove_old(flights, None, limits(0.0), NOW.timestamp())
    assert sorted(flights.iterdir()) == before
    assert (elsewhere / CONTROL).exists()


def test_a_record_with_a_report_and_folders_in_it_goes_whole(tmp_path: Path) -> None:
    folder = flight(tmp_path / "flights", 1)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (folder / "more").mkdir()
    (folder / "more" / "page.html").write_text("a page")
    (folder / "link").symlink_to(tmp_path / "mine")
    remove_old(tmp_path / "flights", None, limits(0.0), NOW.timestamp())
    assert left(tmp_path / "flights") == []
    assert (tmp_path / "mine" / "notes.txt").exists()


def test_a_new_flight_is_after_all_others_whatever_the_clock_says(tmp_path: Path) -> None:
    flight(tmp_path, 41)
    (tmp_path / "notes-99").mkdir()
    early = new_folder(tmp_path, datetime(1970, 1, 1, tzinfo=UTC))
    (early / ABOUT).write_text(json.dumps({"record": KIND}))
    late = new_folder(tmp_path, NOW)
    assert (early.name, late.name) == ("19700101T000000Z-0042", "20260301T123005Z-0043")
    assert new_folder(tmp_path, NOW).name == "20260301T123005Z-0044"  # the last one says not yet what it is


@pytest.mark.parametrize(
    ("folder", "environ", "wanted"),
    [
        ("/a/b", {"STATE_DIRECTORY": "/var/lib/x"}, "/a/b"),
        ("", {"STATE_DIRECTORY": "/var/lib/x", "XDG_STATE_HOME": "/s"}, "/var/lib/x/flights"),
        ("", {"STATE_DIRECTORY": "/var/lib/x:/var/lib/y"}, "/var/lib/x/flights"),
        ("", {"XDG_STATE_HOME": "/s", "HOME": "/h"}, "/s/mscf-companion/flights"),
        ("", {"XDG_STATE_HOME": "", "HOME": "/h"}, "/h/.local/state/mscf-companion/flights"),
    ],
)
def test_flights_are_where_the_configuration_or_the_system_says(
    folder: str, environ: dict[str, str], wanted: str
) -> None:
    assert flights_folder(RecordConfig(folder=folder), environ) == Path(wanted)


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
    recorder._say_stopped("Record", "x" * 100)
    assert recorder.notices() == (Text(Severity.WARNING, ("Record stopped: " + "x" * 100)[:50]),)
    assert recorder.notices() == ()
