"""FHOG: Felzenszwalb's histogram of oriented gradients, 31 channels, for a batch of patches (spec B9)."""

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from mscf.arrays import Image, Real, Real64

CHANNELS = 31
SIGNED_BINS = 18
UNSIGNED_BINS = 9
CLIP = np.float32(0.2)
TEXTURE_WEIGHT = np.float32(0.2357)
CELL_PX = 4
BORDER_GAIN = 8 / 7  # makes up for what a cell at the border would get from pixels outside
NORM_FLOOR = np.float32(1e-4 / 4 / 256)

_REACH = 510  # largest difference: 255 as a one-sided full difference counts twice a central half one
_SPAN = 2 * _REACH + 1


@lru_cache(maxsize=1)
def orientation_bins() -> npt.NDArray[np.uint8]:
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
    nearest = np.floor(angle * (SIGNED_BINS / (2 * np.pi)) + 0.5).astype(np.int64) % SIGNED_BINS
    table = np.ravel(nearest.astype(np.uint8))
    table.flags.writeable = False
    return table


@lru_cache(maxsize=64)
def _pooling(rows: int, cols: int) -> tuple[npt.NDArray[np.intp], Real64]:
    """Where the pixels of rows x cols cells vote, and how much: index and weight, (4, 16 * rows * cols) each.

    A pixel's magnitude is shared bilinearly among the 2 x 2 nearest cells: the first axis goes through these
    four. The index is into (rows, cols) cells; votes for cells outside weigh 0.
    """

    def axis(cells: int) -> tuple[npt.NDArray[np.intp], Real64]:
        px = np.arange(cells * CELL_PX)
        coordinate = (px + 0.5) / CELL_PX - 0.5
        near = px // CELL_PX
        far = np.where(coordinate > near, near + 1, near - 1)
        far_weight = np.abs(coordinate - near)
        inside = (far >= 0) & (far < cells)
        index = np.stack([near, np.clip(far, 0, cells - 1)])
        weight = np.stack([1 - far_weight, np.where(inside, far_weight, 0)])
        border = ((index == 0) * 1.0) + ((index == cells - 1) * 1.0)
        return index, weight * BORDER_GAIN**border

    row_index, row_weight = axis(rows)  # (2, 4 * rows): nearer and farther cell
    col_index, col_weight = axis(cols)
    index = row_index[:, None, :, None] * cols + col_index[None, :, None, :]
    weight = row_weight[:, None, :, None] * col_weight[None, :, None, :]
    # mean over the cell's pixels; 1/2 as `gradient` gives differences over two pixels
    return index.reshape(4, -1).astype(np.intp), weight.reshape(4, -1) / (2 * CELL_PX**2)


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
    """Gradient magnitude by signed orientation and cell: (B, H, W[, 3]) uint8 -> (B, 18, H//4, W//4) float32."""
    batch, rows, cols = patches.shape[0], patches.shape[1] // CELL_PX, patches.shape[2] // CELL_PX
    bins, magnitude = gradient(patches)
    inner = (slice(None), slice(0, rows * CELL_PX), slice(0, cols * CELL_PX))  # a rest below a cell is left out
    index, weight = _pooling(rows, cols)
    plane = bins[inner].reshape(batch, 1, -1).astype(np.intp)  # (B, 1, 16 * rows * cols)
    plane += np.arange(batch)[:, None, None] * SIGNED_BINS
    votes = magnitude[inner].reshape(batch, 1, -1) * weight  # (B, 4, 16 * rows * cols)
    size = batch * SIGNED_BINS * rows * cols
    total = np.bincount((plane * (rows * cols) + index).ravel(), votes.ravel(), minlength=size)
    return total.reshape(batch, SIGNED_BINS, rows, cols).astype(np.float32)


def gradient(patches: Image) -> tuple[npt.NDArray[np.uint8], Real]:
    """Strongest gradient among the colour channels at each pixel.

    Returns
    -------
    Orientation bin, 0..17, uint8, and twice the magnitude, float32; (B, H, W) each.
    """
    batch, rows, cols = patches.shape[:3]
    # R first, as the first channel wins among equals; (1 or 3, B, H, W)
    planes = np.stack(cv2.split(patches.reshape(batch * rows, cols, -1))[::-1]).astype(np.int16)
    planes = planes.reshape(-1, batch, rows, cols)
    dy, dx = np.empty_like(planes), np.empty_like(planes)
    np.subtract(planes[..., 2:, :], planes[..., :-2, :], out=dy[..., 1:-1, :])
    np.subtract(planes[..., 2:], planes[..., :-2], out=dx[..., 1:-1])
    for edge, inner, sign in ((0, 1, 2), (-1, -2, -2)):  # one pixel apart, so twice as much
        dy[..., edge, :] = sign * (planes[..., inner, :] - planes[..., edge, :])
        dx[..., edge] = sign * (planes[..., inner] - planes[..., edge])
    dx_float, dy_float = dx.astype(np.float32), dy.astype(np.float32)
    squared = dx_float * dx_float + dy_float * dy_float  # exact: whole numbers below 2^24
    shape = batch * rows, cols
    strongest, dx_best, dy_best = squared[0], dx[0].reshape(shape), dy[0].reshape(shape)
    for plane in range(1, len(planes)):
        is_stronger = (squared[plane] > strongest).view(np.uint8).reshape(shape)
        strongest = np.maximum(strongest, squared[plane])
        cv2.copyTo(dx[plane].reshape(shape), is_stronger, dx_best)
        cv2.copyTo(dy[plane].reshape(shape), is_stronger, dy_best)
    code = dy_best.astype(np.int32) * _SPAN + dx_best + (_REACH * _SPAN + _REACH)
    return orientation_bins().take(code.reshape(batch, rows, cols)), np.sqrt(strongest)


def normalise(cells: Real) -> Real:
    """Block-normalised channels of cell histograms: (B, 18, M, N) -> (B, 31, M, N) float32."""
    batch, _, rows, cols = cells.shape
    oriented = SIGNED_BINS + UNSIGNED_BINS
    energies = np.empty((batch, oriented, rows, cols), np.float32)
    energies[:, :SIGNED_BINS] = cells
    unsigned = np.add(cells[:, :UNSIGNED_BINS], cells[:, UNSIGNED_BINS:], out=energies[:, SIGNED_BINS:])
    gain = 1 / np.sqrt(_block_sums((unsigned * unsigned).sum(axis=1)) + NORM_FLOOR)
    features = np.zeros((batch, CHANNELS, rows, cols), np.float32)
    clipped = np.empty_like(energies)
    every_signed_bin = np.full((1, SIGNED_BINS), TEXTURE_WEIGHT)
    for block, (i, j) in enumerate(((1, 1), (0, 1), (1, 0), (0, 0))):  # which ends where: see `_block_sums`
        np.multiply(energies, gain[:, None, i : i + rows, j : j + cols], out=clipped)
        np.minimum(clipped, CLIP, out=clipped)
        features[:, :oriented] += clipped
        signed = clipped[:, :SIGNED_BINS].reshape(batch, SIGNED_BINS, rows * cols)
        features[:, oriented + block] = (every_signed_bin @ signed).reshape(batch, rows, cols)
    features[:, :oriented] *= np.float32(0.5)
    return features


def _block_sums(energy: Real) -> Real:
    """Sums over 2 x 2 cells, (B, M, N) -> (B, M + 1, N + 1): block (i, j) covers cells i-1..i, j-1..j.

    Blocks that would reach over the border repeat the nearest one inside.
    """
    # one cell alone is its own neighbour
    lower, right = max(energy.shape[1] - 1, 1), max(energy.shape[2] - 1, 1)
    by_row = energy[:, :lower] + energy[:, -lower:]
    inside: Real = by_row[:, :, :right] + by_row[:, :, -right:]  # (B, M - 1, N - 1)
    row = np.clip(np.arange(energy.shape[1] + 1) - 1, 0, lower - 1)
    col = np.clip(np.arange(energy.shape[2] + 1) - 1, 0, right - 1)
    return np.asarray(inside.take(row, axis=1).take(col, axis=2), np.float32)
