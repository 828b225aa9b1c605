import cv2
import numpy as np
import pytest

from mscf.arrays import Image
from mscf.kernels import Kernels
from mscf.sampling import crop, sample


def exact(
    kernels: Kernels, frame: Image, pos_rc: tuple[float, float], size_hw: tuple[float, float], out_hw: tuple[int, int]
) -> Image:
    """One rectangle of one size."""
    patch: Image = kernels.sample_exact(frame, pos_rc, np.array([size_hw], np.float64), out_hw)[0]
    return patch


@pytest.fixture
def frame(rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)


def test_a_crop_inside_is_that_part_of_the_frame(frame: Image) -> None:
    np.testing.assert_array_equal(crop(frame, (20, 30), (5, 7)), frame[19:24, 28:35])
    np.testing.assert_array_equal(crop(frame, (20, 30), (4, 4)), frame[19:23, 29:33])


@pytest.mark.parametrize("center_rc", [(0, 0), (39, 59), (-100, 30), (20, 500), (-9, -9)])
def test_outside_the_frame_the_border_is_repeated(frame: Image, center_rc: tuple[int, int]) -> None:
    margin = 600
    padded = np.pad(frame, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    expected = crop(padded, (center_rc[0] + margin, center_rc[1] + margin), (16, 12))
    np.testing.assert_array_equal(crop(frame, center_rc, (16, 12)), expected)


def test_a_crop_larger_than_the_frame_repeats_all_borders(
    frame: Image,
) -> None:
    patch = crop(frame, (20, 30), (100, 100))
    assert patch.shape == (100, 100, 3)
    np.testing.assert_array_equal(patch[0, 0], frame[0, 0])
    np.testing.assert_array_equal(patch[-1, -1], frame[-1, -1])


def test_a_sample_never_shares_memory_that_a_later_frame_would_change(kernels: Kernels, frame: Image) -> None:
    patch = sample(frame, (20, 30), (16, 16), (8, 8))
    exact_patch = exact(kernels, frame, (20.5, 30.5), (16, 16), (16, 16))
    frame[:] = 0
    assert patch.any()
    assert exact_patch.any()


def test_an_exact_sample_on_whole_pixels_is_the_crop(kernels: Kernels, frame: Image) -> None:
    np.testing.assert_array_equal(exact(kernels, frame, (20, 30), (5, 7), (5, 7)), frame[18:23, 27:34])
    np.testing.assert_array_equal(exact(kernels, frame, (20.5, 30.5), (4, 6), (4, 6)), frame[19:23, 28:34])


@pytest.mark.parametrize("side", [8.0, 64.5, 150.0, 333.3, 700.0])
def test_an_exact_sample_is_nearly_the_area_mean(kernels: Kernels, rng: np.random.Generator, side: float) -> None:
    coarse = rng.integers(0, 256, (12, 12, 3), dtype=np.uint8)
    frame = np.asarray(cv2.resize(coarse, (1200, 1200), interpolation=cv2.INTER_CUBIC), np.uint8)
    patch = exact(kernels, frame, (599.5, 599.5), (side, side), (32, 32))
    area = sample(frame, (599, 599), (2 * round(side / 2), 2 * round(side / 2)), (32, 32))
    assert patch.shape == area.shape == (32, 32, 3)
    assert np.abs(area.astype(int) - patch).mean() < 3


def test_gray_frames_are_sampled_as_such(kernels: Kernels, frame: Image) -> None:
    assert exact(kernels, frame[..., 0], (20, 30), (16, 16), (8, 8)).shape == (8, 8)


@pytest.mark.parametrize("pos_rc", [(0.3, 0), (39, 59), (-300.5, 30), (20, 900), (-200, -200.2), (300, 400)])
@pytest.mark.parametrize("size_hw", [(120.0, 160.0), (20.3, 11.8), (1.5, 0.7)])
def test_an_exact_sample_repeats_the_border_too(
    kernels: Kernels, frame: Image, pos_rc: tuple[float, float], size_hw: tuple[float, float]
) -> None:
    margin = 1200
    padded = np.pad(frame, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    inside = exact(kernels, padded, (pos_rc[0] + margin, pos_rc[1] + margin), size_hw, (16, 16))
    np.testing.assert_array_equal(exact(kernels, frame, pos_rc, size_hw, (16, 16)), inside)


@pytest.mark.parametrize("side", [7.3, 11.0, 16.0, 37.7, 44.2])
@pytest.mark.parametrize("center", [(30.0, 30.0), (29.7, 30.25), (30.5, 31.5)])
def test_an_exact_sample_is_centred_where_it_should_be(
    kernels: Kernels, center: tuple[float, float], side: float
) -> None:
    ramp = np.repeat(4 * np.arange(0, 63, dtype=np.uint8)[None, :], 63, axis=0)  # its value is four times the column
    for frame, expected in ((ramp, center[1]), (ramp.T, center[0])):
        patch = exact(kernels, frame, center, (side, side), (16, 16)) / 4
        assert patch.mean() == pytest.approx(expected, abs=0.15)  # half a gray level of rounding
        assert np.ptp(patch) == pytest.approx(side * 15 / 16, abs=0.3)


def test_a_frame_of_any_size_can_be_sampled(kernels: Kernels) -> None:
    wide = np.zeros((8, 40_000), np.uint8)
    wide[:, 39_000:] = 255
    assert exact(kernels, wide, (4, 39_500), (16, 16), (8, 8)).min() == 255
