import cv2
import numpy as np
import pytest

from mscf.arrays import Image, Spectrum
from mscf.config import TrackerConfig
from mscf.geometry import Box
from mscf.kernels import Kernels
from mscf.plan import Plan
from mscf.scale import estimate_scale, scale_features, train_scale

BOX = Box(130, 90, 60, 44)
POS_RC = BOX.to_pos_size()[0]


@pytest.fixture
def frame(rng: np.random.Generator) -> Image:
    coarse = rng.integers(0, 256, (32, 40, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC), np.uint8)


@pytest.fixture
def plan(kernels: Kernels, frame: Image) -> Plan:
    return Plan.make(TrackerConfig.preset("reference"), frame.shape, BOX, is_gray=False, kernels=kernels)


def zoomed(frame: Image, factor: float) -> Image:
    """The frame enlarged about the target's centre."""
    row, col = POS_RC
    matrix = np.array([[factor, 0, col * (1 - factor)], [0, factor, row * (1 - factor)]])
    return np.asarray(cv2.warpAffine(frame, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE), np.uint8)


def spectrum(frame: Image, scale: float, plan: Plan) -> Spectrum:
    """Of the scale features around the target."""
    return plan.kernels.scale_dft(scale_features(frame, POS_RC, scale, plan.scale, plan.kernels))


@pytest.mark.parametrize("steps", [-5, -2, 0, 1, 4])
def test_a_target_that_grew_by_whole_steps_is_recovered(frame: Image, plan: Plan, steps: int) -> None:
    scale = plan.first_scale
    learned = train_scale(spectrum(frame, scale, plan), None, plan.scale, plan.kernels)
    x_f = spectrum(zoomed(frame, 1.03**steps), scale, plan)
    found = estimate_scale(x_f, scale, learned, plan.scale, plan.kernels)
    assert found / scale == pytest.approx(1.03**steps, rel=0.0301)  # to a step: sizes are cut to whole pixels


def test_scales_go_from_large_to_small_around_one(plan: Plan) -> None:
    assert plan.scale.factors[16] == 1
    assert plan.scale.factors[0] == pytest.approx(1.03**16)
    assert (np.diff(plan.scale.factors) < 0).all()


def test_the_scale_stays_within_its_limits(frame: Image, plan: Plan) -> None:
    low, high = plan.scale.limits
    scale = plan.first_scale
    learned = train_scale(spectrum(frame, scale, plan), None, plan.scale, plan.kernels)
    x_f = spectrum(frame, scale, plan)
    assert estimate_scale(x_f, 1e6, learned, plan.scale, plan.kernels) == high
    assert estimate_scale(x_f, 1e-6, learned, plan.scale, plan.kernels) == low


def test_the_largest_scale_fits_the_frame(plan: Plan) -> None:
    _, high = plan.scale.limits
    height, width = plan.scale.base_hw[0] * high, plan.scale.base_hw[1] * high
    assert height <= 240
    assert width <= 320
    assert max(height / 240, width / 320) * 1.03 > 1


def test_learning_is_a_running_mean(frame: Image, plan: Plan) -> None:
    x_f = spectrum(frame, plan.first_scale, plan)
    first = train_scale(x_f, None, plan.scale, plan.kernels)
    again = train_scale(x_f, first, plan.scale, plan.kernels)
    np.testing.assert_allclose(again.den, first.den, rtol=1e-5)
    darker = train_scale(np.zeros_like(x_f), first, plan.scale, plan.kernels)
    np.testing.assert_allclose(darker.den, (1 - 0.024) * first.den, rtol=1e-5)


@pytest.mark.parametrize("size", [(4, 400), (300, 4), (6, 6), (4, 4)])
def test_thin_and_tiny_targets_have_at_least_one_cell(kernels: Kernels, frame: Image, size: tuple[int, int]) -> None:
    box = Box(10, 10, *size)
    plan = Plan.make(TrackerConfig(), frame.shape, box, is_gray=False, kernels=kernels)
    features = scale_features(frame, box.to_pos_size()[0], plan.first_scale, plan.scale, kernels)
    assert features.shape[1] >= 31
    assert np.isfinite(features).all()


@pytest.mark.parametrize("part", [-0.45, -0.3, 0.2, 0.4])
def test_a_growth_by_part_of_a_step_is_seen_by_interpolation(kernels: Kernels, frame: Image, part: float) -> None:
    grown = zoomed(frame, 1.03**part)
    for name, expected in (("mscf", 1.03**part), ("reference", 1.0)):
        plan = Plan.make(TrackerConfig.preset(name), frame.shape, BOX, is_gray=False, kernels=kernels)
        scale = plan.first_scale
        learned = train_scale(spectrum(frame, scale, plan), None, plan.scale, plan.kernels)
        found = estimate_scale(spectrum(grown, scale, plan), scale, learned, plan.scale, kernels)
        assert found / scale == pytest.approx(expected, abs=0.005)


@pytest.mark.parametrize("steps", [-3.0, -0.5, 1.4])
def test_a_sample_cut_for_another_size_trains_nearly_what_one_cut_anew_does(
    frame: Image, plan: Plan, steps: float
) -> None:
    growth = 1.03**steps
    anew = train_scale(spectrum(frame, growth * plan.first_scale, plan), None, plan.scale, plan.kernels)
    moved = train_scale(spectrum(frame, plan.first_scale, plan), None, plan.scale, plan.kernels, growth)
    for learned in (anew, moved):  # the target is as large as it was said to be
        x_f = spectrum(frame, growth * plan.first_scale, plan)
        found = estimate_scale(x_f, growth * plan.first_scale, learned, plan.scale, plan.kernels)
        assert found / plan.first_scale == pytest.approx(growth, rel=0.0301)
