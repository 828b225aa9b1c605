"""Pictures of tree crowns: a handful of varieties, painted once and scaled to every tree."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from mscf.arrays import Image

VARIETIES = 6
CROWN_PX = 128  # side of a picture; the crown's diameter spans it
_CROWNS_BGR = ((40, 74, 60), (36, 68, 62), (44, 78, 68), (42, 62, 50), (40, 78, 74), (50, 74, 60))


@dataclass(frozen=True, eq=False, slots=True)
class Crown:
    """image : (S, S, 3) uint8 BGR; mask : (S, S) uint8, 255 where there are leaves."""

    image: Image
    mask: Image


@cache
def crowns(seed: int) -> tuple[Crown, ...]:
    """All varieties, lit from the upper left, as seen obliquely from above."""
    rng = np.random.default_rng((seed, 3))
    return tuple(_crown(rng, k) for k in range(VARIETIES))


def _crown(rng: np.random.Generator, variety: int) -> Crown:
    """One crown: a cluster of leafy balls as a height field, lit and roughened."""
    y, x = np.mgrid[-1 : 1 : CROWN_PX * 1j, -1 : 1 : CROWN_PX * 1j]
    height = np.full(x.shape, -1.0)
    for _ in range(190):
        angle, reach = rng.uniform(0, 2 * np.pi), 0.84 * np.sqrt(rng.uniform())
        ball = rng.uniform(0.08, 0.17)
        inside = ball**2 - (x - reach * np.cos(angle)) ** 2 - (y - reach * np.sin(angle)) ** 2
        dome = 0.7 * np.sqrt(max(1 - reach**2, 0.0))
        height = np.where(inside > 0, np.maximum(height, dome + np.sqrt(np.maximum(inside, 0))), height)
    leaves = rng.standard_normal((2, CROWN_PX, CROWN_PX))
    leaves[1] = cv2.GaussianBlur(leaves[1], (0, 0), 1.5) * 4
    clumps = 0.5 * leaves[0] + 0.7 * leaves[1]
    slope_y, slope_x = np.gradient(cv2.GaussianBlur(np.maximum(height, 0), (0, 0), 1.2) * CROWN_PX / 2)
    facing = (0.55 * slope_x + 0.55 * slope_y + 0.75) / np.sqrt(slope_x**2 + slope_y**2 + 1)
    # Low parts get less of the sky: the gaps between the balls and the lower rim go dark.
    openness = np.clip(0.45 + 0.55 * height, 0.2, 1) * (1 - 0.22 * (y + 0.2))
    light = (0.38 + 0.72 * np.clip(facing, 0, 1)) * openness * (1 + 0.24 * clumps)
    color = np.array(_CROWNS_BGR[variety]) * np.clip(light * 1.55, 0, 2.2)[..., None]
    rim = cv2.GaussianBlur((height > -1).astype(np.float64), (0, 0), 2.0) + 0.1 * clumps
    mask = np.where((rim > 0.5) & (height > -1), 255, 0).astype(np.uint8)
    image = np.clip(color, 0, 255).astype(np.uint8)
    image.setflags(write=False)
    mask.setflags(write=False)
    return Crown(image, mask)
