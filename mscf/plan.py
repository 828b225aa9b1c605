"""Everything that is fixed by a configuration, a frame size and a first box."""

import math
from dataclasses import dataclass

import numpy as np

from mscf.arrays import Real, Spectrum
from mscf.config import TrackerConfig
from mscf.features.color_names import load_table
from mscf.features.fhog import CELL_PX
from mscf.geometry import Box
from mscf.kernels import Kernels
from mscf.labels import gaussian_label, pedestal
from mscf.scale import ScalePlan
from mscf.spectrum import SupportTransform, dft


@dataclass(frozen=True, slots=True)
class Plan:
    """Sizes, windows, labels and grids of one initialisation. S = M = N cells a side."""

    config: TrackerConfig
    kernels: Kernels
    frame_shape: tuple[int, ...]  # every later frame has this shape
    is_gray: bool  # one channel is looked at, and no colour names
    color_table: Real | None  # (32768, 10), weighted
    first_scale: float  # scale factor of the first frame: frame pixels per pixel of the resized patch
    base_hw: tuple[float, float]  # size of the target at scale factor 1, px of the resized patch
    grid_mn: tuple[int, int]  # (S, S) cells
    window: Real  # (S, S) Hann
    gaussian: Real  # (S, S) y1
    pedestal: Real  # (S, S) y2
    gaussian_f: Spectrum  # (S, S//2 + 1)
    pedestal_f: Spectrum  # (S, S//2 + 1)
    support: SupportTransform  # of the filter
    scale: ScalePlan

    @classmethod
    def make(
        cls, cfg: TrackerConfig, frame_shape: tuple[int, ...], box: Box, *, is_gray: bool, kernels: Kernels
    ) -> "Plan":
        """Plan for a target `box` in frames of `frame_shape` (spec B1, B3-B5)."""
        _, size_hw = box.to_pos_size()
        first_scale = math.sqrt(cfg.search_area_ratio * box.w * box.h) / cfg.sample_side_px
        base_hw = size_hw[0] / first_scale, size_hw[1] / first_scale
        cells = cfg.sample_side_px // CELL_PX
        grid_mn = cells, cells
        # the support cannot exceed the grid, which only very long boxes would
        support_mn = (
            min(max(math.floor(base_hw[0] / CELL_PX), 1), cells),
            min(max(math.floor(base_hw[1] / CELL_PX), 1), cells),
        )
        arm_mn = (
            max(base_hw[0] / CELL_PX / cfg.pedestal_ratio, cfg.pedestal_min_cells),
            max(base_hw[1] / CELL_PX / cfg.pedestal_ratio, cfg.pedestal_min_cells),
        )
        sigma_cells = cfg.label_sigma * math.sqrt(support_mn[0] * support_mn[1])
        hann = np.hanning(cells).astype(np.float32)
        gaussian = gaussian_label(grid_mn, sigma_cells=sigma_cells)
        cross = pedestal(grid_mn, arm_mn, centred=cfg.pedestal_centred)
        return cls(
            config=cfg,
            kernels=kernels,
            frame_shape=frame_shape,
            is_gray=is_gray,
            color_table=None if is_gray else np.float32(cfg.color_weight) * load_table(cfg.color_table),
            first_scale=first_scale,
            base_hw=base_hw,
            grid_mn=grid_mn,
            window=np.outer(hann, hann),
            gaussian=gaussian,
            pedestal=cross,
            gaussian_f=dft(gaussian),
            pedestal_f=dft(cross),
            support=SupportTransform.centred(grid_mn, support_mn),
            scale=ScalePlan.make(cfg, size_hw, first_scale, (frame_shape[0], frame_shape[1])),
        )

    def box_at(self, pos_rc: tuple[float, float], scale: float) -> Box:
        """Box of the target with its centre at `pos_rc` and the given scale factor."""
        return Box.from_pos_size(pos_rc, (self.base_hw[0] * scale, self.base_hw[1] * scale))
