import numpy as np
import pytest

from mscf.arrays import Real, Real64
from mscf.kernels import Kernels
from mscf.spectrum import SupportTransform, circular_offsets, dft, inverse_dft, shifted


def found_peak(kernels: Kernels, response: Real) -> tuple[float, float]:
    """Peak of a response, as the tracker asks for it."""
    return kernels.locate_peak(response, dft(response))


def test_transforms_keep_single_precision(kernels: Kernels, rng: np.random.Generator) -> None:
    x = rng.standard_normal((3, 50, 50), dtype=np.float32)
    x_f = kernels.windowed_dft(x, np.ones((50, 50), np.float32))
    assert dft(x).dtype == x_f.dtype == np.complex64
    assert inverse_dft(x_f, (50, 50)).dtype == kernels.inverse_dft(x_f[0], (50, 50)).dtype == np.float32


@pytest.mark.parametrize("size_mn", [(50, 50), (16, 20), (34, 16), (128, 64)])
def test_the_transform_of_windowed_maps_is_the_dft_of_the_product(
    kernels: Kernels, rng: np.random.Generator, size_mn: tuple[int, int]
) -> None:
    maps = rng.standard_normal((3, *size_mn), dtype=np.float32)
    window = rng.uniform(0, 1, size_mn).astype(np.float32)
    expected_f = np.fft.rfft2(maps.astype(np.float64) * window)
    maps_f = kernels.windowed_dft(maps, window)
    np.testing.assert_allclose(maps_f, expected_f, rtol=0, atol=2e-6 * np.abs(expected_f).max())
    for one, one_f in zip(maps, maps_f, strict=True):
        back = kernels.inverse_dft(one_f, size_mn)
        np.testing.assert_allclose(back, one * window, rtol=0, atol=2e-6 * np.abs(one).max())


def test_correlation_sums_over_the_channels_with_the_first_conjugated(
    kernels: Kernels, rng: np.random.Generator
) -> None:
    a_f, b_f = (dft(rng.standard_normal((3, 16, 20), dtype=np.float32)) for _ in range(2))
    expected_f = np.einsum("dmn,dmn->mn", a_f.conj().astype(np.complex128), b_f)
    np.testing.assert_allclose(kernels.correlate(a_f, b_f), expected_f, rtol=0, atol=1e-6 * np.abs(expected_f).max())


@pytest.mark.parametrize("offset_rc", [(0, 0), (3, -7), (-1, 2)])
@pytest.mark.parametrize("rate", [0.0, 0.02, 1.0])
def test_a_blend_is_the_mean_with_the_sample_rolled_back_and_its_energy(
    kernels: Kernels, rng: np.random.Generator, rate: float, offset_rc: tuple[int, int]
) -> None:
    mean, sample = (rng.standard_normal((3, 16, 20), dtype=np.float32) for _ in range(2))
    after_f, energy = kernels.blend(dft(mean), dft(sample), rate, offset_rc, (16, 20))
    rolled = np.roll(sample, (-offset_rc[0], -offset_rc[1]), axis=(1, 2))
    expected_f = dft((1 - rate) * mean + rate * rolled)
    np.testing.assert_allclose(after_f, expected_f, rtol=0, atol=2e-6 * np.abs(expected_f).max())
    np.testing.assert_allclose(energy, np.sum(np.abs(expected_f) ** 2, axis=0), rtol=1e-4, atol=1e-3)


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

    def around(center: float) -> Real64:
        d = (offset - center + size / 2) % size - size / 2
        return np.asarray(np.exp(-(d**2) / 8))

    return np.outer(around(row), around(col)).astype(np.float32)


@pytest.mark.parametrize(("row", "col"), [(0, 0), (0.3, -0.4), (3.25, -7.5), (-24.4, 20.1), (0.5, 0.5), (24.9, -24.9)])
def test_a_peak_between_the_cells_is_recovered(kernels: Kernels, row: float, col: float) -> None:
    found = np.array(found_peak(kernels, bump(row, col)))
    error = (found - (row, col) + 25) % 50 - 25  # the map is circular
    np.testing.assert_allclose(error, 0, atol=1e-3)


def test_a_flat_response_leaves_the_target_where_it_is(kernels: Kernels) -> None:
    assert found_peak(kernels, np.zeros((50, 50), np.float32)) == (0, 0)
    assert found_peak(kernels, np.ones((50, 50), np.float32)) == (0, 0)


def test_noise_gives_a_finite_peak_no_lower_than_the_grid(kernels: Kernels, rng: np.random.Generator) -> None:
    for _ in range(20):
        response = rng.standard_normal((50, 50), dtype=np.float32)
        row, col = found_peak(kernels, response)
        assert np.isfinite([row, col]).all()
        # interpolated by hand at the found offset
        spectrum = np.fft.fft2(response.astype(np.float64)) / response.size
        k = circular_offsets(50)
        wave_r, wave_c = np.exp(2j * np.pi / 50 * k * row), np.exp(2j * np.pi / 50 * k * col)
        assert (wave_r @ spectrum @ wave_c).real >= response.max() - 1e-5


def test_of_equal_maxima_the_first_by_column_wins(kernels: Kernels) -> None:
    response = np.zeros((50, 50), np.float32)
    response[0, 3] = response[2, 1] = 1
    row, col = found_peak(kernels, response)
    assert (round(row), round(col)) == (2, 1)


def test_a_spectrum_shifted_by_whole_cells_is_that_of_the_rolled_map(rng: np.random.Generator) -> None:
    x = rng.standard_normal((3, 50, 50), dtype=np.float32)
    moved = inverse_dft(shifted(dft(x), (3, -7), (50, 50)), (50, 50))
    np.testing.assert_allclose(moved, np.roll(x, (-3, 7), axis=(1, 2)), atol=1e-5)


def test_a_spectrum_shifted_by_its_peaks_offset_has_its_peak_at_the_origin(kernels: Kernels) -> None:
    response = bump(1.3, -0.6)
    centred = inverse_dft(shifted(dft(response), found_peak(kernels, response), (50, 50)), (50, 50))
    assert found_peak(kernels, centred) == pytest.approx((0, 0), abs=1e-3)
