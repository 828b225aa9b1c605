"""The stack of feature channels a filter is trained on (spec B3)."""

import numpy as np

from mscf.arrays import Image, Real
from mscf.features.color_names import color_names
from mscf.features.fhog import CELL_PX, fhog
from mscf.features.gray import gray


def feature_stack(patch: Image, table: Real | None) -> Real:
    """Gray, 31 FHOG channels and, for a colour patch, 10 colour names, in this order.

    Parameters
    ----------
    patch : (H, W, 3) BGR or (H, W) uint8.
    table : colour-name table (32768, 10); None drops the colour names.

    Returns
    -------
    (42, M, N) or, without colour names, (32, M, N) float32; M = H // 4, not windowed.
    """
    channels = [gray(patch, CELL_PX)[None], fhog(patch[None])[0]]
    if table is not None:
        channels.append(color_names(patch, CELL_PX, table))
    return np.concatenate(channels)
