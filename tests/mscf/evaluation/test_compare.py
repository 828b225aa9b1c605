import io
import re
from pathlib import Path

import numpy as np
import pytest

from mscf.errors import OutputError, SourceError
from mscf.evaluation.compare import compare
from mscf.evaluation.metrics import errors_of
from mscf.evaluation.record import Record, Run, write_record
from mscf.geometry import Box

TRUE = Box(100, 100, 40, 20)


def run_of(shift_px: float, first: int = 0) -> Run:
    """Run that starts well and is then off by so much to the right."""
    boxes = (TRUE, *(Box(TRUE.x + shift_px, TRUE.y, TRUE.w, TRUE.h),) * 9)
    return Run(first, boxes, (False,) * 10, (1.0,) * 9, errors_of(boxes, [TRUE] * 10))


def write(out: Path, tracker: str, shifts_px: dict[str, list[float]]) -> Path:
    for sequence, several in shifts_px.items():
        runs = tuple(run_of(shift_px, first) for first, shift_px in enumerate(several))
        write_record(Record(sequence, tracker, frozenset(), runs), out)
    return out / "runs" / tracker


def compared(a: Path, b: Path) -> str:
    out = io.StringIO()
    compare(a, b, out)
    return out.getvalue()


def test_a_tracker_that_is_better_everywhere_is_called_so(tmp_path: Path) -> None:
    good = {f"s{index}": [2.0 + index / 10, 1.0] for index in range(8)}
    bad = {name: [30.0, 25.0] for name in good}
    said = compared(write(tmp_path / "new", "mscf", good), write(tmp_path / "old", "mscf", bad))
    assert f"A: mscf, {tmp_path / 'new' / 'runs' / 'mscf'}: 8 sequences\n" in said
    assert "16 pairs of runs from the same start over 8 sequences;" in said
    assert "; 0 runs without its like on the other side left out." in said
    # off by 25 px or more: only the first of ten frames is within 20 px
    assert "| precision | +0.900 | +0.900 to +0.900 | 8 | 0 | real |" in said
    assert "| OP@0.5 | +0.900 | +0.900 to +0.900 | 8 | 0 | real |" in said
    for name in ("AUC", "normalised precision"):
        assert re.search(rf"^\| {name} \| \+0\.\d+ \| \+0\.\d+ to \+0\.\d+ \| 8 \| 0 \| real \|$", said, re.MULTILINE)


def test_a_difference_of_chance_is_not_shown_by_these_sequences(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    a, b = ({f"s{index}": [float(rng.uniform(0, 40))] for index in range(25)} for _ in range(2))
    said = compared(write(tmp_path, "a", a), write(tmp_path, "b", b))
    assert said.count("| not shown by these sequences |") == 4
    assert "1 interval in 10" not in said


def test_what_one_side_lacks_is_named_and_left_out(tmp_path: Path) -> None:
    a = write(tmp_path, "a", {**{f"s{index}": [1.0] for index in range(7)}, "new": [50.0]})
    write(tmp_path, "my:Tracker", {**{f"s{index}": [1.0] for index in range(6)}, "s6": [1.0, 9.0], "gone": [2.0]})
    said = compared(a, tmp_path / "runs" / "my%3ATracker")
    assert "A: a, " in said
    assert "B: my:Tracker, " in said
    assert "   not in B, left out: new\n" in said
    assert "   not in A, left out: gone\n" in said
    assert "7 pairs of runs from the same start over 7 sequences; 3 runs without" in said
    assert "| AUC | +0.000 | +0.000 to +0.000 | 0 | 0 | not shown by these sequences |" in said


@pytest.mark.parametrize(("count", "warning"), [(1, "show nothing"), (5, "show nothing"), (6, "1 interval in 10")])
def test_few_sequences_are_warned_of(count: int, warning: str, tmp_path: Path) -> None:
    a = write(tmp_path, "a", {f"s{index}": [1.0] for index in range(count)})
    b = write(tmp_path, "b", {f"s{index}": [30.0] for index in range(count)})
    said = compared(a, b)
    assert warning in said
    assert said.count("| real |") == (4 if count >= 6 else 0)


def test_folders_may_be_given_relative_and_of_one_evaluation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a = write(tmp_path, "a", {"s": [1.0]})
    write(tmp_path, "b", {"s": [30.0]})
    monkeypatch.chdir(a)
    assert "| precision | +0.900 | - | 1 | 0 | not shown by these sequences |" in compared(Path(), Path("../b"))


def test_a_folder_that_holds_no_runs_is_refused_in_one_line(tmp_path: Path) -> None:
    a = write(tmp_path, "a", {"s": [1.0]})
    (tmp_path / "runs" / "empty").mkdir()
    for wrong in (
        tmp_path,
        tmp_path / "runs",
        tmp_path / "times" / "a",
        tmp_path / "none",
        tmp_path / "runs" / "empty",
    ):
        for pair in ((a, wrong), (wrong, a)):
            with pytest.raises(SourceError, match=re.escape(f"{wrong} holds no runs: give OUT/runs/TRACKER")) as caught:
                compared(*pair)
            assert "\n" not in str(caught.value)


def test_runs_with_nothing_in_common_are_refused(tmp_path: Path) -> None:
    a, b = write(tmp_path, "a", {"s": [1.0]}), write(tmp_path, "b", {"t": [1.0]})
    with pytest.raises(SourceError, match="no run in common"):
        compared(a, b)


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    a, b = write(tmp_path, "a", {"s": [1.0]}), write(tmp_path, "b", {"s": [1.0]})
    (b / "s.csv").write_text("")
    with pytest.raises(OutputError, match=r"b.s\.csv is damaged"):
        compared(a, b)
