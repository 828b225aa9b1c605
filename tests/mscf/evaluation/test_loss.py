import io
from pathlib import Path

import pytest

from mscf.evaluation.datasets import read_sequence
from mscf.evaluation.loss import Claim, Count, compare, count, main, report
from mscf.geometry import Box
from mscf.long_term import LongTermPolicy

TRUE = Box(10, 10, 20, 20)
LOOSE = Box(26, 10, 20, 20)  # overlap 1/9
OFF = Box(80, 80, 20, 20)


@pytest.mark.parametrize(
    ("claim", "true", "expected"),
    [
        (Claim(TRUE, is_measured=True, is_again=False), TRUE, Count(1, 1)),
        (Claim(TRUE, is_measured=True, is_again=True), TRUE, Count(1, 1, right_again=1)),
        (Claim(LOOSE, is_measured=True, is_again=True), TRUE, Count(1, 1, wrong=1, loose_again=1)),
        (Claim(OFF, is_measured=True, is_again=True), TRUE, Count(1, 1, wrong=1, off=1, wrong_again=1)),
        (Claim(TRUE, is_measured=True, is_again=True), None, Count(1, 0, wrong=1, off=1, wrong_again=1)),
        (Claim(OFF, is_measured=False, is_again=False), TRUE, Count(1, 1, missed=1)),
        (Claim(OFF, is_measured=False, is_again=False), None, Count(1, 0)),
    ],
)
def test_a_claim_is_judged_by_the_truth(claim: Claim, true: Box | None, expected: Count) -> None:
    assert count([claim], [true]) == expected


def test_counts_add_up() -> None:
    claims = [Claim(TRUE, is_measured=True, is_again=False), Claim(OFF, is_measured=True, is_again=False)]
    assert count(claims, [TRUE, TRUE]) == Count(2, 2, wrong=1, off=1)


def test_the_plain_tracker_claims_a_hidden_target_and_the_long_term_one_does_not(sequence_dir: Path) -> None:
    counts = compare(read_sequence(sequence_dir), 0.1, LongTermPolicy())
    hidden, frames = 3 + 2 + 2 + 2 + 2 + 1 + 1, 11 + 10 + 9 + 8 + 7 + 6 + 5  # of the seven starts
    assert counts["plain", True].off >= hidden
    assert counts["long-term", True].off < hidden / 3
    for name in ("plain", "long-term"):
        assert counts[name, False] == Count(frames=frames, visible=frames)
    out = io.StringIO()
    report({"mover": counts}, out)
    assert out.getvalue().count("| mover | plain |") == 2
    assert "| **all** | long-term | 0.0% | 0.0% | 0.0% | 0 | 0 | 0 |" in out.getvalue()


def test_a_missing_data_set_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "none")]) == 2
    assert "is not a folder" in capsys.readouterr().err
