"""Names for the arrays and the hook that cross module borders."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]  # (H, W, 3) BGR or (H, W) gray
Real = npt.NDArray[np.float32]
Real64 = npt.NDArray[np.float64]
Spectrum = npt.NDArray[np.complex64]  # `_f`: half spectrum of rfft2, last axis N//2 + 1


class Probe(Protocol):
    """Called with the name and value of an intermediate array; it must not change the array."""

    def __call__(self, name: str, array: npt.NDArray[Any], /) -> None: ...


def no_probe(_name: str, _array: npt.NDArray[Any], /) -> None:
    """Look at nothing: what the tracker uses where no probe is given."""
