"""The calibration against regressions and curves worked by hand, and end to end on a small target."""

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mscf import Tracker
from mscf.confidence import BIAS, LOG_PSR, peak_to_sidelobe
from mscf.evaluation.calibration import (
    CHOSEN,
    Responses,
    Table,
    collect,
    equal_weights,
    features_of,
    fit_logistic,
    log_loss,
    logistic,
    main,
    peak_to_energy,
    reliability,
    report,
    roc,
)
from mscf.evaluation.datasets import read_sequence


def test_the_fit_recovers_the_coefficients_that_made_the_data(rng: np.random.Generator) -> None:
    x = rng.normal(0, 1, (20_000, 2))
    true = np.array([0.5, 2.0, -1.0])
    is_held = rng.uniform(size=len(x)) < logistic(x, true)
    assert fit_logistic(x, is_held, np.ones(len(x))) == pytest.approx(true, abs=0.1)


def test_a_weight_counts_as_so_many_rows(rng: np.random.Generator) -> None:
    x = rng.normal(0, 1, (50, 1))
    is_held = x[:, 0] + rng.normal(0, 1, 50) > 0
    weight = rng.integers(1, 4, 50)
    repeated = fit_logistic(np.repeat(x, weight, axis=0), np.repeat(is_held, weight), np.ones(weight.sum()))
    assert fit_logistic(x, is_held, weight.astype(float)) == pytest.approx(repeated)


def test_separable_data_have_finite_coefficients() -> None:
    x = np.linspace(-1, 1, 20)[:, None]
    found = fit_logistic(x, x[:, 0] > 0, np.ones(20))
    assert np.isfinite(found).all()
    assert found[1] > 5


@pytest.mark.parametrize(
    ("p", "held", "area"),
    [
        ([0.1, 0.2, 0.8, 0.9], [False, False, True, True], 1.0),
        ([0.9, 0.8, 0.2, 0.1], [False, False, True, True], 0.0),
        ([0.5, 0.5, 0.5, 0.5], [False, False, True, True], 0.5),
        ([0.1, 0.3, 0.2, 0.4], [False, False, True, True], 0.75),  # three of four pairs are in order
        ([0.1, 0.2], [True, True], math.nan),
    ],
)
def test_the_area_is_the_share_of_pairs_in_order(p: list[float], held: list[bool], area: float) -> None:
    assert roc(np.array(p), np.array(held), np.ones(len(p))).auc == pytest.approx(area, nan_ok=True)


def test_every_sequence_has_the_same_weight() -> None:
    weight = equal_weights(np.array([0, 0, 0, 2, 2, 5]))
    assert weight == pytest.approx([2 / 3, 2 / 3, 2 / 3, 1, 1, 2])


def test_log_loss_is_that_of_the_definition() -> None:
    loss = log_loss(np.array([0.8, 0.4]), np.array([True, False]), np.array([1.0, 3.0]))
    assert loss == pytest.approx(-(math.log(0.8) + 3 * math.log(0.6)) / 4)


def spread(rng: np.random.Generator, sequences: int) -> Table:
    """Made rows whose probability is the logistic function of their features."""
    parts = []
    for index in range(sequences):
        x = rng.normal(0, 1, (400, 16))
        features = dict(zip(features_of(np.zeros((1, 4))), x.T, strict=True))
        p = logistic(np.column_stack([features[name] for name in CHOSEN]), np.array([1.0, 2.0]))
        flags = np.arange(400) % 2 == 0
        parts.append(Responses(f"made{index}", features, rng.uniform(size=400) < p, ~flags & (p < 0), ~flags))
    return Table.of(parts)


def test_made_confidence_is_reliable_on_the_sequence_left_out(rng: np.random.Generator) -> None:
    table = spread(rng, 6)
    p = table.left_out(CHOSEN)
    for each in reliability(table, p, np.ones(len(p), bool)):
        assert each.low <= each.mean <= each.high
        assert each.held == pytest.approx(each.mean, abs=0.15)
    assert sum(each.rows for each in reliability(table, p, table.is_staged)) == table.is_staged.sum()


def test_a_sequence_is_not_judged_by_itself(rng: np.random.Generator) -> None:
    table = spread(rng, 3)
    p = table.left_out(CHOSEN)
    last = table.sequence == 2
    table.is_held[last] = ~table.is_held[last]
    again = table.left_out(CHOSEN)
    assert again[last] == pytest.approx(p[last])
    assert np.abs(again[~last] - p[~last]).max() > 0.05


def test_the_report_has_the_fitted_coefficients_and_every_candidate(rng: np.random.Generator) -> None:
    out = io.StringIO()
    figures = report(spread(rng, 4), out)
    assert figures["coefficients"] == pytest.approx({"bias": 1.0, "PSR": 2.0}, abs=0.3)
    for name in ("threat", "PSR", "recent APCE", "PSR + recent peak over first"):
        assert f"| {name} |" in out.getvalue()


def test_the_energy_ratio_is_that_of_the_definition() -> None:
    single = np.full((50, 50), 3.0, np.float32)
    single[7, 9] = 5.0
    assert peak_to_energy(single) == pytest.approx(2500)  # one cell of all has all the energy
    half = np.zeros((50, 50), np.float32)
    half[:25] = 1
    assert peak_to_energy(half) == pytest.approx(2)
    assert peak_to_energy(np.full((50, 50), 7, np.float32)) == 1


def test_candidates_are_seen_now_of_late_and_against_the_start() -> None:
    rows = np.zeros((8, 4))
    rows[:5, 2] = [1.0, 2.0, 3.0, 4.0, 5.0]
    rows[5:, 2] = 10.0
    features = features_of(rows)
    assert features["PSR"] == pytest.approx(rows[:, 2])
    assert features["PSR over first"][[0, 4, 5, 7]] == pytest.approx([0.0, 2.0, 7.0, 7.0])
    assert features["recent PSR"][1] == pytest.approx(1.2)
    assert features["recent PSR over first"][1] == pytest.approx(1.2 - 1.5)
    assert not features["recent threat"].any()


def test_what_is_calibrated_is_what_the_tracker_uses(sequence_dir: Path) -> None:
    sequence = read_sequence(sequence_dir)
    tracker, rows, said = Tracker(), [], []
    box = sequence.truth[0]
    assert box is not None
    tracker.init(sequence.read(0), box)
    for index in range(1, 12):
        seen: dict[str, Any] = {}
        said.append(tracker.update(sequence.read(index), probe=seen.__setitem__).confidence)
        rows.append((0.0, 0.0, math.log(peak_to_sidelobe(seen["response"])), 0.0))
    features = features_of(np.array(rows))
    p = logistic(np.column_stack([features[name] for name in CHOSEN]), np.array([BIAS, LOG_PSR]))
    assert p == pytest.approx(said)


def test_frames_with_the_target_covered_are_labelled_as_without_it(sequence_dir: Path) -> None:
    found = collect(read_sequence(sequence_dir))
    assert found.is_staged.sum() == len(found.is_held) / 2 == 11 + 10 + 9 + 8 + 7 + 6 + 5  # starts in the first half
    assert found.is_covered.sum() == 3 + 2 + 2 + 2 + 2 + 1 + 1
    assert not found.is_held[found.is_covered].any()
    assert found.is_held[~found.is_staged].all()


def test_the_command_writes_table_plot_and_figures(
    sequence_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (sequence_dir.parent / "again").symlink_to(sequence_dir)
    plot, figures = tmp_path / "roc.png", tmp_path / "figures.json"
    assert main([str(sequence_dir.parent), "--plot", str(plot), "--json", str(figures)]) == 0
    assert "fitted : BIAS" in capsys.readouterr().out
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert json.loads(figures.read_text())["rows"] == 2 * 2 * 56


def test_a_missing_data_set_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "none")]) == 2
    assert "is not a folder" in capsys.readouterr().err
