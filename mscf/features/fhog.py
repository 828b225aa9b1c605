"""FHOG: Felzenszwalb's histogram of oriented gradients, 31 channels, for a batch of patches (spec B9)."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real

CHANNELS = 31
SIGNED_BINS = 18
UNSIGNED_BINS = 9
CLIP = np.float32(0.2)
TEXTURE_WEIGHT = np.float32(0.2357)
# mean over the 4 x 4 pixels of a cell, and the part of its mass that a border cell loses to the outside
CELL_PX = 4
BORDER_GAIN = np.float32(8 / 7)
NORM_FLOOR = np.float32(1e-4 / 4 / 256)

_REACH = 510  # largest difference: 255 as a one-sided full difference counts twice a central half one
_SPAN = 2 * _REACH + 1


@lru_cache(maxsize=1)
def _orientation_bins() -> npt.NDArray[np.uint8]:
    """Nearest of 18 directions for each pair of differences, at (dy + 510) * 1021 + dx + 510.

    The published code looks angles up by their cosine, cut after the fourth digit. That moves the border
    between two directions by less than 0.03 degrees, and with it the pixels whose gradient lies there.
    """
    d = np.arange(-_REACH, _REACH + 1, dtype=np.float64)
    dx, dy = d[None, :], d[:, None]
    length = np.hypot(dx, dy)
    cosine = np.divide(dx, length, out=np.ones_like(length), where=length > 0)
    upper_half = np.arccos(np.trunc(np.where(dy < 0, -cosine, cosine) * 1e4) / 1e4)
    angle = upper_half + np.pi * (dy < 0)
    return (np.floor(angle * (SIGNED_BINS / (2 * np.pi)) + 0.5).astype(np.int64) % SIGNED_BINS).astype(np.uint8).ravel()


@lru_cache(maxsize=64)
def _pooling(rows: int, cols: int) -> tuple[npt.NDArray[np.intp], Real]:
    """Where each of rows x cols cells' pixels vote, and how much: index and weight, (2, 2, H * W) each.

    A pixel's magnitude is shared bilinearly among the 2 x 2 nearest cells. The axes choose the nearer or the
    farther cell by row and by column. The index is into (rows, cols) cells; votes for cells outside weigh 0.
    """

    def axis(cells: int) -> tuple[npt.NDArray[np.intp], Real]:
        px = np.arange(cells * CELL_PX)
        coordinate = (px + 0.5) / CELL_PX - 0.5
        near = px // CELL_PX
        far = np.where(coordinate > near, near + 1, near - 1)
        far_weight = np.abs(coordinate - near)
        inside = (far >= 0) & (far < cells)
        index = np.stack([near, np.clip(far, 0, cells - 1)])
        weight = np.stack([1 - far_weight, np.where(inside, far_weight, 0)])
        # a border cell is scaled by 8/7: into the weight of whatever votes for it
        border = ((index == 0) * 1.0) + ((index == cells - 1) * 1.0)
        return index.astype(np.intp), (weight * BORDER_GAIN**border).astype(np.float32)

    row_index, row_weight = axis(rows)
    col_index, col_weight = axis(cols)
    index = row_index[:, None, :, None] * cols + col_index[None, :, None, :]
    weight = row_weight[:, None, :, None] * col_weight[None, :, None, :]
    size = rows * cols * CELL_PX**2
    # the cell mean 1/16, and 1/2 as differences are of two pixels
    return index.reshape(2, 2, size), (weight / (2 * CELL_PX**2)).reshape(2, 2, size).astype(np.float32)


def fhog(patches: Image) -> Real:
    """FHOG of a batch of patches with cells of 4 pixels.

    Parameters
    ----------
    patches : (B, H, W, 3) BGR or (B, H, W) uint8; each side at least 4.

    Returns
    -------
    (B, 31, H // 4, W // 4) float32: 18 signed and 9 unsigned orientations, 4 texture energies.

    References
    ----------
    Felzenszwalb et al., PAMI 2010, in the form of P. Dollar's toolbox without interpolation between
    orientations, which the published tracker uses (spec B9).
    """
    return normalise(histogram(patches))


def histogram(patches: Image) -> Real:
    """Gradient magnitude by cell and signed orientation: (B, H, W[, 3]) uint8 -> (B, 18, H//4, W//4) float32."""
    rows, cols = patches.shape[1] // CELL_PX, patches.shape[2] // CELL_PX
    batch = patches.shape[0]
    bins, magnitude = gradient(patches)
    inner = (slice(None), slice(0, rows * CELL_PX), slice(0, cols * CELL_PX))
    first = (bins[inner].astype(np.intp) * (rows * cols)).reshape(batch, -1)
    first += (np.arange(batch) * (SIGNED_BINS * rows * cols))[:, None]
    votes = magnitude[inner].reshape(batch, -1)
    index, weight = _pooling(rows, cols)
    size = batch * SIGNED_BINS * rows * cols
    total = np.zeros(size)
    for i in range(2):
        for j in range(2):
            total += np.bincount((first + index[i, j]).ravel(), (votes * weight[i, j]).ravel(), minlength=size)
    return total.reshape(batch, SIGNED_BINS, rows, cols).astype(np.float32)


def gradient(patches: Image) -> tuple[npt.NDArray[np.uint8], Real]:
    """Orientation bin (0..17) and twice the magnitude of the strongest colour channel's gradient, (B, H, W) each."""
    planes = patches[..., None] if patches.ndim == 3 else patches[..., ::-1]  # R first: the first wins among equals
    values = np.ascontiguousarray(np.moveaxis(planes, -1, 0), dtype=np.int16)  # (1 or 3, B, H, W)
    dy, dx = np.empty_like(values), np.empty_like(values)
    np.subtract(values[..., 2:, :], values[..., :-2, :], out=dy[..., 1:-1, :])
    np.subtract(values[..., 2:], values[..., :-2], out=dx[..., 1:-1])
    for edge, inner in ((0, 1), (-1, -2)):
        sign = 2 if edge == 0 else -2
        dy[..., edge, :] = sign * (values[..., inner, :] - values[..., edge, :])
        dx[..., edge] = sign * (values[..., inner] - values[..., edge])
    squared = np.square(dx, dtype=np.int32) + np.square(dy, dtype=np.int32)
    code = (dy.astype(np.int32) + _REACH) * _SPAN + (dx + np.int16(_REACH))
    best, best_code = squared[0], code[0]
    for other, other_code in zip(squared[1:], code[1:], strict=True):
        stronger = other > best
        best, best_code = np.where(stronger, other, best), np.where(stronger, other_code, best_code)
    return _orientation_bins()[best_code], np.sqrt(best, dtype=np.float32)


def normalise(cells: Real) -> Real:
    """Block-normalised channels of cell histograms: (B, 18, M, N) -> (B, 31, M, N) float32."""
    batch, _, rows, cols = cells.shape
    unsigned = cells[:, :UNSIGNED_BINS] + cells[:, UNSIGNED_BINS:]  # (B, 9, M, N)
    energy = np.einsum("bkmn,bkmn->bmn", unsigned, unsigned)
    gain = 1 / np.sqrt(_block_sums(energy) + NORM_FLOOR)  # (B, M + 1, N + 1): block (i, j) ends at cell (i, j)
    features = np.empty((batch, CHANNELS, rows, cols), np.float32)
    signed_out, unsigned_out = features[:, :SIGNED_BINS], features[:, SIGNED_BINS : SIGNED_BINS + UNSIGNED_BINS]
    signed_out[:] = 0
    unsigned_out[:] = 0
    for b, (i, j) in enumerate(((1, 1), (0, 1), (1, 0), (0, 0))):  # blocks below right, above right, below left, ...
        block_gain = gain[:, None, i : i + rows, j : j + cols]  # (B, 1, M, N)
        clipped = np.minimum(cells * block_gain, CLIP)
        signed_out += clipped
        features[:, SIGNED_BINS + UNSIGNED_BINS + b] = TEXTURE_WEIGHT * clipped.sum(axis=1)
        unsigned_out += np.minimum(unsigned * block_gain, CLIP)
    features[:, : SIGNED_BINS + UNSIGNED_BINS] *= np.float32(0.5)
    return features


def _block_sums(energy: Real) -> Real:
    """Sums over 2 x 2 cells; blocks that would reach over the border repeat the nearest one inside."""
    rows, cols = energy.shape[1:]
    row = np.clip(np.arange(rows + 1), 1, max(rows - 1, 1))  # block i covers cells i - 1 and i
    col = np.clip(np.arange(cols + 1), 1, max(cols - 1, 1))
    below, right = np.minimum(row, rows - 1), np.minimum(col, cols - 1)
    by_row = energy[:, row - 1] + energy[:, below]
    return by_row[:, :, col - 1] + by_row[:, :, right]
