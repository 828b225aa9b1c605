import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mscf.errors import OutputError
from mscf.evaluation.metrics import Errors, errors_of
from mscf.evaluation.record import Record, Run, read_record, read_records, read_tracker, tracker_of, write_record
from mscf.geometry import Box

TRUE = Box(10, 10, 40, 20)


def run_of(first: int = 0, frames: int = 4, fault: str = "") -> Run:
    boxes = tuple(Box(10 + index / 3, 10, 40 + 0.1 * index, 20) for index in range(frames))
    errors = errors_of(boxes, [TRUE, None, TRUE, TRUE, TRUE][:frames])
    is_lost = tuple(index == frames - 1 for index in range(frames))
    return Run(first, boxes, is_lost, tuple(5 + index / 7 for index in range(frames - 1)), errors, fault)


def record_of(sequence: str = "truck2", tracker: str = "mscf", runs: tuple[Run, ...] | None = None) -> Record:
    return Record(sequence, tracker, frozenset({"OCC", "FM"}), (run_of(), run_of(7, 2)) if runs is None else runs)


def assert_same(found: Record | None, expected: Record) -> None:
    assert found is not None
    assert (found.sequence, found.tracker, found.attributes) == (
        expected.sequence,
        expected.tracker,
        expected.attributes,
    )
    assert len(found.runs) == len(expected.runs)
    for one, two in zip(found.runs, expected.runs, strict=True):
        for name in ("first", "boxes", "is_lost", "update_ms", "fault"):
            assert getattr(one, name) == getattr(two, name)
        for name in ("overlap", "center_px", "center_norm"):
            assert getattr(one.errors, name).tobytes() == getattr(two.errors, name).tobytes()


def files(folder: Path) -> dict[str, bytes]:
    return {f"{path.relative_to(folder)}": path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


numbers = st.floats(allow_nan=False)
names = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=12)


@st.composite
def runs(draw: st.DrawFn) -> Run:
    count = draw(st.integers(1, 5))
    several = st.lists(numbers | st.just(np.nan), min_size=count, max_size=count)
    return Run(
        draw(st.integers(0, 10_000)),
        tuple(draw(st.lists(st.builds(Box, numbers, numbers, numbers, numbers), min_size=count, max_size=count))),
        tuple(draw(st.lists(st.booleans(), min_size=count, max_size=count))),
        tuple(draw(st.lists(numbers, min_size=count - 1, max_size=count - 1))),
        Errors(*(np.array(draw(several), dtype=np.float64) for _ in range(3))),
        draw(st.text(max_size=20)),
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(
    st.builds(Record, names, names, st.frozensets(st.text(max_size=5)), st.lists(runs(), max_size=4).map(tuple)),
)
def test_what_was_written_is_read_back_to_the_last_bit(tmp_path: Path, record: Record) -> None:
    write_record(record, tmp_path)
    assert_same(read_record(tmp_path, record.tracker, record.sequence), record)


def test_whole_numbers_and_numbers_of_other_kinds_are_written_as_floats(tmp_path: Path) -> None:
    plain = replace(run_of(frames=1), boxes=(Box(10.0, 10.0, 40.0, 20.0),))
    odd = replace(plain, boxes=(Box(10, np.float64(10), np.float32(40), 20),), is_lost=(np.True_,))
    for folder, run in (("plain", plain), ("odd", odd)):
        write_record(record_of(runs=(run,)), tmp_path / folder)
    assert files(tmp_path / "plain") == files(tmp_path / "odd")


def test_what_is_not_there_is_none(tmp_path: Path) -> None:
    assert read_record(tmp_path, "mscf", "truck2") is None
    assert read_records(tmp_path) == ()
    assert read_tracker(tmp_path, "mscf") == ()


def test_times_alone_change_the_files_of_times_alone(tmp_path: Path) -> None:
    for folder, factor in (("a", 1), ("b", 3)):
        slow = tuple(replace(run, update_ms=tuple(factor * ms for ms in run.update_ms)) for run in record_of().runs)
        write_record(record_of(runs=slow), tmp_path / folder)
    a, b = files(tmp_path / "a"), files(tmp_path / "b")
    assert a.keys() == b.keys() == {"runs/mscf/truck2.csv", "times/mscf/truck2.csv"}
    assert [name for name in a if a[name] != b[name]] == ["times/mscf/truck2.csv"]


def test_a_file_is_a_table_that_other_programs_read(tmp_path: Path) -> None:
    write_record(record_of(), tmp_path)
    lines = (tmp_path / "runs" / "mscf" / "truck2.csv").read_text().splitlines()
    assert json.loads(lines[1].removeprefix("# "))["attributes"] == ["FM", "OCC"]
    table = [line for line in lines if not line.startswith("#")]
    assert table[0] == "run,frame,x,y,w,h,is_lost,overlap,center_px,center_norm"
    assert table[1] == "0,0,10.0,10.0,40.0,20.0,0,1.0,0.0,0.0"
    assert table[2].endswith(",0,nan,nan,nan")
    assert [line.split(",")[:2] for line in table[1:]] == [["0", f"{i}"] for i in range(4)] + [["1", "7"], ["1", "8"]]


@pytest.mark.parametrize(
    "name", ["my.trackers:Best", "bacf+al", "a/b", "..", ".", ".hidden", "ä b", "100%", "a\\b", "x.csv", "odd\udc80"]
)
def test_any_name_becomes_one_safe_file_name_and_is_read_back(name: str, tmp_path: Path) -> None:
    write_record(record_of(sequence=name, tracker=name), tmp_path)
    (path,) = (tmp_path / "runs").glob("*/*")
    safe = r"[A-Za-z0-9_~+%-][A-Za-z0-9_.~+%-]*"
    assert re.fullmatch(rf"{safe}/{safe}\.csv", f"{path.relative_to(tmp_path / 'runs')}")
    assert tracker_of(path.parent) == name
    (found,) = read_records(tmp_path)
    assert_same(found, record_of(sequence=name, tracker=name))


def test_records_come_sorted_by_tracker_and_sequence(tmp_path: Path) -> None:
    for tracker, sequence in (("mscf", "b"), ("csrt", "z"), ("mscf", "a"), ("bacf+al", "a")):
        write_record(record_of(sequence, tracker), tmp_path)
    expected = [("bacf+al", "a"), ("csrt", "z"), ("mscf", "a"), ("mscf", "b")]
    assert [(record.tracker, record.sequence) for record in read_records(tmp_path)] == expected
    assert [record.sequence for record in read_tracker(tmp_path, "mscf")] == ["a", "b"]


@pytest.mark.parametrize("folder", ["runs", "times"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda data: data[:-1],
        lambda data: data[:-3],
        lambda data: data[: data.rindex(b"\n", 0, -1) + 1],
        lambda data: data + b"\n",
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data[:-2] + bytes([data[-2] ^ 1]) + data[-1:],
        lambda data: b"\xff" + data,
    ],
    ids=["empty", "no end", "half a number", "a row less", "a line more", "other ends", "a bit", "not text"],
)
def test_a_damaged_file_is_named(folder: str, damage: object, tmp_path: Path) -> None:
    assert callable(damage)
    write_record(record_of(), tmp_path)
    path = tmp_path / folder / "mscf" / "truck2.csv"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(OutputError, match=re.escape(f"{path} is damaged")):
        read_record(tmp_path, "mscf", "truck2")
    with pytest.raises(OutputError, match=re.escape(f"{path} is damaged")):
        read_records(tmp_path)


def test_every_bit_of_a_file_matters(tmp_path: Path) -> None:
    write_record(record_of(runs=(run_of(frames=2),)), tmp_path)
    path = tmp_path / "runs" / "mscf" / "truck2.csv"
    data = path.read_bytes()
    for index in range(len(data)):
        path.write_bytes(data[:index] + bytes([data[index] ^ 0x10]) + data[index + 1 :])
        with pytest.raises(OutputError, match="is damaged"):
            read_record(tmp_path, "mscf", "truck2")


def test_missing_times_or_those_of_other_runs_are_named(tmp_path: Path) -> None:
    write_record(record_of(), tmp_path)
    write_record(record_of("other", runs=(run_of(),)), tmp_path)
    times = tmp_path / "times" / "mscf"
    (times / "other.csv").rename(times / "truck2.csv")
    with pytest.raises(OutputError, match=re.escape(f"{times / 'truck2.csv'} is not of the runs in")):
        read_record(tmp_path, "mscf", "truck2")
    with pytest.raises(OutputError, match=re.escape(f"{times / 'other.csv'} cannot be read: No such file")):
        read_record(tmp_path, "mscf", "other")


# writes a record again and again, over nothing or over one of no run, in a process that dies before its first step
# on a file, before its second, and so on until it comes through; after each, prints how many runs are read back
DYING = """
import os, sys
from pathlib import Path
import numpy as np
from mscf.evaluation.metrics import Errors
from mscf.evaluation.record import Record, Run, read_record, write_record
from mscf.geometry import Box

class Steps:
    left = sys.maxsize
    def __call__(self, event, arguments):
        if event in ("open", "os.rename", "os.mkdir", "os.remove") and sys.argv[1] in str(arguments[0]):
            if self.left == 0:
                os._exit(9)
            self.left -= 1

out, steps, status, tried = Path(sys.argv[1]), Steps(), 9, 0
sys.addaudithook(steps)
run = Run(0, (Box(1, 2, 3, 4),), (False,), (), Errors(np.zeros(1), np.zeros(1), np.zeros(1)))
while status == 9:
    if sys.argv[2] == "over another":
        write_record(Record("s", "t", frozenset(), ()), out)
    child = os.fork()
    if child == 0:
        steps.left = tried
        write_record(Record("s", "t", frozenset(), (run,)), out)
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    tried += 1
    found = read_record(out, "t", "s")
    print("nothing" if found is None else len(found.runs))
assert status == 0
"""


@pytest.mark.parametrize(("before", "first"), [("over nothing", "nothing"), ("over another", "0")])
def test_a_process_that_dies_while_it_writes_leaves_nothing_that_counts_as_done(
    before: str, first: str, tmp_path: Path
) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", DYING, str(tmp_path / "out"), before],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    states = ran.stdout.split()
    assert len(states) > 5
    assert states[0] == first
    assert states[-1] == "1"
    assert states == sorted(states, key=[first, "nothing", "1"].index)
    assert "nothing" in states
    assert not list(tmp_path.rglob("*.part"))


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "times").write_text("a file where a folder is to be")
    with pytest.raises(OutputError, match=r"times.mscf.truck2\.csv cannot be written: "):
        write_record(record_of(), tmp_path)
    assert read_records(tmp_path) == ()


def test_a_record_whose_parts_do_not_fit_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    for wrong in (replace(run_of(), update_ms=(1.0,)), replace(run_of(), is_lost=(True,))):
        with pytest.raises(ValueError, match="zip"):
            write_record(record_of(runs=(wrong,)), tmp_path)
    assert files(tmp_path) == {}
