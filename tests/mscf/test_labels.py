import numpy as np
import pytest

from mscf.labels import gaussian_label, ideal_label, pedestal


def test_the_gaussian_is_one_at_the_origin_and_circular() -> None:
    label = gaussian_label((50, 50), sigma_cells=2.0)
    assert label[0, 0] == 1
    assert label[3, 4] == pytest.approx(np.exp(-25 / 8))
    assert label[-3, -4] == label[3, 4]


def offsets_of(mask: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> tuple[set[int], set[int]]:
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return {int((r + 25) % 50 - 25) for r in rows}, {int((c + 25) % 50 - 25) for c in cols}


def test_the_published_pedestal_of_a_24_by_29_target() -> None:
    base = np.array([24, 29]) / (np.sqrt(25 * 24 * 29) / 200)
    arm = tuple((base / 2.5).tolist())
    mask = pedestal((50, 50), arm, centred=False)
    assert mask.sum() == 240
    rows, cols = offsets_of(mask)
    assert rows == cols == set(range(-8, 8))


@pytest.mark.parametrize("arm", [(1.0, 1.0), (4.2, 3.1), (5.0, 9.0), (60.0, 3.0)])
def test_a_centred_pedestal_is_symmetric_and_a_cross(arm: tuple[float, float]) -> None:
    mask = pedestal((50, 50), arm, centred=True)
    np.testing.assert_array_equal(mask[1:26], mask[:-26:-1])
    np.testing.assert_array_equal(mask[:, 1:26], mask[:, :-26:-1])
    np.testing.assert_array_equal(mask, mask.T)
    assert mask[0, 0] == 1


@pytest.mark.parametrize(("threat", "height"), [(0.0, 0.044), (0.5, 0.022), (1.0, 0.0)])
def test_the_pedestal_sinks_with_the_threat(threat: float, height: float) -> None:
    gaussian, cross = gaussian_label((50, 50), sigma_cells=0.6), pedestal((50, 50), (5, 9), centred=True)
    label = ideal_label(gaussian, cross, height=0.044, threat=threat)
    assert label[0, 0] == pytest.approx(1 + height)
    assert label[4, 2] == pytest.approx(height, abs=1e-5)
    assert label[20, 20] == 0
