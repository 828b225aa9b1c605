"""What the tracker accepts: frames and first boxes."""

import numpy as np

from mscf.arrays import Image
from mscf.errors import BoxError, FrameError
from mscf.geometry import Box

MIN_BOX_PX = 4.0
MAX_BOX_SHARE = 4.0  # of the frame's sides; what is larger is a mistake, and would cost seconds an update


def check_frame(frame: Image) -> None:
    """Raise FrameError where `frame` is not (H, W, 3) or (H, W) uint8."""
    if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8:
        if frame is None:
            raise FrameError("a frame must be an array of uint8, got None: did the video or camera open?")
        got = frame.dtype if isinstance(frame, np.ndarray) else type(frame).__name__
        raise FrameError(f"a frame must be an array of uint8, got {got}: convert with .astype(numpy.uint8)")
    is_color = frame.ndim == 3 and frame.shape[2] == 3
    if not (is_color or frame.ndim == 2) or 0 in frame.shape:
        raise FrameError(f"a frame must have the shape (H, W, 3), BGR, or (H, W), gray, got {frame.shape}")


def check_same_shape(frame: Image, shape: tuple[int, ...]) -> None:
    """Raise FrameError where `frame` has another shape than the first one."""
    if frame.shape != shape:
        text = f"the frame has the shape {frame.shape}, the one given to init had {shape}"
        raise FrameError(f"{text}: resize it, or call init again")


def check_box(box: Box, frame: Image) -> None:
    """Raise BoxError where `box` cannot be a target in `frame`."""
    rows, cols = frame.shape[:2]
    if not isinstance(box, Box):
        raise BoxError(f"a box must be a mscf.Box, got {type(box).__name__}: make one with Box(x, y, w, h)")
    if not box.is_finite:
        raise BoxError(f"{box} is not finite: x, y, w and h must be numbers")
    if box.w < MIN_BOX_PX or box.h < MIN_BOX_PX:
        raise BoxError(f"{box} is too small: w and h must be at least {MIN_BOX_PX:g} px")
    if max(box.w / cols, box.h / rows) > MAX_BOX_SHARE:
        text = f"{box} is too large: w and h must be at most {MAX_BOX_SHARE:g} times the frame's {cols} x {rows}"
        raise BoxError(text)
    if box.overlap_px2(Box(0, 0, cols, rows)) <= 0:
        raise BoxError(f"{box} is outside the frame: it must overlap x 0..{cols}, y 0..{rows}")


def is_gray(frame: Image) -> bool:
    """Whether one channel says all.

    Deviation: the published code compares R and G only, which a blue object on black would fool.
    """
    if frame.ndim == 2:
        return True
    return bool((frame[..., 0] == frame[..., 1]).all() and (frame[..., 1] == frame[..., 2]).all())


def single_channel(frame: Image) -> Image:
    """First channel of a frame whose channels are equal: (H, W)."""
    return frame if frame.ndim == 2 else frame[..., 0]
