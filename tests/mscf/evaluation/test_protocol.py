import io
from pathlib import Path

import pytest

from mscf.errors import ConfigError, SourceError
from mscf.evaluation.datasets import Sequence, read_dataset, read_sequence
from mscf.evaluation.peers import CSRT, has_csrt, tracker_factory
from mscf.evaluation.protocol import run_dataset, run_sequence, starts
from mscf.evaluation.report import print_table
from mscf.geometry import Box
from mscf.images import read_truth


def sequence_of(truth: list[Box | None]) -> Sequence:
    return Sequence("made", tuple(Path(f"{i}.png") for i in range(len(truth))), tuple(truth))


BOXES: list[Box | None] = [Box(i, 0, 20, 20) for i in range(10)]


def test_one_pass_starts_at_the_first_box() -> None:
    assert [(s.index, s.box) for s in starts(sequence_of(BOXES), "ope")] == [(0, BOXES[0])]


def test_jitter_is_the_true_box_and_its_eight_neighbours() -> None:
    found = starts(sequence_of(BOXES), "jitter")
    assert found[0].box == BOXES[0]
    assert {(s.box.x, s.box.y) for s in found} == {(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    assert all(s.index == 0 and (s.box.w, s.box.h) == (20, 20) for s in found)


def test_temporal_starts_are_spread_over_the_sequence() -> None:
    assert [s.index for s in starts(sequence_of(BOXES), "tre")] == [0, 2, 4, 6, 8]


def test_a_gap_in_the_truth_moves_a_start_and_never_doubles_one() -> None:
    truth = BOXES[:2] + [None] * 4 + BOXES[6:]
    assert [s.index for s in starts(sequence_of(truth), "tre")] == [0, 6, 8]


def test_a_box_that_is_too_small_is_no_start() -> None:
    truth = [*BOXES[:2], Box(0, 0, 3, 20), *BOXES[3:]]
    assert [s.index for s in starts(sequence_of(truth), "tre")] == [0, 3, 4, 6, 8]


def test_a_run_is_scored_against_the_truth_from_its_start_on(sequence_dir: Path) -> None:
    runs = run_sequence(read_sequence(sequence_dir), "mscf", "tre")
    assert len(runs) == 5
    for run in runs:
        assert run.score.precision == 1
        assert run.score.auc > 0.6
        assert len(run.update_ms) == 12 - 1 - run.start.index


def test_several_processes_give_what_one_gives(sequence_dir: Path) -> None:
    sequences = read_dataset(sequence_dir.parent)
    scores = []
    for jobs in (1, 2):
        runs = run_dataset(sequences, ("bacf", "mscf"), "ope", color_table=None, jobs=jobs, log=io.StringIO())
        scores.append({(run.tracker, run.score) for run in runs})
    assert scores[0] == scores[1]


def test_the_first_broken_image_ends_the_run_and_names_itself(sequence_dir: Path) -> None:
    (sequence_dir / "img" / "000003.png").write_bytes(b"broken")
    with pytest.raises(SourceError, match=r"000003\.png is not an image"):
        run_dataset(read_dataset(sequence_dir.parent), ("mscf",), "ope", color_table=None, jobs=1, log=io.StringIO())


def test_the_table_is_the_mean_over_runs_then_over_sequences(sequence_dir: Path) -> None:
    out = io.StringIO()
    runs = run_sequence(read_sequence(sequence_dir), "mscf", "jitter")
    print_table(runs, ["mscf"], "jitter", out)
    mean = sum(run.score.auc for run in runs) / 9
    assert f"| mover | 1.000 / {mean:.3f} |" in out.getvalue()
    assert f"| mean | **1.000 / {mean:.3f}** |" in out.getvalue()


def test_an_unknown_tracker_or_table_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown tracker 'best'"):
        tracker_factory("best")
    with pytest.raises(ConfigError, match="cannot be read"):
        tracker_factory("mscf", tmp_path / "none.npz")


@pytest.mark.skipif(has_csrt(), reason="this cv2 has CSRT")
def test_where_csrt_is_missing_it_says_how_to_get_it() -> None:
    with pytest.raises(ConfigError, match="opencv-contrib-python-headless in place of"):
        tracker_factory(CSRT)


# --- reading ---


def test_truth_may_be_separated_by_comma_tab_or_blank_and_absent(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text("1,2,3,4\n5\t6\t7\t8\n9 10 11 12\nNaN,NaN,NaN,NaN\n0,0,0,0\n\n2,2,2,2\n\n")
    assert read_truth(path) == (Box(0, 1, 3, 4), Box(4, 5, 7, 8), Box(8, 9, 11, 12), None, None, None, Box(1, 1, 2, 2))


@pytest.mark.parametrize("line", ["1,2,3", "1,2,3,4,5", "a,b,c,d"])
def test_a_line_that_is_no_box_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text(f"1,2,3,4\n{line}\n")
    with pytest.raises(SourceError, match="line 2: expected x,y,w,h"):
        read_truth(path)


def test_a_sequence_whose_parts_do_not_fit_is_refused(sequence_dir: Path) -> None:
    (sequence_dir / "img" / "000012.png").unlink()
    with pytest.raises(SourceError, match="11 images and 12 lines"):
        read_sequence(sequence_dir)
    (sequence_dir / "groundtruth.txt").unlink()
    with pytest.raises(SourceError, match="is no sequence"):
        read_sequence(sequence_dir)
