"""The compiled kernels against those of NumPy, over sizes and contents.

The sums have other orders, and the compiled ones fused multiplications. Each tolerance is about four times the largest
difference that was found over the cases below; of spectra, filters and scales it is relative to the largest value.
"""

import itertools
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mscf.arrays import Image, Real, Spectrum
from mscf.features.color_names import load_table
from mscf.kernels import Kernels
from mscf.kernels.numpy_kernels import NumpyKernels
from mscf.spectrum import SupportTransform, dft

FEATURES = 1e-6
SPECTRA = 3e-6
FILTER = 6e-6
SCALE = 4e-6
RESPONSE = 2e-7  # ratios and threats, relative
PEAK_CELLS = 1e-9

GRIDS = [(16, 16), (16, 22), (34, 18), (50, 50), (128, 64), (128, 128)]
TWIN = NumpyKernels()


def assert_twins(ours: Any, theirs: Any, share: float) -> None:
    """Equal in dtype and shape, and in values to a share of the largest."""
    assert ours.dtype == theirs.dtype
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=share * np.abs(theirs).max())


def noise(rng: np.random.Generator, *shape: int) -> Real:
    return rng.standard_normal(shape, dtype=np.float32)


def noise_f(rng: np.random.Generator, *shape: int) -> Spectrum:
    return np.asarray(noise(rng, *shape) + 1j * noise(rng, *shape), np.complex64)


def textured(rng: np.random.Generator, *shape: int) -> Image:
    coarse = rng.integers(0, 256, (max(shape[0] // 6, 2), max(shape[1] // 6, 2), *shape[2:]), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC), np.uint8)


def pictures(rng: np.random.Generator, *shape: int) -> list[Image]:
    """Of one shape: textured, noise, saturated noise, one colour, black, white, a step."""
    step = np.zeros(shape, np.uint8)
    step[:, shape[1] // 2 :] = 255
    return [
        textured(rng, *shape),
        rng.integers(0, 256, shape, dtype=np.uint8),
        rng.choice(np.array([0, 255], np.uint8), shape),
        *(np.full(shape, level, np.uint8) for level in (77, 0, 255)),
        step,
    ]


# --- features ---


@pytest.mark.parametrize("side_px", [(64, 64), (64, 88), (132, 72), (200, 200), (4, 4), (4, 8), (512, 256)])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_feature_stacks_are_twins(
    native: Kernels, rng: np.random.Generator, side_px: tuple[int, int], channels: tuple[int, ...]
) -> None:
    for patch in pictures(rng, *side_px, *channels):
        for table in (None, load_table(None)) if channels else (None,):
            np.testing.assert_allclose(
                native.feature_stack(patch, table), TWIN.feature_stack(patch, table), rtol=0, atol=FEATURES
            )


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    shape=st.tuples(st.integers(1, 4), st.integers(4, 90), st.integers(4, 90)),
    channels=st.sampled_from([(), (3,)]),
    kind=st.integers(0, 6),
    seed=st.integers(0, 99),
)
def test_fhog_of_a_batch_is_a_twin(
    native: Kernels, shape: tuple[int, int, int], channels: tuple[int, ...], kind: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    patches = np.stack([pictures(rng, *shape[1:], *channels)[kind] for _ in range(shape[0])])
    np.testing.assert_allclose(native.fhog(patches), TWIN.fhog(patches), rtol=0, atol=FEATURES)


# --- sampling ---


@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize("is_whole", [False, True])
def test_samples_lie_at_most_a_32nd_of_a_pixel_apart_and_seldom(
    native: Kernels, rng: np.random.Generator, channels: tuple[int, ...], *, is_whole: bool
) -> None:
    values, differing = 0, 0
    for _ in range(80):
        frame = rng.integers(0, 256, (*rng.integers(1, 300, 2), *channels), dtype=np.uint8)
        pos, sizes_hw = rng.uniform(-200, 500, 2), rng.uniform(0.5, 600, (3, 2))
        if is_whole:  # half-way between the steps of a pixel
            pos, sizes_hw = np.round(2 * pos) / 2, np.ceil(sizes_hw)
        out_hw, pos_rc = (int(rng.integers(1, 60)), int(rng.integers(1, 60))), (float(pos[0]), float(pos[1]))
        ours, theirs = (each.sample_exact(frame, pos_rc, sizes_hw, out_hw) for each in (native, TWIN))
        assert ours.shape == theirs.shape
        difference = np.abs(ours.astype(int) - theirs)
        assert difference.max() <= 255 / 32
        values, differing = values + difference.size, differing + int(np.count_nonzero(difference))
    assert differing < 0.001 * values  # none with OpenCV 4.14


def test_a_frame_whose_rows_lie_apart_is_sampled_as_its_copy(native: Kernels, rng: np.random.Generator) -> None:
    whole = rng.integers(0, 256, (90, 120, 3), dtype=np.uint8)
    for frame in (whole[10:70, 20:100], whole[::2], whole[:, ::2], whole[::-1], whole[..., 1], whole[..., ::-1]):
        sizes_hw = np.array([[31.5, 40.25]])
        ours = native.sample_exact(frame, (20.3, 30.1), sizes_hw, (16, 20))
        np.testing.assert_array_equal(ours, native.sample_exact(frame.copy(), (20.3, 30.1), sizes_hw, (16, 20)))


# --- spectra ---


@pytest.mark.parametrize("channels", [1, 3, 42])
@pytest.mark.parametrize("size_mn", GRIDS)
def test_transforms_are_twins(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int], channels: int
) -> None:
    window = np.outer(np.hanning(size_mn[0]), np.hanning(size_mn[1])).astype(np.float32)
    for maps in (noise(rng, channels, *size_mn), np.ones((channels, *size_mn), np.float32)):
        for each in (window, np.ones_like(window)):
            maps_f = TWIN.windowed_dft(maps, each)
            assert_twins(native.windowed_dft(maps, each), maps_f, SPECTRA)
            assert_twins(native.inverse_dft(maps_f[0], size_mn), TWIN.inverse_dft(maps_f[0], size_mn), SPECTRA)


@pytest.mark.parametrize("size_mn", GRIDS)
def test_of_any_half_spectrum_the_inverse_is_a_twin(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int]
) -> None:
    x_f = noise_f(rng, size_mn[0], size_mn[1] // 2 + 1)  # of no real map: the first and last column are not symmetric
    assert_twins(native.inverse_dft(x_f, size_mn), TWIN.inverse_dft(x_f, size_mn), SPECTRA)


@pytest.mark.parametrize("channels", [1, 3, 42])
@pytest.mark.parametrize("size_mn", GRIDS)
def test_correlations_and_blends_are_twins(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int], channels: int
) -> None:
    a_f, b_f = (noise_f(rng, channels, size_mn[0], size_mn[1] // 2 + 1) for _ in range(2))
    assert_twins(native.correlate(a_f, b_f), TWIN.correlate(a_f, b_f), SPECTRA)
    for rate, offset_rc in ((0.0, (0.0, 0.0)), (0.02, (0.0, 0.0)), (0.013, (1.25, -7.5)), (1.0, (-0.3, 0.0))):
        for ours, theirs in zip(
            native.blend(a_f, b_f, rate, offset_rc, size_mn),
            TWIN.blend(a_f, b_f, rate, offset_rc, size_mn),
            strict=True,
        ):
            assert_twins(ours, theirs, SPECTRA)


# --- the filter ---

SUPPORTS = [
    *(((16, 16), support) for support in itertools.product((1, 2, 5, 15, 16), (1, 4, 7, 16))),
    ((50, 50), (9, 10)),
    ((50, 50), (50, 1)),
    ((50, 50), (1, 50)),
    ((50, 50), (17, 33)),
    ((34, 18), (34, 18)),
    ((128, 64), (31, 64)),
    ((128, 128), (20, 21)),
]


@pytest.mark.parametrize("channels", [1, 3, 42])
@pytest.mark.parametrize(("size_mn", "support_mn"), SUPPORTS)
def test_the_filters_steps_on_a_support_are_twins(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int], support_mn: tuple[int, int], channels: int
) -> None:
    support = SupportTransform.centred(size_mn, support_mn)
    model_f, h = dft(noise(rng, channels, *size_mn)), noise(rng, channels, *support_mn)
    a_f: Spectrum = 0.01 * noise_f(rng, *model_f.shape[1:])
    for ours, theirs in zip(
        native.restrict_h(model_f, a_f, h, 0.8, support), TWIN.restrict_h(model_f, a_f, h, 0.8, support), strict=True
    ):
        assert_twins(ours, theirs, FILTER)
    before, before_f = noise(rng, channels, *support_mn), 0.01 * noise_f(rng, *model_f.shape[1:])
    g_f = [each.filter_of(model_f, (h, before), (a_f, before_f), 0.1, support) for each in (native, TWIN)]
    assert_twins(g_f[0], g_f[1], FILTER)


@pytest.mark.parametrize("size_mn", GRIDS)
def test_what_is_solved_bin_by_bin_is_a_twin(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int]
) -> None:
    bins_mn = size_mn[0], size_mn[1] // 2 + 1
    one_f, two_f, three_f, four_f = (noise_f(rng, *bins_mn) for _ in range(4))
    energy = np.abs(noise(rng, *bins_mn))
    solved = [each.solve_g(one_f, energy, two_f, (three_f, four_f), 0.1, 25.0) for each in (native, TWIN)]
    label = [
        each.split_label((one_f, two_f), three_f, four_f, one_f, (27.0, 2500.0), (0.1, 0.2)) for each in (native, TWIN)
    ]
    for ours, theirs in (*zip(*solved, strict=True), *zip(*label, strict=True)):
        assert_twins(ours, theirs, FILTER)


# --- the response ---


def responses(rng: np.random.Generator) -> dict[str, Real]:
    """Response maps of 50 x 34 by what is special about them."""
    d_r, d_c = (np.minimum(np.arange(n), n - np.arange(n)) for n in (50, 34))
    bump = np.exp(-(d_r[:, None] ** 2 + d_c[None, :] ** 2) / 8).astype(np.float32)
    maps = {
        "noise": noise(rng, 50, 34),
        "a bump": bump,
        "a bump at the rim": np.roll(bump, (25, -17), axis=(0, 1)),
        "a bump in noise": np.roll(bump, (7, 12), axis=(0, 1)) + 0.1 * noise(rng, 50, 34),
        "small": np.float32(1e-30) * bump,
        "large": np.float32(1e18) * bump,
        "all below 0": -1 - bump,
        "all 0": np.zeros_like(bump),
        "all 1": np.ones_like(bump),
        "two equal peaks": np.zeros_like(bump),
        "one cell": np.zeros_like(bump),
    }
    maps["two equal peaks"][[3, 40], [30, 2]] = 1
    maps["one cell"][24, 17] = 0.3
    for name, value in (("NaN", np.nan), ("infinity", np.inf)):
        for row, col in ((0, 0), (3, 31), (49, 33)):
            broken = 0.1 * noise(rng, 50, 34)
            broken[row, col] = value
            maps[f"{name} at {row}, {col}"] = broken
        maps[f"all {name}"] = np.full_like(bump, value)
        maps[f"two of {name}"] = bump.copy()
        maps[f"two of {name}"][[5, 20], [30, 1]] = value
    return maps


RESPONSES = responses(np.random.default_rng(8))


@pytest.mark.parametrize("name", RESPONSES)
def test_what_is_read_off_a_response_is_a_twin(native: Kernels, name: str) -> None:
    response = RESPONSES[name]
    with np.errstate(all="ignore"):  # what infinity leads to is wanted here
        response_f = np.asarray(np.fft.rfft2(response), np.complex64)
        theirs = TWIN.locate_peak(response, response_f)
        ratio = TWIN.peak_to_sidelobe(response)
        threat = TWIN.threat_in_window(response, nu=1.0, delta=0.01)
    assert native.locate_peak(response, response_f) == pytest.approx(theirs, abs=PEAK_CELLS)
    assert native.peak_to_sidelobe(response) == pytest.approx(ratio, rel=RESPONSE, nan_ok=True)
    assert native.threat_in_window(response, nu=1.0, delta=0.01) == pytest.approx(threat, rel=RESPONSE, nan_ok=True)


@pytest.mark.parametrize("size_mn", GRIDS)
def test_what_is_read_off_a_response_of_any_size_is_a_twin(
    native: Kernels, rng: np.random.Generator, size_mn: tuple[int, int]
) -> None:
    for _ in range(10):
        response = noise(rng, *size_mn)
        response_f = dft(response)
        theirs = TWIN.locate_peak(response, response_f)
        assert native.locate_peak(response, response_f) == pytest.approx(theirs, abs=PEAK_CELLS)
        assert native.peak_to_sidelobe(response) == pytest.approx(TWIN.peak_to_sidelobe(response), rel=RESPONSE)
        ours, threat = (each.threat_in_window(response, nu=1.0, delta=0.01) for each in (native, TWIN))
        assert ours == pytest.approx(threat, rel=RESPONSE)


# --- scale ---


@pytest.mark.parametrize("scales", [3, 5, 17, 33, 99])
@pytest.mark.parametrize("size", [31, 32, 62, 31 * 30])
def test_the_scale_filters_steps_are_twins(native: Kernels, rng: np.random.Generator, scales: int, size: int) -> None:
    bins = scales // 2 + 1
    num_f, label_f, den = noise_f(rng, bins, size), noise_f(rng, bins), np.abs(noise(rng, bins))
    for features in (
        noise(rng, scales, size),
        np.ones((scales, size), np.float32),
        np.zeros((scales, size), np.float32),
    ):
        x_f = TWIN.scale_dft(features)
        assert_twins(native.scale_dft(features), x_f, SCALE)
        assert_twins(native.scale_match(num_f, x_f), TWIN.scale_match(num_f, x_f), SCALE)
        for rate in (0.0, 0.024, 1.0):
            learned = (each.scale_learn(num_f, den, x_f, label_f, rate) for each in (native, TWIN))
            for ours, theirs in zip(*learned, strict=True):
                assert_twins(ours, theirs, SCALE)
