"""Wind: a mean and gusts, as a pure function of time."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

_WAVE_COUNT = 24  # a component: enough for gusts whose distribution is nearly normal


@dataclass(frozen=True, slots=True)
class Wind:
    """Horizontal wind at the place of the vehicle; blows towards `mean_ne_mps`, north and east.

    gust_mps : standard deviation of the gusts about the mean, each component.
    correlation_s : time over which a gust forgets itself; a few seconds low above the ground.
    seed : chooses the gusts. Same seed and time, same wind, whatever was asked before.

    Raises
    ------
    ValueError
        If `gust_mps` is negative or `correlation_s` is not positive.
    """

    mean_ne_mps: tuple[float, float] = (0.0, 0.0)
    gust_mps: float = 0.0
    correlation_s: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.gust_mps < 0:
            raise ValueError(f"gust_mps is {self.gust_mps}, must not be negative")
        if self.correlation_s <= 0:
            raise ValueError(f"correlation_s is {self.correlation_s} s, must be positive")

    def velocity_ne_mps(self, time_s: float) -> tuple[float, float]:
        """Velocity of the air, north and east, at `time_s`."""
        north_mps, east_mps = self.mean_ne_mps
        if self.gust_mps == 0.0:
            return north_mps, east_mps
        waves_north, waves_east = _waves(self.seed)
        time = time_s / self.correlation_s
        # The mean square of a cosine is 1/2, hence the 2.
        amplitude_mps = self.gust_mps * math.sqrt(2.0 / _WAVE_COUNT)
        north_mps += amplitude_mps * sum(math.cos(rate * time + phase) for rate, phase in waves_north)
        east_mps += amplitude_mps * sum(math.cos(rate * time + phase) for rate, phase in waves_east)
        return north_mps, east_mps


CALM = Wind()


@lru_cache(maxsize=8)
def _waves(seed: int) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Angular rate (in units of 1/correlation time) and phase of every wave, for north and for east.

    Rates spread as a half Cauchy distribution give the spectrum of a first-order Gauss-Markov process, whose
    correlation is exp(-time / correlation time). The quantiles are stratified, so that every seed has slow
    and fast gusts; the fastest are cut at 20, as nothing that heavy follows them.
    """
    rng = np.random.default_rng((seed, 8))
    quantiles = (np.arange(_WAVE_COUNT) + rng.uniform(size=(2, _WAVE_COUNT))) / _WAVE_COUNT
    rates = np.minimum(np.tan(quantiles * (math.pi / 2)), 20.0)
    phases_rad = rng.uniform(0, 2 * math.pi, size=(2, _WAVE_COUNT))
    north, east = (tuple(zip(r.tolist(), p.tolist(), strict=True)) for r, p in zip(rates, phases_rad, strict=True))
    return north, east
