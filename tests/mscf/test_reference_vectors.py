"""Preset `reference`, stage by stage, against arrays dumped from the published implementation.

Each stage is given the dumped input, so that a failure names the stage. Tolerances are those of the
reference data's README: features 2e-4 absolute (single-precision integral images and approximate square roots
over there), spectra 1e-4 of the largest value, response 1e-5 of its maximum, threat 5e-6, peak 1e-5 cells.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mscf import Box, TrackerConfig
from mscf.features.color_names import load_table
from mscf.filter import FilterState, Model, learn, restrict, solve_g
from mscf.kernels import Kernels
from mscf.labels import ideal_label
from mscf.mutation import threat_in_window
from mscf.plan import Plan
from mscf.scale import ScaleFilter, estimate_scale, train_scale
from mscf.spectrum import dft

FEATURES = 2e-4
SPECTRA = 1e-4
RESPONSE = 1e-5
FRAME_HW = {"Gull2": (720, 1280), "S1301": (540, 1024)}
FIRST = [("Gull2", 1), ("S1301", 1)]
LATER = [("Gull2", 2), ("Gull2", 3), ("S1301", 2), ("S1301", 3)]

Dump = dict[str, Any]


@pytest.fixture(scope="module")
def table_path(reference_dir: Path) -> Path:
    return reference_dir / "color_names_reference.npz"


@pytest.fixture(scope="module")
def config(table_path: Path) -> TrackerConfig:
    return TrackerConfig.preset("reference", color_table=table_path)


@pytest.fixture
def dump(reference_dir: Path, sequence: str, frame: int) -> Dump:
    with np.load(reference_dir / "vectors" / f"{sequence}_f{frame}.npz") as archive:
        return dict(archive)


@pytest.fixture
def before(reference_dir: Path, sequence: str, frame: int) -> Dump:
    with np.load(reference_dir / "vectors" / f"{sequence}_f{frame - 1}.npz") as archive:
        return dict(archive)


@pytest.fixture
def plan(kernels: Kernels, config: TrackerConfig, reference_dir: Path, sequence: str) -> Plan:
    with np.load(reference_dir / "vectors" / f"{sequence}_f1.npz") as first:
        box = Box.from_one_based(*first["rect"].tolist())
    return Plan.make(config, (*FRAME_HW[sequence], 3), box, is_gray=False, kernels=kernels)


def assert_close(ours: Any, theirs: Any, share: float) -> None:
    """Equal to a share of the largest value there."""
    theirs = np.asarray(theirs)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=share * np.abs(theirs).max())


def channel_first(array: Any) -> Any:
    return np.ascontiguousarray(np.moveaxis(array, -1, 0))


@pytest.mark.parametrize(("sequence", "frame"), FIRST)
def test_geometry_windows_and_labels_are_those_of_the_published_code(dump: Dump, plan: Plan) -> None:
    assert plan.base_hw == pytest.approx(tuple(dump["base_target_sz"]))
    assert (plan.support.rows_inv.shape[0], plan.support.cols_inv.shape[1]) == tuple(dump["small_filter_sz"])
    assert plan.scale.model_hw == tuple(dump["scale_model_sz"])
    assert plan.scale.limits == pytest.approx((dump["min_scale_factor"].item(), dump["max_scale_factor"].item()))
    np.testing.assert_allclose(plan.scale.factors, dump["scaleFactors"].ravel(), rtol=1e-12)
    np.testing.assert_allclose(plan.scale.window, dump["scale_window"].ravel(), atol=1e-6)
    assert_close(plan.scale.label_f, dump["ysf"].ravel()[:17], 1e-6)
    np.testing.assert_allclose(plan.window, dump["cos_window"], atol=1e-6)
    np.testing.assert_allclose(plan.gaussian, dump["y1"], atol=1e-6)
    np.testing.assert_array_equal(plan.pedestal, dump["y_2"])


@pytest.mark.parametrize("stage", ["det", "train"])
@pytest.mark.parametrize(("sequence", "frame"), LATER)
def test_features_of_a_patch_are_those_of_the_published_code(
    kernels: Kernels, dump: Dump, table_path: Path, stage: str
) -> None:
    patch = np.ascontiguousarray(dump[f"patch_{stage}"][..., ::-1])  # RGB there, BGR here
    features = kernels.feature_stack(patch, load_table(table_path))
    np.testing.assert_allclose(features[0], dump[f"gray_{stage}"].squeeze(), atol=FEATURES)
    np.testing.assert_allclose(features[1:32], channel_first(dump[f"hog_{stage}"]), atol=FEATURES)
    np.testing.assert_allclose(features[32:], channel_first(dump[f"cn_{stage}"]), atol=FEATURES)


@pytest.mark.parametrize(("sequence", "frame"), FIRST + LATER)
def test_training_gives_the_published_filter_and_label(dump: Dump, plan: Plan, config: TrackerConfig) -> None:
    seen: Dump = {}
    learned = learn(
        Model.of(channel_first(dump["model_xf_half"]), plan.kernels),
        dump["omega_f"][:, :26].astype(np.complex64),
        dump["rp_f"][:, :26].astype(np.complex64),
        threat=dump["tau"].item(),
        support=plan.support,
        cfg=config,
        kernels=plan.kernels,
        probe=seen.__setitem__,
    )
    assert_close(seen["h_stage1"], channel_first(dump["h_stage1"]), SPECTRA)
    assert_close(learned.g_f, channel_first(dump["g_f_half"]), SPECTRA)
    assert_close(learned.label_f, dump["r_f"][:, :26], SPECTRA)


@pytest.mark.parametrize(("sequence", "frame"), FIRST + LATER)
def test_the_restricted_filter_is_the_published_one(dump: Dump, plan: Plan, config: TrackerConfig) -> None:
    model = Model.of(channel_first(dump["model_xf_half"]), plan.kernels)
    state = FilterState.start(model, plan.support, mu=config.penalty)
    for label in ("omega_f", "omega_f", "r_f", "r_f"):
        a_f, _ = solve_g(state, model, dump[label][:, :26].astype(np.complex64), 2500, plan.kernels)
        state = restrict(state, a_f, model, plan.support, config, plan.kernels)
    assert_close(state.h, channel_first(dump["h_final"]), SPECTRA)


@pytest.mark.parametrize(("sequence", "frame"), LATER)
def test_ideal_label_has_the_published_pedestal(dump: Dump, plan: Plan, config: TrackerConfig) -> None:
    label = ideal_label(plan.gaussian, plan.pedestal, height=config.pedestal_height, threat=dump["tau"].item())
    assert_close(dft(label), dump["omega_f"][:, :26], SPECTRA)


@pytest.mark.parametrize(("sequence", "frame"), LATER)
def test_response_is_the_published_one(dump: Dump, before: Dump, plan: Plan) -> None:
    maps = np.concatenate([dump["gray_det"].reshape(50, 50, 1), dump["hog_det"], dump["cn_det"]], axis=2)
    sample_f = plan.kernels.windowed_dft(channel_first(maps).astype(np.float32), plan.window)
    response_f = plan.kernels.correlate(channel_first(before["g_f_half"]), sample_f)
    response = plan.kernels.inverse_dft(response_f, plan.grid_mn)
    assert_close(response, dump["response"], RESPONSE)


@pytest.mark.parametrize(("sequence", "frame"), LATER)
def test_peak_is_found_between_the_same_cells(kernels: Kernels, dump: Dump) -> None:
    response = dump["response"].astype(np.float32)
    row, col = kernels.locate_peak(response, dft(response))
    assert row == pytest.approx(dump["disp_row"].item(), abs=1e-5)
    assert col == pytest.approx(dump["disp_col"].item(), abs=1e-5)


@pytest.mark.parametrize(("sequence", "frame"), LATER)
def test_threat_is_the_published_one(kernels: Kernels, dump: Dump, config: TrackerConfig) -> None:
    seen: Dump = {}
    response, nu, delta = dump["response"].astype(np.float32), config.threat_nu, config.threat_delta
    assert kernels.threat_in_window(response, nu=nu, delta=delta) == pytest.approx(dump["tau"].item(), abs=5e-6)
    threat_in_window(response, nu=nu, delta=delta, probe=seen.__setitem__)
    np.testing.assert_allclose(seen["threat_window"], dump["sub13"], atol=1e-6)
    # the zeroed hole is a plateau: whether it counts as a maximum changes nothing, as its weight is 0
    hole = np.zeros((13, 13), dtype=bool)
    hole[5:8, 5:8] = True
    np.testing.assert_array_equal(seen["threat_maxima"][~hole], dump["locmax13"][~hole])


def scale_spectrum_of(dump: Dump, stage: str, plan: Plan) -> Any:
    """Spectrum of dumped samples in our order: (K, F), channel, row, column instead of channel, column, row."""
    rows, cols = plan.scale.model_hw[0] // 4, plan.scale.model_hw[1] // 4
    samples = dump[f"scale_sample_{stage}"].T.reshape(33, 31, cols, rows)
    return plan.kernels.scale_dft(np.ascontiguousarray(samples.swapaxes(2, 3), np.float32).reshape(33, -1))


@pytest.mark.parametrize(("sequence", "frame"), FIRST)
def test_scale_filter_learns_the_published_denominator(dump: Dump, plan: Plan) -> None:
    learned = train_scale(scale_spectrum_of(dump, "train", plan), None, plan.scale, plan.kernels)
    np.testing.assert_allclose(learned.den, dump["sf_den"].ravel()[:17], rtol=1e-4)


@pytest.mark.parametrize(("sequence", "frame"), [("Gull2", 2), ("S1301", 2)])
def test_scale_response_is_the_published_one(dump: Dump, before: Dump, plan: Plan) -> None:
    learned: ScaleFilter = train_scale(scale_spectrum_of(before, "train", plan), None, plan.scale, plan.kernels)
    seen: Dump = {}
    x_f, scale_before = scale_spectrum_of(dump, "det", plan), dump["csf_before"].item()
    scale = estimate_scale(x_f, scale_before, learned, plan.scale, plan.kernels, seen.__setitem__)
    assert_close(seen["scale_response"], dump["scale_response"].ravel(), 1e-4)
    assert scale == pytest.approx(dump["currentScaleFactor"].item(), rel=1e-6)
