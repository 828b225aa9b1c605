"""Targets that are made to vanish from real frames, as data sets that say when a target is hidden are few."""

import numpy as np

from mscf.arrays import Image
from mscf.geometry import Box

MARGIN = 1.4  # side of what is covered over the target's: boxes are tight, and shadows give a target away
HIDDEN_FRAMES = 15  # longer than any policy waits at 10 frames a second
SETTLED_FRAMES = 5  # for the tracker to learn the target before, and to be seen to find it after


def hidden_span(frames: int, run: int, runs: int) -> range:
    """Frames of a sequence in which run `run` of `runs` has its target covered.

    The spans of the runs are spread evenly over the sequence. Of a sequence that is too short for it, a quarter
    is covered.
    """
    length = min(HIDDEN_FRAMES, frames // 4)
    room = max(frames - length - 2 * SETTLED_FRAMES, 0)
    first = min(SETTLED_FRAMES, frames - length) + (room * run // (runs - 1) if runs > 1 else room // 2)
    return range(first, first + length)


def without_target(frame: Image, box: Box) -> Image:
    """Copy of `frame` with the target in `box` covered by what is beside it.

    The first of right, left, below and above that is inside the frame; where none is, the frame's mean colour.
    """
    rows, cols = frame.shape[:2]
    (x, y), w, h = box.center_xy, box.w * MARGIN, box.h * MARGIN
    left, right = (int(np.clip(edge, 0, cols)) for edge in (x - w / 2, x + w / 2 + 1))
    top, bottom = (int(np.clip(edge, 0, rows)) for edge in (y - h / 2, y + h / 2 + 1))
    covered = frame.copy()
    covered[top:bottom, left:right] = frame.mean(axis=(0, 1))
    for dx, dy in ((right - left, 0), (left - right, 0), (0, bottom - top), (0, top - bottom)):
        if left + dx >= 0 and right + dx <= cols and top + dy >= 0 and bottom + dy <= rows:
            covered[top:bottom, left:right] = frame[top + dy : bottom + dy, left + dx : right + dx]
            break
    return covered
