"""Scale: a one-dimensional correlation filter over a pyramid of samples (spec B8, after DSST)."""

import math
from dataclasses import dataclass

import numpy as np

from mscf.arrays import Image, Probe, Real, Real64, Spectrum, no_probe
from mscf.config import TrackerConfig
from mscf.features.fhog import CELL_PX
from mscf.kernels import Kernels
from mscf.sampling import sample


@dataclass(frozen=True, slots=True)
class ScalePlan:
    """What the scale filter keeps from initialisation. K scales, F features of a sample."""

    factors: Real64  # (K,) relative scales, largest first
    window: Real  # (K,) Hann
    label_f: Spectrum  # (K//2 + 1,)
    model_hw: tuple[int, int]  # size of a resized sample, px
    base_hw: tuple[float, float]  # size of the target at scale factor 1, px
    limits: tuple[float, float]  # lowest and highest scale factor
    config: TrackerConfig

    @classmethod
    def make(
        cls, cfg: TrackerConfig, size_hw: tuple[float, float], first_scale: float, frame_hw: tuple[int, int]
    ) -> "ScalePlan":
        """Plan for a target of `size_hw` pixels, at scale factor `first_scale`, in frames of `frame_hw`.

        Deviation from the published limits: the first scale is always within them. There, a target that is
        larger than the frame, or tiny, jumps to the limit at once.
        """
        base_hw = size_hw[0] / first_scale, size_hw[1] / first_scale
        count, step = cfg.scale_count, cfg.scale_step
        middle = count // 2
        offset = np.arange(count) - middle
        sigma = cfg.scale_sigma * math.sqrt(count)
        label = np.exp(-0.5 * offset**2 / sigma**2)
        area = size_hw[0] * size_hw[1]
        shrink = min(1.0, math.sqrt(cfg.scale_model_area_px / area))
        # one cell at least, where a target is thinner than that (the published code would have no feature)
        model_hw = max(CELL_PX, math.floor(size_hw[0] * shrink)), max(CELL_PX, math.floor(size_hw[1] * shrink))
        smallest = step ** math.ceil(math.log(5 / cfg.sample_side_px) / math.log(step))
        fit = min(frame_hw[0] / base_hw[0], frame_hw[1] / base_hw[1])
        largest = step ** math.floor(math.log(fit) / math.log(step))
        return cls(
            factors=step ** (-offset.astype(np.float64)),
            window=np.hanning(count).astype(np.float32),
            label_f=np.fft.rfft(label).astype(np.complex64),
            model_hw=model_hw,
            base_hw=base_hw,
            limits=(min(smallest, first_scale), max(largest, first_scale)),
            config=cfg,
        )


@dataclass(frozen=True, slots=True)
class ScaleFilter:
    """The learned filter: numerator and denominator."""

    num_f: Spectrum  # (K//2 + 1, F)
    den: Real  # (K//2 + 1,)


def scale_features(frame: Image, pos_rc: tuple[float, float], scale: float, plan: ScalePlan, kernels: Kernels) -> Real:
    """Windowed FHOG features of the target at each relative scale: (K, F) float32, F = 31 * cells."""
    sizes_hw = np.multiply.outer(scale * plan.factors, plan.base_hw)  # (K, 2)
    if plan.config.sampling == "exact":
        patches = kernels.sample_exact(frame, pos_rc, sizes_hw, plan.model_hw)
    else:
        center_rc = math.floor(pos_rc[0]), math.floor(pos_rc[1])
        whole_hw = [(max(1, math.floor(h)), max(1, math.floor(w))) for h, w in sizes_hw.tolist()]
        patches = np.stack([sample(frame, center_rc, size_hw, plan.model_hw) for size_hw in whole_hw])
    # patches: (K, h, w[, 3])
    features = kernels.fhog(patches).reshape(len(patches), -1)  # (K, F)
    features *= plan.window[:, None]
    return features


def train_scale(
    x_f: Spectrum, before: ScaleFilter | None, plan: ScalePlan, kernels: Kernels, growth: float = 1.0
) -> ScaleFilter:
    """Learn a sample's spectrum.

    Parameters
    ----------
    x_f : (K//2 + 1, F) `scale_dft` of the features.
    before : None in the first frame.
    growth : size of the target over the size about which the sample was cut. Not in the published code, where the
        sample is cut again: a label that is moved by as many steps trains the same filter but for the window.
    """
    label_f = plan.label_f
    if growth != 1:
        steps, count = math.log(growth) / math.log(plan.config.scale_step), len(plan.factors)
        # larger scales come first: the label moves down
        label_f = (label_f * np.exp(2j * np.pi / count * steps * np.arange(len(label_f)))).astype(np.complex64)
    if before is None:
        before, rate = ScaleFilter(np.zeros_like(x_f), np.zeros(len(label_f), np.float32)), 1.0
    else:
        rate = plan.config.scale_learning_rate
    return ScaleFilter(*kernels.scale_learn(before.num_f, before.den, x_f, label_f, rate))


def estimate_scale(
    x_f: Spectrum,
    scale: float,
    scale_filter: ScaleFilter,
    plan: ScalePlan,
    kernels: Kernels,
    probe: Probe = no_probe,
) -> float:
    """Scale factor of the relative scale with the highest response, kept within the plan's limits.

    Not in the published code, `scale_interpolation`: the scale at the top of the parabola through that response and its
    two neighbours. Else the size is off by up to half a step, and jumps.
    """
    total_f = kernels.scale_match(scale_filter.num_f, x_f)
    response = np.fft.irfft(total_f / (scale_filter.den + np.float32(plan.config.scale_floor)), n=len(plan.factors))
    probe("scale_response", response)
    index = int(np.argmax(response))
    best = scale * float(plan.factors[index])
    if plan.config.scale_interpolation and 0 < index < len(response) - 1:
        left, top, right = response[index - 1 : index + 2].tolist()
        bend = left - 2 * top + right
        if bend < 0:  # 0 where all three are equal
            best *= plan.config.scale_step ** (0.5 * (right - left) / bend)
    return min(max(best, plan.limits[0]), plan.limits[1])
