import resource
import shutil
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from companion.cli import main
from companion.config import Config
from companion.controller import Controller
from companion.flight_record import ABOUT, CONTROL, TLOG, RecordedFailure, RecordedStep, read_control
from companion.follower import Step, StepError
from companion.replay import replay
from sim import cli
from sim.cli import LOOK_STEPS, BoundedRecord
from sim.eyes import TrueEyes
from sim.report import PAGE
from sim.scenarios import SCENARIOS, fly
from sim.stages import stage

FLIGHT = replace(SCENARIOS["straight"], duration_s=5.0)
FREE = 600_000_000


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    found: list[Step] = []
    fly(FLIGHT, "ardupilot", TrueEyes, recorder=found.append)
    return found


@pytest.fixture
def config() -> Config:
    return FLIGHT.config(stage(FLIGHT.stage, 7))


@pytest.fixture(autouse=True)
def disk(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Bytes that are free, whatever is so on this machine; a test may change them."""
    free, usage = [FREE], shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=free[0]))
    return free


def put(record: BoundedRecord, steps: list[Step], end: int, first: int = 0) -> None:
    for k in range(first, end):
        step = steps[k % len(steps)]
        record.add(replace(step, inputs=replace(step.inputs, now_s=1000 + k / 20)))


def kept(folder: Path) -> int:
    return sum(isinstance(entry, RecordedStep) for entry in read_control(folder))


def test_a_record_with_room_is_whole_and_says_nothing(
    tmp_path: Path, config: Config, steps: list[Step], capsys: pytest.CaptureFixture[str]
) -> None:
    record = BoundedRecord(tmp_path, config)
    put(record, steps, LOOK_STEPS + 1)
    record.add_farewell(2000.0, ())
    record.close()
    assert record.stopped == ""
    assert kept(tmp_path) == LOOK_STEPS + 1
    assert capsys.readouterr() == ("", "")


def test_on_a_disk_that_is_full_before_the_flight_nothing_is_begun(
    tmp_path: Path, config: Config, steps: list[Step], disk: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    disk[0] = 100_000_000
    record = BoundedRecord(tmp_path, config)
    put(record, steps, 3)
    record.add_farewell(2000.0, ())
    record.close()
    assert list(tmp_path.iterdir()) == []
    said = f"{tmp_path} has 100 MB free, record.min_free_mb = 512: free some, or set it lower"
    assert record.stopped == said
    assert capsys.readouterr().err == f"mscf-companion: record stopped: {said}\n"


def test_a_disk_that_fills_up_in_flight_ends_the_record_at_the_next_look(
    tmp_path: Path, config: Config, steps: list[Step], disk: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    record = BoundedRecord(tmp_path, config)
    put(record, steps, 10)
    disk[0] = 500_000_000
    put(record, steps, 2 * LOOK_STEPS, 10)
    record.close()
    assert kept(tmp_path) == LOOK_STEPS - 1
    assert "500 MB free" in record.stopped
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_record_grows_no_larger_than_all_flights_may_be(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    limits = replace(config.record, max_total_mb=0.1)
    record = BoundedRecord(tmp_path, replace(config, record=limits))
    put(record, steps, 2 * LOOK_STEPS)
    record.close()
    assert kept(tmp_path) == LOOK_STEPS - 1
    assert "record.max_total_mb = 0.1" in record.stopped
    assert (tmp_path / CONTROL).stat().st_size + (tmp_path / TLOG).stat().st_size > 100_000


@pytest.fixture
def small_files() -> Iterator[None]:
    """The kernel refuses to let a file grow, as a disk that is really full does."""
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.usefixtures("small_files")
def test_a_write_that_fails_ends_the_record_and_no_flight(
    tmp_path: Path, config: Config, steps: list[Step], capsys: pytest.CaptureFixture[str]
) -> None:
    record = BoundedRecord(tmp_path, config)
    put(record, steps, 100)
    record.close()
    assert record.stopped == f"{tmp_path}: File too large"
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert 0 < kept(tmp_path) < 100


def test_a_flight_without_room_for_its_record_is_flown_judged_and_says_so_on_its_page(
    tmp_path: Path, disk: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    disk[0] = 1
    words = ["sim", "sticks", "--duration", "5", "--no-video", "--out", str(tmp_path)]
    assert main(words) == cli.EXIT_FAILED
    said = capsys.readouterr()
    assert said.err.count("record stopped: ") == 1
    assert "nan" not in said.out
    assert "not reached: begins at " in said.out
    (folder,) = tmp_path.iterdir()
    page = (folder / PAGE).read_text()
    assert "record stopped" in page
    assert SCENARIOS["sticks"].acts[0].name not in page  # at 20 s, which was never reached
    assert "record.min_free_mb = 512" in page
    assert not (folder / ABOUT).exists()


def test_the_step_in_which_the_controller_raises_ends_the_record_of_the_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Controller, now_s: float) -> None:
        if now_s > 1002:
            raise KeyError("a mistake")

    monkeypatch.setattr(Controller, "_ask", broken)
    with pytest.raises(StepError, match="KeyError: 'a mistake'"):
        main(["sim", "straight", "--duration", "5", "--no-video", "--out", str(tmp_path)])
    (folder,) = tmp_path.iterdir()
    *_, last = read_control(folder)
    assert isinstance(last, RecordedFailure)
    assert replay(folder).raised == "KeyError: 'a mistake'"


def test_a_camera_of_another_size_sees_as_wide_and_is_configured_so() -> None:
    larger = replace(FLIGHT, frame_hw=(720, 1280))
    camera, own = larger.place(0).camera, FLIGHT.place(0).camera
    assert camera.size_hw == (720, 1280)
    assert camera.size_hw[1] / camera.focal_px == own.size_hw[1] / own.focal_px
    described = larger.config(larger.place(0)).camera
    assert (described.width_px, described.height_px, described.focal_px) == (1280, 720, camera.focal_px)


@pytest.mark.parametrize(
    "size", ["", "640", "640x", "x480", "640*480", "0x0", "63x480", "640x2161", "-640x480", "9e2x480"]
)
def test_a_size_that_no_camera_has_is_refused(size: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["sim", f"--frames={size}"])
    assert "as in 1280x720" in capsys.readouterr().err
