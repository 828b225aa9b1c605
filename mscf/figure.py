"""The paper's Fig. 1 as a plot: threat, its change from frame to frame, and the error where truth is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mscf.errors import OutputError
from mscf.evaluation.metrics import PRECISION_PX, center_errors_px, overlaps
from mscf.geometry import Box
from mscf.overlay import COLORS_BGR

ERROR_TICKS_PX = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
# one colour a tracker, those of the video
COLORS = tuple(f"#{red:02x}{green:02x}{blue:02x}" for blue, green, red in COLORS_BGR)


@dataclass(frozen=True, slots=True)
class Track:
    """What one tracker said of each frame."""

    name: str
    boxes: Sequence[Box]
    threats: Sequence[float]


def check_plottable(path: Path) -> None:
    """Fail now rather than after a long run.

    Raises
    ------
    OutputError
        If Matplotlib is not installed or does not write such a file.
    """
    try:
        from matplotlib.backend_bases import FigureCanvasBase  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise OutputError("a plot needs Matplotlib: pip install matplotlib, or '.[plots]' in the clone") from error
    kinds = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.lower().removeprefix(".") not in kinds:
        raise OutputError(f"{path} cannot be plotted to: give a name that ends with one of .{' .'.join(sorted(kinds))}")


def save_figure(path: Path, title: str, tracks: Sequence[Track], truth: Sequence[Box | None]) -> None:
    """Plot the tracks over time.

    Parameters
    ----------
    path : .png, or another suffix Matplotlib writes.
    truth : true boxes from the first frame on; empty: not known, and no error is plotted.

    Raises
    ------
    OutputError
        If the file cannot be written. What `check_plottable` refuses is not to be given.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra; without --plot nobody needs it

    panels = 4 if truth else 2
    figure = Figure(figsize=(10, 2.3 * panels + 0.6), layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True)
    for track, color in zip(tracks, COLORS, strict=False):
        frame = np.arange(1, len(track.threats) + 1)  # as the video counts
        threat = np.asarray(track.threats)
        axes[0].plot(frame, threat, color=color, lw=1.2, label=track.name)
        axes[1].plot(frame[1:], np.abs(np.diff(threat)), color=color, lw=1.0, label=track.name)
        if truth:
            known = truth[: len(track.boxes)]
            boxes = track.boxes[: len(known)]
            axes[2].plot(frame[: len(known)], center_errors_px(boxes, known), color=color, lw=1.2, label=track.name)
            axes[3].plot(frame[: len(known)], overlaps(boxes, known), color=color, lw=1.2, label=track.name)
    axes[0].set(ylabel="mutation threat\nfactor", ylim=(0, None))
    axes[1].set(ylabel="change from\nframe to frame", ylim=(0, None))
    if truth:
        errors = [center_errors_px(t.boxes[: len(truth)], truth[: len(t.boxes)]) for t in tracks]
        highest = max(PRECISION_PX, float(np.nan_to_num(np.concatenate(errors)).max(initial=0)))
        axes[2].set(ylabel="centre error\n(px)", yscale="symlog", ylim=(0, 1.2 * highest))
        axes[2].axhline(PRECISION_PX, color="0.6", lw=0.8, ls="--")
        ticks_px = [tick for tick in ERROR_TICKS_PX if tick <= highest]
        axes[2].set_yticks(ticks_px, [f"{tick}" for tick in ticks_px])
        axes[2].minorticks_off()
        axes[3].set(ylabel="overlap (IoU)", ylim=(0, 1))
    axes[-1].set(xlabel="frame")
    figure.suptitle(title, x=0.01, ha="left")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper right", ncols=len(tracks), frameon=False)
    for panel in axes:
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise OutputError(f"{path} cannot be written: {error}") from error
