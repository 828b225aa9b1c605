"""The package's own colour-name table: what it holds, and that the committed file is what its script makes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

DATA = Path(__file__).resolve().parents[2] / "mscf" / "data"
TABLE = DATA / "color_names.npz"
SCRIPT = DATA / "make_color_names.py"
NAMES = ("black", "blue", "brown", "grey", "green", "orange", "pink", "purple", "red", "white", "yellow")

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def table() -> Array:
    """The (32768, 10) table."""
    with np.load(TABLE) as archive:
        return np.asarray(archive["table"], dtype=np.float64)


@pytest.fixture(scope="module")
def basis() -> Array:
    """The (11, 10) basis of the table's coordinates."""
    with np.load(TABLE) as archive:
        return np.asarray(archive["basis"], dtype=np.float64)


def test_the_table_has_ten_finite_coordinates_for_each_cell(table: Array) -> None:
    """One row for each of 32 x 32 x 32 RGB cells."""
    assert table.shape == (32**3, 10)
    assert np.isfinite(table).all()


def test_the_basis_is_orthonormal_and_sums_to_zero(basis: Array) -> None:
    """Correlation filters are invariant to a rotation of the coordinates, not to losing the centring."""
    assert basis.shape == (len(NAMES), 10)
    np.testing.assert_allclose(basis.T @ basis, np.eye(10), atol=1e-12)
    np.testing.assert_allclose(basis.sum(axis=0), 0, atol=1e-12)


def test_each_row_stands_for_eleven_probabilities(table: Array, basis: Array) -> None:
    """p = 1/11 + basis @ row is not negative and sums to 1; |row|^2 = |p|^2 - 1/11."""
    probability = 1 / len(NAMES) + table @ basis.T  # (32768, 11)

    # A coordinate is rounded to 1/2048; a probability collects at most sqrt(10) / 4096 = 7.7e-4 of that.
    assert probability.min() >= -1e-3
    np.testing.assert_allclose(probability.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose((table**2).sum(axis=1), (probability**2).sum(axis=1) - 1 / len(NAMES), atol=1e-12)


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((0, 0, 0), "black"),
        ((128, 128, 128), "grey"),
        ((255, 255, 255), "white"),
        ((255, 0, 0), "red"),
        ((0, 255, 0), "green"),
        ((0, 0, 255), "blue"),
        ((255, 255, 0), "yellow"),
        ((255, 128, 0), "orange"),
        ((128, 0, 128), "purple"),
        ((255, 150, 200), "pink"),
        ((101, 67, 33), "brown"),
    ],
)
def test_a_plain_colour_has_its_plain_name(rgb: tuple[int, int, int], name: str, table: Array, basis: Array) -> None:
    """The most probable name of a colour nobody argues about."""
    red, green, blue = rgb
    row = table[(red >> 3) + 32 * (green >> 3) + 1024 * (blue >> 3)]
    assert NAMES[int(np.argmax(basis @ row))] == name


def test_the_file_stays_small() -> None:
    """It is in the repository and in every wheel."""
    assert TABLE.stat().st_size < 320_000


def test_the_committed_table_is_what_its_script_makes() -> None:
    """The provenance holds: nothing but the script and the survey went into the file."""
    pytest.importorskip("matplotlib", reason="matplotlib brings the XKCD survey the table is made from")
    run = subprocess.run([sys.executable, str(SCRIPT), "--check"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
