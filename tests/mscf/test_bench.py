import io
import json
from pathlib import Path

import pytest

from mscf import cli
from mscf.bench import STAGE_ENDS, StageClock, run_bench
from mscf.errors import SourceError
from mscf.source import open_source


def test_it_prints_every_stage_and_the_flatness(sequence_dir: Path, tmp_path: Path) -> None:
    out = io.StringIO()
    result = run_bench(open_source(str(sequence_dir)), "reference", 12, out, tmp_path / "a.json")
    said = out.getvalue()
    for stage in ("features (detection)", "ADMM", "peak", "scale training", "4K, 40 px", "720p, 400 px"):
        assert stage in said
    assert sum(result.stage_ms.values()) > 0
    assert len(result.update_ms) == 11
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["preset"] == "reference"
    assert written["stage_ms"] == result.stage_ms


def test_every_array_that_is_shown_ends_a_stage(sequence_dir: Path) -> None:
    # a name that is not in the table is a KeyError
    for preset in ("mscf", "reference", "paper"):
        run_bench(open_source(str(sequence_dir)), preset, 5, io.StringIO())
    assert StageClock().ms == {}
    assert len(STAGE_ENDS) > 10


def test_a_source_without_truth_or_with_two_frames_cannot_be_measured(sequence_dir: Path) -> None:
    with pytest.raises(SourceError, match="at least three frames"):
        run_bench(open_source(str(sequence_dir)), "mscf", 2, io.StringIO())
    (sequence_dir / "groundtruth.txt").unlink()
    with pytest.raises(SourceError, match=r"groundtruth\.txt"):
        run_bench(open_source(str(sequence_dir)), "mscf", 12, io.StringIO())


def test_a_place_that_cannot_be_written_is_named_before_the_measurement(
    sequence_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["bench", str(sequence_dir), "--json", "no/such/a.json"]) == 2
    said = capsys.readouterr()
    assert "no/such/a.json cannot be written" in said.err
    assert said.out == ""
