"""Confidence: how likely it is that the box holds the target, judged by the responses alone.

A logistic function of two logarithms, each relative to the first responses after the start: the peak of this
response, and the running mean of the average peak-to-correlation energy. How the coefficients were found, what
else was tried, and what the number is worth: docs/confidence.md; `python -m mscf.evaluation.calibration` finds
them again.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mscf.arrays import Real

FIRST_RESPONSES = 5  # after the start, whose mean is the measure of a good one
RECENT_RATE = 0.2  # of the running mean, per response: its memory is five responses
LOWEST_PEAK = 1e-3  # below it there is no response to speak of: those of targets are of 0.02 and more

# docs/confidence.md has the command and the data
BIAS = 2.00
LOG_PEAK = 1.43
LOG_APCE = 1.75


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one response map says."""

    log_peak: float  # -inf: there is none
    log_apce: float  # of the average peak-to-correlation energy

    @classmethod
    def of(cls, response: Real) -> Self:
        """Evidence of a response map (M, N) float32, of any values."""
        peak = float(response.max())
        if not peak > LOWEST_PEAK:
            return cls(-math.inf, 0.0)
        return cls(math.log(peak), math.log(peak_to_energy(response)))


@dataclass(frozen=True, slots=True)
class History:
    """What the responses up to now were like."""

    count: int = 0  # of responses, up to the first ones
    first: Evidence = Evidence(0.0, 0.0)  # mean of the first ones
    recent_log_apce: float = math.nan  # running mean; NaN: there is none yet

    def after(self, evidence: Evidence) -> "History":
        """History with one more response."""
        starts_anew = math.isnan(self.recent_log_apce)
        before = evidence.log_apce if starts_anew else self.recent_log_apce
        recent = before + RECENT_RATE * (evidence.log_apce - before)
        if self.count == FIRST_RESPONSES:
            return replace(self, recent_log_apce=recent)
        count = self.count + 1
        first = Evidence(
            self.first.log_peak + (max(evidence.log_peak, math.log(LOWEST_PEAK)) - self.first.log_peak) / count,
            self.first.log_apce + (evidence.log_apce - self.first.log_apce) / count,
        )
        return History(count, first, recent)

    def elsewhere(self) -> "History":
        """History for another place: the first responses still count, the recent ones do not."""
        return replace(self, recent_log_apce=math.nan)


def peak_to_energy(response: Real) -> float:
    """Average peak-to-correlation energy: (maximum - minimum)^2 over the mean of (value - minimum)^2.

    High where one sharp peak stands over calm surroundings (Wang et al., CVPR 2017).

    Parameters
    ----------
    response : (M, N) float32.

    Returns
    -------
    1 .. M*N; 1 for a map that is constant.
    """
    above = response.astype(np.float64) - float(response.min())
    energy = float(np.mean(above * above))
    return float(above.max()) ** 2 / energy if energy > 0 else 1.0


def confidence(evidence: Evidence, history: History) -> float:
    """Probability in 0..1 that the target is where the peak of a response is.

    Parameters
    ----------
    evidence : of that response.
    history : up to and with that response.

    Returns
    -------
    A number that rises with the peak and with the recent peak-to-correlation energy; 0 where there is no peak.
    """
    if evidence.log_peak == -math.inf:
        return 0.0
    log_peak = evidence.log_peak - history.first.log_peak
    log_apce = history.recent_log_apce - history.first.log_apce
    return 1 / (1 + math.exp(-(BIAS + LOG_PEAK * log_peak + LOG_APCE * log_apce)))
