import io
import json
import shutil
from pathlib import Path

import pytest

from mscf import bench, cli
from mscf.bench import STAGE_ENDS, BenchOptions, StageClock, run_bench
from mscf.errors import SourceError
from mscf.kernels.choice import native_fault
from mscf.source import open_source


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "FLATNESS_UPDATES", 3)


def test_it_prints_every_stage_and_the_flatness(sequence_dir: Path, tmp_path: Path) -> None:
    out = io.StringIO()
    options = BenchOptions("reference", 12, json=tmp_path / "a.json")
    result = run_bench([open_source(str(sequence_dir))], options, out)
    said = out.getvalue()
    for stage in ("features (detection)", "ADMM", "peak", "scale training", "4K, 40 px", "720p, 400 px", "memory"):
        assert stage in said
    for stages in result.stage_ms.values():
        assert sum(stages.values()) > 0
    assert {len(times) for of_source in result.update_ms.values() for times in of_source.values()} == {11}
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["preset"] == "reference"
    assert written["stage_ms"] == result.stage_ms
    assert set(written["sources"]) == set(result.update_ms)


def test_each_of_our_kernels_is_measured(sequence_dir: Path) -> None:
    out = io.StringIO()
    result = run_bench([open_source(str(sequence_dir))], BenchOptions(max_frames=5), out)
    names = {"numpy"} if native_fault() else {"numpy", "native"}
    assert set(result.stage_ms) == set(result.allocated_kb) == names
    assert {f"mscf {name}" for name in names} <= set(result.medians())
    assert ("mscf numpy takes" in out.getvalue()) is (not native_fault())
    assert native_fault() in out.getvalue()


def test_of_several_sources_each_has_its_figures(sequence_dir: Path) -> None:
    other_dir = sequence_dir.with_name("other")
    shutil.copytree(sequence_dir, other_dir)
    out = io.StringIO()
    sources = [open_source(str(folder)) for folder in (sequence_dir, other_dir)]
    result = run_bench(sources, BenchOptions(max_frames=5), out)
    assert list(result.update_ms) == [sequence_dir.name, "other"]
    assert len(result.of_all()["mscf numpy"]) == 8
    assert out.getvalue().count("\nother ") == 1


def test_a_profile_names_functions(sequence_dir: Path) -> None:
    out = io.StringIO()
    run_bench([open_source(str(sequence_dir))], BenchOptions(max_frames=5, is_profiled=True), out)
    assert "tottime" in out.getvalue()
    assert "tracker.py" in out.getvalue()


def test_every_array_that_is_shown_ends_a_stage(sequence_dir: Path) -> None:
    # a name that is not in the table is a KeyError
    for preset in ("mscf", "reference", "paper"):
        run_bench([open_source(str(sequence_dir))], BenchOptions(preset, 5), io.StringIO())
    assert StageClock().ms == {}
    assert len(STAGE_ENDS) > 10


def test_a_source_without_truth_or_with_two_frames_cannot_be_measured(sequence_dir: Path) -> None:
    with pytest.raises(SourceError, match="at least three frames"):
        run_bench([open_source(str(sequence_dir))], BenchOptions("mscf", 2), io.StringIO())
    (sequence_dir / "groundtruth.txt").unlink()
    with pytest.raises(SourceError, match=r"groundtruth\.txt"):
        run_bench([open_source(str(sequence_dir))], BenchOptions("mscf", 12), io.StringIO())


def test_a_place_that_cannot_be_written_is_named_before_the_measurement(
    sequence_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["bench", str(sequence_dir), "--json", "no/such/a.json"]) == 2
    said = capsys.readouterr()
    assert "no/such/a.json cannot be written" in said.err
    assert said.out == ""
