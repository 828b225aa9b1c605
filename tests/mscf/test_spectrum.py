import numpy as np
import pytest

from mscf.arrays import Real
from mscf.spectrum import SupportTransform, circular_offsets, dft, inverse_dft, locate_peak, shifted


def test_transforms_keep_single_precision(rng: np.random.Generator) -> None:
    x = rng.standard_normal((3, 50, 50), dtype=np.float32)
    assert dft(x).dtype == np.complex64
    assert inverse_dft(dft(x), (50, 50)).dtype == np.float32


def test_offsets_are_those_of_the_dft() -> None:
    np.testing.assert_array_equal(circular_offsets(6), [0, 1, 2, 3, -2, -1])
    np.testing.assert_array_equal(circular_offsets(5), [0, 1, 2, -2, -1])


@pytest.mark.parametrize("size_mn", [(50, 50), (16, 20), (17, 15)])
@pytest.mark.parametrize("support_mn", [(9, 10), (1, 1), (15, 14)])
def test_support_transform_equals_the_full_transform_of_the_padded_map(
    rng: np.random.Generator, size_mn: tuple[int, int], support_mn: tuple[int, int]
) -> None:
    transform = SupportTransform.centred(size_mn, support_mn)
    x = rng.standard_normal((4, *support_mn), dtype=np.float32)
    (rows, cols), (m, n) = size_mn, support_mn
    top, left = rows // 2 - m // 2, cols // 2 - n // 2
    padded = np.zeros((4, *size_mn), np.float32)
    padded[:, top : top + m, left : left + n] = x
    np.testing.assert_allclose(transform.forward(x), dft(padded), atol=2e-5)
    # the inverse crops what any spectrum holds, not only spectra of padded maps
    full = rng.standard_normal((4, *size_mn), dtype=np.float32)
    cropped = full[:, top : top + m, left : left + n]
    np.testing.assert_allclose(transform.inverse(dft(full)), cropped, atol=2e-6)


def bump(row: float, col: float, size: int = 50) -> Real:
    """Gaussian of 2 cells around an offset, circular."""
    offset = circular_offsets(size)

    def around(center: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        d = (offset - center + size / 2) % size - size / 2
        return np.exp(-(d**2) / 8)

    return np.outer(around(row), around(col)).astype(np.float32)


@pytest.mark.parametrize(("row", "col"), [(0, 0), (0.3, -0.4), (3.25, -7.5), (-24.4, 20.1), (0.5, 0.5), (24.9, -24.9)])
def test_a_peak_between_the_cells_is_recovered(row: float, col: float) -> None:
    found = np.array(locate_peak(bump(row, col)))
    error = (found - (row, col) + 25) % 50 - 25  # the map is circular
    np.testing.assert_allclose(error, 0, atol=1e-3)


def test_a_flat_response_leaves_the_target_where_it_is() -> None:
    assert locate_peak(np.zeros((50, 50), np.float32)) == (0, 0)
    assert locate_peak(np.ones((50, 50), np.float32)) == (0, 0)


def test_noise_gives_a_finite_peak_no_lower_than_the_grid(rng: np.random.Generator) -> None:
    for _ in range(20):
        response = rng.standard_normal((50, 50), dtype=np.float32)
        row, col = locate_peak(response)
        assert np.isfinite([row, col]).all()
        # interpolated by hand at the found offset
        spectrum = np.fft.fft2(response.astype(np.float64)) / response.size
        k = circular_offsets(50)
        wave_r, wave_c = np.exp(2j * np.pi / 50 * k * row), np.exp(2j * np.pi / 50 * k * col)
        assert (wave_r @ spectrum @ wave_c).real >= response.max() - 1e-5


def test_of_equal_maxima_the_first_by_column_wins() -> None:
    response = np.zeros((50, 50), np.float32)
    response[0, 3] = response[2, 1] = 1
    row, col = locate_peak(response)
    assert (round(row), round(col)) == (2, 1)


def test_a_spectrum_shifted_by_whole_cells_is_that_of_the_rolled_map(rng: np.random.Generator) -> None:
    x = rng.standard_normal((3, 50, 50), dtype=np.float32)
    moved = inverse_dft(shifted(dft(x), (3, -7), (50, 50)), (50, 50))
    np.testing.assert_allclose(moved, np.roll(x, (-3, 7), axis=(1, 2)), atol=1e-5)


def test_a_spectrum_shifted_by_its_peaks_offset_has_its_peak_at_the_origin() -> None:
    response = bump(1.3, -0.6)
    centred = inverse_dft(shifted(dft(response), locate_peak(response), (50, 50)), (50, 50))
    assert locate_peak(centred) == pytest.approx((0, 0), abs=1e-3)
