"""A small moving target: frames, truth, and the folder of a sequence."""

from pathlib import Path

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.geometry import Box

FRAMES = 12
FIRST = Box(40, 30, 24, 18)


def moving_target() -> list[Image]:
    """Twelve 96 x 128 frames with a target that goes right and down, 3 and 2 px a frame."""
    rng = np.random.default_rng(5)

    def texture(rows: int, cols: int) -> Image:
        coarse = rng.integers(0, 256, (rows // 4 + 1, cols // 4 + 1, 3), dtype=np.uint8)
        return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.uint8)

    ground, target = texture(96, 128) // 3, texture(18, 24)
    frames = []
    for index in range(FRAMES):
        frame = ground.copy()
        x, y = int(FIRST.x) + 3 * index, int(FIRST.y) + 2 * index
        frame[y : y + 18, x : x + 24] = target
        frames.append(frame)
    return frames


def truth_text() -> str:
    """Ground truth of `moving_target`, 1-based."""
    return "".join(f"{FIRST.x + 1 + 3 * i:g},{FIRST.y + 1 + 2 * i:g},24,18\n" for i in range(FRAMES))


def write_sequence(folder: Path) -> Path:
    """A sequence as data sets have it: FOLDER/img/000001.png, FOLDER/groundtruth.txt."""
    (folder / "img").mkdir(parents=True)
    for number, frame in enumerate(moving_target(), start=1):
        cv2.imwrite(str(folder / "img" / f"{number:06d}.png"), frame)
    (folder / "groundtruth.txt").write_text(truth_text())
    return folder
