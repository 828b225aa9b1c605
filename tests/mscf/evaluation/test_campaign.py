import io
import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mover import FIRST, FRAMES, write_sequence

from mscf.errors import ConfigError, OutputError, SourceError
from mscf.evaluation import campaign
from mscf.evaluation.campaign import EvaluationOptions, _Job, _Progress, _run_all, evaluate, run_sequence
from mscf.evaluation.datasets import Dataset, Sequence, read_sequence
from mscf.evaluation.peers import Models, PlainTracker
from mscf.evaluation.protocol import Start, starts
from mscf.evaluation.record import write_record
from mscf.geometry import Box

ROOT = Path(__file__).resolve().parents[3]
OPE = EvaluationOptions()
TRE = EvaluationOptions(protocol="tre", tre_starts=3)

# a module of one's own; `Quick` ends the evaluation that runs it, once that has a whole result, where it is asked to
OWN = """
import os
import signal
from pathlib import Path

PARENT = os.getppid()  # once: when it has ended, the parent is another, which is not ours to end
INTERRUPT = int(os.environ.get("INTERRUPT", "0"))


class Quick:
    def init(self, frame, box):
        if not frame.any():
            os._exit(7)
        if INTERRUPT == signal.SIGINT:
            os.kill(os.getpid(), signal.SIGINT)  # Ctrl-C is the parent's: this is not to reach
        self.box, self.count = box, 0

    def update(self, frame):
        self.count += 1
        if INTERRUPT and os.getppid() == PARENT and any(Path(os.environ["OUT"]).glob("runs/*/*.csv")):
            if INTERRUPT == signal.SIGINT:
                os.killpg(PARENT, signal.SIGINT)  # as a terminal does, to all its processes
                signal.pause()  # to be ended
            os.kill(PARENT, INTERRUPT)
            while os.getppid() == PARENT:
                pass  # it takes its time to end
        third = self.count / 3
        return self.count % 4 != 0, (self.box.x + third, self.box.y, self.box.w, self.box.h)


class Other(Quick):
    pass
"""
COMMAND = """
import sys
from multiprocessing import active_children
from pathlib import Path
from mscf.evaluation.campaign import EvaluationOptions, evaluate
from mscf.evaluation.datasets import read_dataset

if __name__ == "__main__":
    data, out, is_resumed = sys.argv[1:]
    options = EvaluationOptions(protocol="tre", tre_starts=3, is_resumed=is_resumed == "yes")
    try:
        evaluate(read_dataset(Path(data)), ("own:Quick", "own:Other"), options, Path(out), sys.stderr)
    except KeyboardInterrupt:
        sys.exit(f"{len(active_children())} processes left")
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with the module of one's own, which processes that are started find."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "own.py").write_text(OWN)
    (folder / "command.py").write_text(COMMAND)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "own", raising=False)
    return folder


def made(folder: Path, *names: str) -> Dataset:
    return Dataset("made", tuple(read_sequence(write_sequence(folder / name)) for name in names), ())


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- one sequence ---


@dataclass
class Playing:
    """A tracker that answers by the number of its update; what is no answer is raised."""

    answers: dict[int, Any] = field(default_factory=dict)
    seen: list[Any] = field(default_factory=list)

    def init(self, frame: Any, box: Any) -> None:
        self.seen.append(frame)
        self._answer()

    def update(self, frame: Any) -> Any:
        self.seen.append(frame)
        return self._answer()

    def _answer(self) -> Any:
        number = len(self.seen) - 1
        answer = self.answers.get(number, (True, (number, 0, 9, 9)))
        if isinstance(answer, Exception):
            raise answer
        return answer


@dataclass(frozen=True, slots=True)
class Counted(Sequence):
    reads: list[int] = field(default_factory=list)

    def read(self, index: int) -> Any:
        self.reads.append(index)
        return read_pixels(index)


def read_pixels(index: int) -> Any:
    return np.full((4, 5, 3), index, np.uint8)


def counted(frames: int) -> Counted:
    return Counted("made", (Path("none.png"),) * frames, (Box(0, 0, 9, 9),) * frames, frozenset({"OCC"}))


def test_each_frame_is_decoded_once_and_every_run_steps_on_it_from_its_start() -> None:
    sequence, players, told = counted(6), [], []

    def make() -> PlainTracker:
        players.append(Playing())
        return PlainTracker(players[-1])

    begins = (Start(1, Box(1, 1, 9, 9)), Start(3, Box(3, 3, 9, 9)))
    records = run_sequence(sequence, {"a": make, "b": make}, begins, told.append)
    assert sequence.reads == [1, 2, 3, 4, 5]
    assert (
        sorted([int(frame[0, 0, 0]) for frame in player.seen] for player in players)
        == [[1, 2, 3, 4, 5]] * 2 + [[3, 4, 5]] * 2
    )
    assert len({id(frame) for player in players for frame in player.seen if frame[0, 0, 0] == 4}) == 1
    assert told == [2, 2, 4, 4, 4]
    assert [(record.tracker, record.sequence, record.attributes) for record in records] == [
        ("a", "made", {"OCC"}),
        ("b", "made", {"OCC"}),
    ]
    for record in records:
        early, late = record.runs
        assert early.boxes == (Box(1, 1, 9, 9), *(Box(number, 0, 9, 9) for number in range(1, 5)))
        assert late.boxes == (Box(3, 3, 9, 9), Box(1, 0, 9, 9), Box(2, 0, 9, 9))
        assert (early.first, late.first) == (1, 3)
        assert [len(run.update_ms) for run in record.runs] == [4, 2]
        assert early.errors.center_px.tolist() == [math.sqrt(2), 1, 2, 3, 4]
        assert not any((*early.is_lost, *late.is_lost, early.fault, late.fault))


def run_of(answers: dict[int, Any]) -> Any:
    begins = (Start(0, Box(5, 5, 9, 9)),)
    makes = {"a": lambda: PlainTracker(Playing(answers))}
    (record,) = run_sequence(counted(5), makes, begins, lambda _: None)
    return record.runs[0]


def test_a_tracker_that_reports_loss_or_raises_keeps_its_last_box_and_is_counted() -> None:
    run = run_of({2: (False, (7, 7, 7, 7)), 3: ValueError("of its own\nsecond line"), 4: OSError("later")})
    assert run.boxes == (Box(5, 5, 9, 9), *(Box(1, 0, 9, 9),) * 4)
    assert run.is_lost == (False, False, True, True, True)
    assert run.fault == "ValueError: of its own"
    assert [math.isnan(ms) for ms in run.update_ms] == [False, False, True, True]


def test_a_tracker_that_raises_once_goes_on() -> None:
    run = run_of({2: ValueError("once")})
    assert [box.x for box in run.boxes] == [5, 1, 1, 3, 4]
    assert run.is_lost == (False, False, True, False, False)


@pytest.mark.parametrize("box", [None, (1, 2, 0, 4), (math.nan, 2, 3, 4)])
def test_an_answer_that_is_no_box_is_a_fault(box: Any) -> None:
    run = run_of({1: (True, box)})
    assert run.boxes[1] == run.boxes[0]
    assert run.is_lost[1]
    assert run.fault.startswith("BoxError: update gave the box")


def test_a_tracker_that_refuses_the_first_box_stays_on_it_and_is_lost_from_then_on() -> None:
    run = run_of({0: ValueError("too small")})
    assert run.boxes == (Box(5, 5, 9, 9),) * 5
    assert run.is_lost == (False, True, True, True, True)
    assert run.fault == "ValueError: too small"
    assert all(map(math.isnan, run.update_ms))


def test_no_tracker_can_spoil_a_frame_for_the_others() -> None:
    class Painter:
        def init(self, frame: Any, box: Any) -> None:
            pass

        def update(self, frame: Any) -> Any:
            frame[:] = 255
            return True, (1, 1, 9, 9)

    player = Playing()
    makes = {"painter": lambda: PlainTracker(Painter()), "player": lambda: PlainTracker(player)}
    painter, _ = run_sequence(counted(3), makes, (Start(0, Box(0, 0, 9, 9)),), lambda _: None)
    assert [frame.max() for frame in player.seen] == [0, 1, 2]
    assert "read-only" in painter.runs[0].fault


def test_a_broken_image_names_itself(sequence_dir: Path) -> None:
    (sequence_dir / "img" / "000003.png").write_bytes(b"broken")
    with pytest.raises(SourceError, match=r"000003\.png is not an image"):
        run_sequence(read_sequence(sequence_dir), {}, (Start(0, FIRST),), lambda _: None)


# --- all sequences ---


@pytest.mark.usefixtures("own")
def test_what_is_broken_is_left_out_and_the_rest_goes_on(tmp_path: Path) -> None:
    dataset = made(tmp_path / "data", "broken", "crash", "good")
    dataset.sequences[0].images[3].write_bytes(b"broken")
    black = dataset.sequences[1].images[0]
    cv2.imwrite(str(black), np.zeros((96, 128, 3), np.uint8))
    absent = replace(dataset.sequences[2], name="absent", truth=(None,) * FRAMES)
    dataset = replace(dataset, sequences=(*dataset.sequences, absent))
    log, out = io.StringIO(), tmp_path / "out"
    records = evaluate(dataset, ("own:Quick", "bacf"), replace(OPE, jobs=2), out, log)
    assert [(record.tracker, record.sequence) for record in records] == [("own:Quick", "good"), ("bacf", "good")]
    about = json.loads((out / "evaluation.json").read_text())
    assert about["left_out"].keys() == {"broken", "crash", "absent"}
    assert "000004.png is not an image" in about["left_out"]["broken"]
    assert "ended with status 7" in about["left_out"]["crash"]
    assert "no true box" in about["left_out"]["absent"]
    for name, why in about["left_out"].items():
        assert f"{name} is left out: {why}" in log.getvalue()
    assert len(files(out / "runs")) == 2
    (quick, bacf) = (record.runs[0] for record in records)
    assert sum(quick.is_lost) == 2
    assert np.mean(bacf.errors.overlap) > 0.8

    dataset.sequences[2].images[0].write_bytes(b"broken")
    dataset = replace(dataset, sequences=dataset.sequences[2:3])
    assert evaluate(dataset, ("own:Quick", "own:Other"), replace(OPE, is_resumed=True), out, log) == ()
    about = json.loads((out / "evaluation.json").read_text())
    assert about["left_out"].keys() == {"broken", "crash", "absent", "good"}


@pytest.mark.usefixtures("own")
def test_frames_of_a_sequence_that_is_left_out_are_not_waited_for(tmp_path: Path) -> None:
    (sequence,) = made(tmp_path / "data", "broken").sequences
    sequence.images[3].write_bytes(b"broken")
    job = _Job(sequence, (Start(0, FIRST),), ("own:Quick", "own:Other"), OPE, tmp_path / "out")
    progress = _Progress(job.frames, io.StringIO())
    assert _run_all([job], 1, progress).keys() == {"broken"}
    assert progress._done == progress._total == 6


def run_command(own: Path, data: Path, out: Path, *, is_resumed: bool, interrupt: int = 0) -> tuple[int, str]:
    environment = {**os.environ, "PYTHONPATH": f"{own}{os.pathsep}{ROOT}", "OUT": str(out), "INTERRUPT": str(interrupt)}
    command = [sys.executable, own / "command.py", data, out, "yes" if is_resumed else "no"]
    done = subprocess.run(
        command, env=environment, stderr=subprocess.PIPE, text=True, check=False, timeout=60, start_new_session=True
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize("interrupt", [signal.SIGINT, signal.SIGKILL])
def test_interrupting_and_resuming_gives_the_files_of_an_uninterrupted_run(
    own: Path, tmp_path: Path, interrupt: signal.Signals
) -> None:
    dataset, out = made(tmp_path / "data", "a", "b", "c"), tmp_path / "out"
    names = ("own:Quick", "own:Other")
    evaluate(dataset, names, replace(TRE, jobs=2), tmp_path / "whole", io.StringIO())
    whole = files(tmp_path / "whole" / "runs")
    assert len(whole) == 6

    dataset = replace(dataset, name="data")  # as it is read from the folder
    status, said = run_command(own, tmp_path / "data", out, is_resumed=False, interrupt=int(interrupt))
    if interrupt == signal.SIGINT:
        assert status == 1
        assert said.splitlines() == [
            f"interrupted: what is whole is in {out}; the same command with --resume goes on",
            "0 processes left",
        ]
    else:
        assert (status, said) == (-interrupt, "")
    first = files(out)
    done = {name: data for name, data in first.items() if name.startswith("runs")}
    assert len(done) == 2

    status, said = run_command(own, tmp_path / "data", out, is_resumed=True)
    assert (status, said) == (0, "")
    assert files(out / "runs") == whole
    again = files(out)
    assert all(again[name] == data for name, data in first.items() if name.startswith(("runs", "times")))


# --- the folder ---

NOTHING = Dataset("made", (), ())


def test_a_folder_with_results_is_refused_unless_resumed(tmp_path: Path) -> None:
    evaluate(NOTHING, ("mscf",), TRE, tmp_path / "out", io.StringIO())
    before = files(tmp_path / "out")
    with pytest.raises(OutputError, match=r"out holds results: go on with them by --resume, or give another folder"):
        evaluate(NOTHING, ("mscf",), TRE, tmp_path / "out", io.StringIO())
    assert files(tmp_path / "out") == before


@pytest.mark.parametrize(
    ("dataset", "options", "expected"),
    [
        (NOTHING, replace(TRE, protocol="sre"), "protocol tre, and this is sre"),
        (NOTHING, replace(TRE, tre_starts=4), "starts 3, and this is 4"),
        (Dataset("other", (), ()), TRE, "dataset made, and this is other"),
    ],
)
def test_a_folder_of_something_else_is_refused(
    tmp_path: Path, dataset: Dataset, options: EvaluationOptions, expected: str
) -> None:
    evaluate(NOTHING, ("mscf",), TRE, tmp_path / "out", io.StringIO())
    before = files(tmp_path / "out")
    with pytest.raises(OutputError, match=f"out holds results with {expected}"):
        evaluate(dataset, ("mscf",), replace(options, is_resumed=True), tmp_path / "out", io.StringIO())
    assert files(tmp_path / "out") == before


def test_a_folder_made_with_other_models_is_refused_and_more_trackers_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "tracker_factory", lambda *_: None)  # the files are no models
    model, out = tmp_path / "one.onnx", tmp_path / "out"
    model.write_bytes(b"one")
    resumed = replace(OPE, is_resumed=True)
    evaluate(NOTHING, ("mscf",), resumed, out, io.StringIO())
    evaluate(NOTHING, ("vit",), replace(resumed, models=Models(vit=model)), out, io.StringIO())
    about = json.loads((out / "evaluation.json").read_text())
    assert about["trackers"] == ["mscf", "vit"]
    assert about["files"]["vit"].startswith("one.onnx, sha256 ")
    model.write_bytes(b"another")
    with pytest.raises(OutputError, match=r"holds results with vit one\.onnx, sha256 .*, and this is one\.onnx"):
        evaluate(NOTHING, ("vit",), replace(resumed, models=Models(vit=model)), out, io.StringIO())
    with pytest.raises(OutputError, match=r"with color_table the package's own, and this is one\.onnx"):
        evaluate(NOTHING, ("mscf",), replace(resumed, color_table=model), out, io.StringIO())


def test_results_from_other_first_boxes_are_refused(tmp_path: Path) -> None:
    dataset, out = made(tmp_path / "data", "a"), tmp_path / "out"
    (sequence,) = dataset.sequences
    moved = replace(sequence, truth=(Box(1, 1, 20, 20), *sequence.truth[1:]))
    make = {"mscf": lambda: PlainTracker(Playing())}
    evaluate(NOTHING, ("mscf",), OPE, out, io.StringIO())
    for record in run_sequence(moved, make, starts(moved, "ope"), lambda _: None):
        write_record(record, out)
    with pytest.raises(OutputError, match="holds results of another a: mscf started from other"):
        evaluate(dataset, ("mscf",), replace(OPE, is_resumed=True), out, io.StringIO())


@pytest.mark.parametrize("content", ["", "[]", None])
def test_results_that_do_not_say_what_they_are_of_are_refused(tmp_path: Path, content: str | None) -> None:
    (tmp_path / "runs").mkdir()
    if content is not None:
        (tmp_path / "evaluation.json").write_text(content)
    with pytest.raises(OutputError, match=r"evaluation\.json.*(cannot be read|is not of an evaluation)"):
        evaluate(NOTHING, ("mscf",), replace(OPE, is_resumed=True), tmp_path, io.StringIO())


def test_an_unknown_tracker_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown tracker 'best'"):
        evaluate(NOTHING, ("mscf", "best"), OPE, tmp_path / "out", io.StringIO())
    assert not (tmp_path / "out").exists()


def test_an_evaluation_says_what_it_is_of(tmp_path: Path) -> None:
    evaluate(NOTHING, ("mscf",), TRE, tmp_path / "out", io.StringIO())
    about = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert (about["dataset"], about["protocol"], about["starts"], about["sequences"]) == ("made", "tre", 3, [])
    assert {"command", "mscf", "python", "numpy", "opencv", "machine", "processors"} <= about.keys()


# --- progress ---


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_has_a_bar_of_all_frames_with_the_time_left() -> None:
    log = Terminal()
    with _Progress(40, log) as progress:
        progress.advance(10)
        progress.say("a is left out")
        progress.drop(10)
        progress.advance(20)
        assert progress._bar is not None
        progress._bar.refresh()
    assert "0/40" in log.getvalue()
    assert "30/30" in log.getvalue()
    assert "a is left out\n" in log.getvalue()
    assert "<" in log.getvalue()


def test_elsewhere_there_is_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    log = io.StringIO()
    with _Progress(40, log) as progress:
        progress.advance(10)
    assert log.getvalue() == ""
    monkeypatch.setattr(campaign, "LINE_EVERY_S", 0.0)
    with _Progress(40, log) as progress:
        progress.advance(10)
    assert log.getvalue() == "10 of 40 frames (25%), 00:00 left\n"
