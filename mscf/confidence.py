"""Confidence: how likely it is that the box holds the target, judged by the response alone.

A logistic function of the logarithm of the peak-to-sidelobe ratio. How the coefficients were found, what else was
tried, and what the number is worth: docs/confidence.md; `python -m mscf.evaluation.calibration` finds them again.
"""

import math

import numpy as np

from mscf.arrays import Real

SIDELOBE_HOLE_CELLS = 5  # half side of the square around the peak that is not sidelobe (Bolme et al., CVPR 2010)
LOWEST_PEAK = 1e-3  # below it there is no response to speak of: those of targets are of 0.02 and more

# docs/confidence.md has the command and the data
BIAS = -7.23
LOG_PSR = 2.93


def peak_to_sidelobe(response: Real) -> float:
    """Peak-to-sidelobe ratio: (maximum - mean) / deviation, the latter two of all but 11 x 11 cells around it.

    Parameters
    ----------
    response : (M, N) float32, circular, each side over 11 cells.

    Returns
    -------
    0 for a map that is constant.
    """
    rows, cols = response.shape
    row, col = np.unravel_index(int(np.argmax(response)), (rows, cols))
    reach = np.arange(-SIDELOBE_HOLE_CELLS, SIDELOBE_HOLE_CELLS + 1)
    rest = response.astype(np.float64)
    peak = float(rest[row, col])
    is_sidelobe = np.ones((rows, cols), dtype=bool)
    is_sidelobe[np.ix_((row + reach) % rows, (col + reach) % cols)] = False
    sidelobe = rest[is_sidelobe]
    deviation = float(sidelobe.std())
    return (peak - float(sidelobe.mean())) / deviation if deviation > 0 else 0.0


def confidence(peak: float, ratio: float) -> float:
    """Probability in 0..1 that the target is where the peak of a response is.

    Parameters
    ----------
    peak : maximum of the response.
    ratio : its `peak_to_sidelobe`.

    Returns
    -------
    A number that rises with the ratio; 0 where there is no peak.
    """
    if not peak > LOWEST_PEAK:  # also where it is NaN
        return 0.0
    if not 0 < ratio < math.inf:  # an infinite peak is no target
        return 0.0
    return 1 / (1 + math.exp(-(BIAS + LOG_PSR * math.log(ratio))))
