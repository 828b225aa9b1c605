"""`mscf eval` and `mscf eval compare`: what a user types, reads and finds in the folder."""

import json
import shutil
from pathlib import Path

import pytest

from mscf import cli


@pytest.fixture
def data(sequence_dir: Path) -> Path:
    """Two whole sequences and one whose last image is gone."""
    folder = sequence_dir.parent
    for name in ("again", "broken"):
        shutil.copytree(sequence_dir, folder / name)
    max((folder / "broken" / "img").iterdir()).unlink()
    return folder


def test_eval_prints_the_table_and_leaves_the_report(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["eval", str(data), "--tracker", "mscf", "bacf", "--out", str(out), "--strip", "mover:2,12"]
    assert cli.main(words) == 0
    said = capsys.readouterr()
    assert "| mscf" in said.out
    assert "| bacf" in said.out
    assert said.out.endswith(f"page      {out / 'index.html'}\n")
    assert "broken is left out: " in said.err
    assert {path.name for path in out.iterdir()} == {
        "evaluation.json", "index.html", "plots", "results.json", "runs", "sequences.csv", "strips", "table.md", "times"
    }  # fmt: skip
    assert {path.name for path in (out / "strips").iterdir()} == {"mover.png"}
    assert {path.name for path in (out / "plots").iterdir()} >= {"precision.png", "success.svg"}
    assert json.loads((out / "evaluation.json").read_text())["protocol"] == "ope"
    assert "broken" in (out / "index.html").read_text()


@pytest.mark.parametrize("protocol", ["tre", "sre"])
def test_resumed_with_another_tracker_it_runs_only_that_one(data: Path, tmp_path: Path, protocol: str) -> None:
    out = tmp_path / "out"
    words = ["eval", str(data), "--protocol", protocol, "--starts", "3", "--sequences", "mover", "--out", str(out)]
    assert cli.main([*words, "--tracker", "bacf"]) == 0
    before = (out / "times" / "bacf" / "mover.csv").read_bytes()
    assert cli.main([*words, "--tracker", "bacf", "mscf", "--resume"]) == 0
    assert (out / "times" / "bacf" / "mover.csv").read_bytes() == before
    assert {row["tracker"] for row in json.loads((out / "results.json").read_text())["trackers"]} == {"bacf", "mscf"}


def test_compare_says_whether_a_difference_is_real(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["eval", str(data), "--tracker", "mscf", "bacf", "--out", str(out)]) == 0
    capsys.readouterr()
    assert cli.main(["eval", "compare", str(out / "runs" / "mscf"), str(out / "runs" / "bacf")]) == 0
    said = capsys.readouterr().out
    assert "2 pairs of runs" in said
    assert "| AUC |" in said
    assert "not shown by these sequences" in said  # two sequences show nothing


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["eval", "no/such/folder"], "no/such/folder is not a folder"),
        (["eval", "{data}/mover/img"], "is no data set that can be read"),
        (["eval", "{data}", "--sequences", "mover", "--tracker", "best"], "unknown tracker 'best'"),
        (["eval", "{data}", "--sequences", "moover"], "mover"),
        (["eval", "{data}", "--strip", "mover:99"], "mover has no frame 99 to show: give 1..12"),
        (["eval", "{data}", "--strip", "mover:0"], "give a whole number from 1"),
        (["eval", "{data}", "--protocol", "vot"], "invalid choice: 'vot'"),
        (["eval", "{data}", "--sequences", "mover", "--tracker", "nano"], "--nano BACKBONE HEAD"),
        (["eval", "compare", "{data}", "{data}"], "{data}"),
        (["eval", "compare", "{data}"], "required: B"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    data: Path, tmp_path: Path, words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word.replace("{data}", str(data)) for word in words]
    try:
        status = cli.main([*words, *(["--out", str(tmp_path / "out")] if words[1] != "compare" else [])])
    except SystemExit as end:
        status = int(str(end.code))
    complaint = capsys.readouterr().err
    assert status == 2
    assert len(complaint.splitlines()) == 1
    assert text.replace("{data}", str(data)) in complaint
    assert not (tmp_path / "out").exists()
