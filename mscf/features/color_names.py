"""Colour names: mean of a colour's name coordinates over a cell (spec B3, D)."""

import zipfile
import zlib
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from mscf.arrays import Image, Real
from mscf.errors import ConfigError

OWN_TABLE = Path(__file__).parent.parent / "data" / "color_names.npz"
TABLE_SHAPE = (32 * 32 * 32, 10)


@lru_cache(maxsize=4)
def load_table(path: Path | None) -> Real:
    """Read a colour-name table; None: the one that comes with the package (`mscf/data/README.md`).

    Parameters
    ----------
    path : .npz with the array `table`, (32768, 10): row R>>3 + 32*(G>>3) + 1024*(B>>3) has the coordinates of
        that colour's 11 name probabilities in a 10-dimensional sum-zero subspace.

    Returns
    -------
    (32768, 10) float32, read-only.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds no finite array of that shape.
    """
    source = OWN_TABLE if path is None else path
    try:
        with np.load(source) as archive:
            table = np.ascontiguousarray(archive["table"], dtype=np.float32)
    except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        text = f"color_table {source} cannot be read ({error}): give an .npz with an array 'table' of {TABLE_SHAPE}"
        raise ConfigError(text) from error
    if table.shape != TABLE_SHAPE or not np.isfinite(table).all():
        text = f"color_table {source} has shape {table.shape}: 'table' must be finite and of shape {TABLE_SHAPE}"
        raise ConfigError(text)
    table.flags.writeable = False
    return table


def color_names(patch: Image, cell_px: int, table: Real) -> Real:
    """Mean of the table's rows over each cell.

    Parameters
    ----------
    patch : (H, W, 3) BGR uint8; H and W are multiples of `cell_px`.
    table : see `load_table`.

    Returns
    -------
    (10, H / cell, W / cell) float32.
    """
    rows, cols = patch.shape[0] // cell_px, patch.shape[1] // cell_px
    blue, green, red = (np.asarray(plane, np.int32) for plane in cv2.split(patch >> 3))
    index = (((blue << 5) | green) << 5) | red
    names = table.take(index.ravel(), axis=0, mode="clip")  # (H * W, 10); "clip" as it does not check, and none is out
    # sum over the rows, then mean over the columns of a cell; NumPy's own sum over an axis takes thrice as long
    over_rows = np.ones((1, cell_px), np.float32) @ names.reshape(rows, cell_px, -1)  # (M, 1, W * 10)
    cells = cv2.resize(over_rows.reshape(rows, cols * cell_px, -1), (cols, rows), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.moveaxis(cells, 2, 0), np.float32) / np.float32(cell_px)  # (10, M, N)
