"""Gray, colour names, and the stack of all channels."""

from pathlib import Path

import numpy as np
import pytest

from mscf.errors import ConfigError
from mscf.features.color_names import load_table
from mscf.kernels import Kernels

GRAY, NAMES = 0, slice(32, 42)


def test_gray_is_the_mean_luminance_of_a_cell(kernels: Kernels) -> None:
    patch = np.zeros((8, 8, 3), np.uint8)
    patch[:4, :4] = (10, 20, 30)
    patch[4:, 4:] = 255
    cells = kernels.feature_stack(patch, None)[GRAY]
    assert cells[0, 0] == pytest.approx((0.114021 * 10 + 0.587043 * 20 + 0.298936 * 30) / 255 - 0.5, abs=1e-6)
    assert cells[0, 1] == pytest.approx(-0.5)
    assert cells[1, 1] == pytest.approx(0.5, abs=1e-6)


def test_a_gray_patch_and_its_colour_copy_have_the_same_gray(kernels: Kernels, rng: np.random.Generator) -> None:
    patch = rng.integers(0, 256, (40, 40), dtype=np.uint8)
    one, other = (kernels.feature_stack(each, None) for each in (patch, np.stack([patch] * 3, axis=2)))
    np.testing.assert_allclose(one[GRAY], other[GRAY], atol=1e-6)


def test_colour_names_are_the_mean_of_the_rows_of_a_cell(kernels: Kernels, rng: np.random.Generator) -> None:
    table = rng.standard_normal((32768, 10), dtype=np.float32)
    patch = rng.integers(0, 256, (12, 8, 3), dtype=np.uint8)
    cells = kernels.feature_stack(patch, table)[NAMES]
    assert cells.shape == (10, 3, 2)
    for row in range(3):
        for col in range(2):
            pixels = patch[4 * row : 4 * row + 4, 4 * col : 4 * col + 4].reshape(-1, 3).astype(int) >> 3
            index = pixels[:, 2] + 32 * pixels[:, 1] + 1024 * pixels[:, 0]  # BGR
            np.testing.assert_allclose(cells[:, row, col], table[index].mean(axis=0), atol=1e-6)


def test_without_a_table_the_colour_names_are_dropped(kernels: Kernels, rng: np.random.Generator) -> None:
    patch = rng.integers(0, 256, (200, 200, 3), dtype=np.uint8)
    assert kernels.feature_stack(patch, load_table(None)).shape == (42, 50, 50)
    assert kernels.feature_stack(patch[..., 0], None).shape == (32, 50, 50)


def test_a_table_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.npz cannot be read"):
        load_table(tmp_path / "nothing.npz")


def test_a_table_of_another_shape_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "small.npz", table=np.zeros((3, 10)))
    with pytest.raises(ConfigError, match=r"\(3, 10\)"):
        load_table(tmp_path / "small.npz")


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("hello")
    np.savez(tmp_path / "other.npz", names=np.zeros((32768, 10)))
    for name in ("text.npz", "other.npz"):
        with pytest.raises(ConfigError, match="cannot be read"):
            load_table(tmp_path / name)


def test_a_table_that_was_loaded_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        load_table(None)[0, 0] = 1
