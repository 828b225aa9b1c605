"""Gray channel: mean luminance of a cell (spec B3)."""

import cv2
import numpy as np

from mscf.arrays import Image, Real

# weights of B, G, R (ITU-R BT.601, as MATLAB's rgb2gray rounds them)
LUMA_BGR = np.array([[0.114021, 0.587043, 0.298936]], np.float32)


def gray(patch: Image, cell_px: int) -> Real:
    """Mean of luminance / 255 - 0.5 over each cell.

    Parameters
    ----------
    patch : (H, W, 3) BGR or (H, W) uint8.
    cell_px : side of a cell; H and W are multiples of it.

    Returns
    -------
    (H / cell, W / cell) float32 in -0.5..0.5.
    """
    values = patch.astype(np.float32)
    luma = values if patch.ndim == 2 else cv2.transform(values, LUMA_BGR)
    size_wh = patch.shape[1] // cell_px, patch.shape[0] // cell_px
    mean = cv2.resize(luma, size_wh, interpolation=cv2.INTER_AREA)
    return np.asarray(mean, dtype=np.float32) / np.float32(255) - np.float32(0.5)
