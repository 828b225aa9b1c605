import cv2
import numpy as np
import pytest

from mscf.sampling import crop, sample


@pytest.fixture
def frame(rng: np.random.Generator) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)


def test_a_crop_inside_is_that_part_of_the_frame(frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    np.testing.assert_array_equal(crop(frame, (20, 30), (5, 7)), frame[19:24, 28:35])
    np.testing.assert_array_equal(crop(frame, (20, 30), (4, 4)), frame[19:23, 29:33])


@pytest.mark.parametrize("center_rc", [(0, 0), (39, 59), (-100, 30), (20, 500), (-9, -9)])
def test_outside_the_frame_the_border_is_repeated(
    frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], center_rc: tuple[int, int]
) -> None:
    margin = 600
    padded = np.pad(frame, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    expected = crop(padded, (center_rc[0] + margin, center_rc[1] + margin), (16, 12))
    np.testing.assert_array_equal(crop(frame, center_rc, (16, 12)), expected)


def test_a_crop_larger_than_the_frame_repeats_all_borders(
    frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
) -> None:
    patch = crop(frame, (20, 30), (100, 100))
    assert patch.shape == (100, 100, 3)
    np.testing.assert_array_equal(patch[0, 0], frame[0, 0])
    np.testing.assert_array_equal(patch[-1, -1], frame[-1, -1])


def test_a_sample_never_shares_memory_that_a_later_frame_would_change(
    frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
) -> None:
    patch = sample(frame, (20, 30), (16, 16), (8, 8), rule="area")
    frame[:] = 0
    assert patch.any()


@pytest.mark.parametrize("side", [8, 64, 150, 333, 700])
def test_bounded_resampling_gives_nearly_the_area_mean(rng: np.random.Generator, side: int) -> None:
    coarse = rng.integers(0, 256, (12, 12, 3), dtype=np.uint8)
    frame = np.asarray(cv2.resize(coarse, (1200, 1200), interpolation=cv2.INTER_CUBIC), np.uint8)
    exact = sample(frame, (600, 600), (side, side), (32, 32), rule="area")
    bounded = sample(frame, (600, 600), (side, side), (32, 32), rule="bounded")
    assert bounded.shape == exact.shape == (32, 32, 3)
    assert np.abs(exact.astype(int) - bounded).mean() < 5


def test_gray_frames_are_sampled_as_such(frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    assert sample(frame[..., 0], (20, 30), (16, 16), (8, 8), rule="bounded").shape == (8, 8)


@pytest.mark.parametrize("center_rc", [(0, 0), (39, 59), (-300, 30), (20, 900), (-200, -200), (300, 400)])
def test_bounded_resampling_repeats_the_border_too(
    frame: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], center_rc: tuple[int, int]
) -> None:
    margin = 1200
    padded = np.pad(frame, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    inside = sample(padded, (center_rc[0] + margin, center_rc[1] + margin), (120, 160), (16, 16), rule="bounded")
    outside = sample(frame, center_rc, (120, 160), (16, 16), rule="bounded")
    np.testing.assert_array_equal(outside, inside)


def test_bounded_resampling_has_no_shift() -> None:
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :], 256, axis=0)
    for side in (60, 97, 200):
        exact = sample(ramp, (128, 128), (side, side), (16, 16), rule="area").astype(int)
        bounded = sample(ramp, (128, 128), (side, side), (16, 16), rule="bounded").astype(int)
        assert abs((exact - bounded).mean()) < 1
