import numpy as np
import pytest

from mscf.arrays import Image
from mscf.features.fhog import SIGNED_BINS, UNSIGNED_BINS, histogram
from mscf.kernels import Kernels


def ramp(angle_deg: float, side: int = 64) -> Image:
    """Gray patch that brightens in a direction (0: to the right, 90: downwards)."""
    y, x = np.mgrid[:side, :side]
    angle = np.deg2rad(angle_deg)
    return np.asarray(np.round(128 + 1.3 * (np.cos(angle) * (x - side / 2) + np.sin(angle) * (y - side / 2))), np.uint8)


@pytest.mark.parametrize(("angle_deg", "signed"), [(0, 0), (90, 5), (180, 9), (270, 14)])
def test_a_ramp_votes_for_its_direction(angle_deg: float, signed: int) -> None:
    cells = histogram(ramp(angle_deg)[None])[0]
    assert np.argmax(cells.sum(axis=(1, 2))) in {signed, (signed - 1) % SIGNED_BINS}


def test_opposite_ramps_share_their_unsigned_channels(kernels: Kernels) -> None:
    one, other = kernels.fhog(ramp(0)[None])[0], kernels.fhog(ramp(180)[None])[0]
    unsigned = slice(SIGNED_BINS, SIGNED_BINS + UNSIGNED_BINS)
    np.testing.assert_allclose(one[unsigned], other[unsigned], atol=1e-6)
    assert np.abs(one[:SIGNED_BINS] - other[:SIGNED_BINS]).max() > 0.1


def test_a_uniform_ramp_has_equal_cells_up_to_the_border() -> None:
    cells = histogram(ramp(0)[None])[0][0]
    inner = cells[2:-2, 2:-2]
    np.testing.assert_allclose(inner, inner[0, 0], rtol=0.35)  # rounding of the ramp to whole numbers
    assert cells[0, 8] == pytest.approx(cells[4, 8], rel=0.01)  # 8/7 makes up for the missing outside


def test_a_constant_patch_has_no_orientation(kernels: Kernels) -> None:
    assert not kernels.fhog(np.full((1, 32, 32, 3), 77, np.uint8)).any()


def test_the_strongest_channel_decides(kernels: Kernels) -> None:
    patch = np.zeros((1, 32, 32, 3), np.uint8)
    patch[0, :, :, 1] = np.arange(32, dtype=np.uint8) * 4  # green: to the right
    patch[0, :, :, 0] = np.arange(32, dtype=np.uint8)[:, None]  # blue: downwards, weaker
    np.testing.assert_array_equal(kernels.fhog(patch), kernels.fhog(patch[..., 1]))


def test_a_batch_is_its_patches_one_by_one(kernels: Kernels, rng: np.random.Generator) -> None:
    patches = rng.integers(0, 256, (5, 23, 30, 3), dtype=np.uint8)
    batch = kernels.fhog(patches)
    assert batch.shape == (5, 31, 5, 7)
    for one, patch in zip(batch, patches, strict=True):
        np.testing.assert_allclose(one, kernels.fhog(patch[None])[0], atol=1e-6)


@pytest.mark.parametrize("shape", [(4, 4), (4, 40), (41, 7), (200, 200)])
def test_any_size_from_one_cell_gives_finite_numbers(
    kernels: Kernels, rng: np.random.Generator, shape: tuple[int, int]
) -> None:
    features = kernels.fhog(rng.integers(0, 256, (2, *shape, 3), dtype=np.uint8))
    assert features.shape == (2, 31, shape[0] // 4, shape[1] // 4)
    assert np.isfinite(features).all()
    assert features.dtype == np.float32
    assert features.min() >= 0


def test_saturated_noise_stays_within_the_clip(kernels: Kernels) -> None:
    extremes = np.random.default_rng(1).choice(np.array([0, 255], np.uint8), (1, 64, 64, 3))
    features = kernels.fhog(extremes)
    assert features[:, : SIGNED_BINS + UNSIGNED_BINS].max() <= 0.4 + 1e-6  # half of four blocks of 0.2


def test_the_patch_is_not_changed(kernels: Kernels, rng: np.random.Generator) -> None:
    patch = rng.integers(0, 256, (1, 32, 32, 3), dtype=np.uint8)
    before = patch.copy()
    kernels.fhog(patch)
    np.testing.assert_array_equal(patch, before)
