"""Boxes at the public border, centres inside; the one place that knows the half pixel between them.

Three conventions meet here and nowhere else:

* public `Box`: x, y of the top left pixel, 0-based, float;
* inside: `pos_rc`, the centre (row, column) of the box in 0-based pixel coordinates, where a pixel's
  own centre has integer coordinates: a box of odd size has an integer centre;
* ground-truth files of the data sets: as `Box`, but 1-based.
"""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Self


@dataclass(frozen=True, slots=True)
class Box:
    """Axis-parallel box in pixels: top left corner (x, y), 0-based, and size (w, h)."""

    x: float
    y: float
    w: float
    h: float

    @property
    def center_xy(self) -> tuple[float, float]:
        """Centre of the box as an area, (x + w/2, y + h/2), in pixels."""
        return self.x + self.w / 2, self.y + self.h / 2

    @property
    def is_finite(self) -> bool:
        """Whether all four are finite numbers."""
        values = (self.x, self.y, self.w, self.h)
        return all(isinstance(value, Real) and math.isfinite(value) for value in values)

    @classmethod
    def from_one_based(cls, x: float, y: float, w: float, h: float) -> Self:
        """Box of a ground-truth line, whose first pixel is (1, 1)."""
        return cls(x - 1, y - 1, w, h)

    def to_one_based(self) -> tuple[float, float, float, float]:
        """x, y, w, h with the first pixel at (1, 1), as ground-truth files have it."""
        return self.x + 1, self.y + 1, self.w, self.h

    def to_pos_size(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """`pos_rc` of the centre pixel and `size_hw`, both in pixels (spec B1)."""
        return (self.y + (self.h - 1) / 2, self.x + (self.w - 1) / 2), (self.h, self.w)

    @classmethod
    def from_pos_size(cls, pos_rc: tuple[float, float], size_hw: tuple[float, float]) -> Self:
        """Box around the centre pixel `pos_rc`; the inverse of `to_pos_size`."""
        h, w = size_hw
        return cls(pos_rc[1] - (w - 1) / 2, pos_rc[0] - (h - 1) / 2, w, h)

    def overlap_px2(self, other: Self) -> float:
        """Area of the intersection in square pixels, 0 where the boxes do not touch."""
        w = min(self.x + self.w, other.x + other.w) - max(self.x, other.x)
        h = min(self.y + self.h, other.y + other.h) - max(self.y, other.y)
        return max(w, 0.0) * max(h, 0.0)

    def iou(self, other: Self) -> float:
        """Intersection over union in 0..1; 0 where both boxes are empty."""
        shared = self.overlap_px2(other)
        union = self.w * self.h + other.w * other.h - shared
        return shared / union if union > 0 else 0.0


def round_half_away(value: float) -> int:
    """Nearest integer, halves away from zero (Python's `round` goes to even, MATLAB's does not)."""
    return math.floor(abs(value) + 0.5) * (1 if value >= 0 else -1)


def nearest_pixel(pos_rc: tuple[float, float]) -> tuple[int, int]:
    """Pixel a patch is cut around (spec B2; half a pixel goes up, as 1-based coordinates are positive)."""
    return math.floor(pos_rc[0] + 0.5), math.floor(pos_rc[1] + 0.5)
