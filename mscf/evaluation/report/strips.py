"""Frames side by side with every tracker's box and the true one: what the figures look like."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mscf.arrays import Image
from mscf.errors import ConfigError
from mscf.evaluation import datasets
from mscf.evaluation.record import Record, Run
from mscf.evaluation.report.palette import Stroke
from mscf.evaluation.report.summary import Summary
from mscf.geometry import Box

STRIPS = 4  # how many sequences are shown where none is chosen
FRAMES = 5  # of each
PANEL_PX = 420  # width of a frame in the strip
GAP_PX = 6
LEAST_VIEW = 0.25  # part of the frame's width that is shown at least
AROUND = 1.35  # side of what is shown over that of what is in it
AROUND_TARGET = 5.0  # the same, of the target: a box alone tells nothing
LINE_PX = 2
TRUTH_BGR = (255, 255, 255)
INK_BGR = (38, 33, 29)
PAPER_BGR = (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_LEGEND_LINE_PX = 30


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Picture of a sequence."""

    sequence: str
    frames: tuple[int, ...]  # indices of the frames in it
    picture: Image  # (H, W, 3) BGR


def most_telling(summary: Summary, names: Sequence[str]) -> tuple[str, ...]:
    """At most `STRIPS` of the sequences `names`: those on which the trackers' AUC differ most, by deviation."""
    spread = {
        name: float(np.std([cell.score.auc for cell in summary.cells[name].values()]))
        for name in names
        if name in summary.counted
    }
    known = [name for name, deviation in spread.items() if not math.isnan(deviation)]
    return tuple(sorted(known, key=lambda name: (-spread[name], name))[:STRIPS])


def spread_frames(count: int) -> tuple[int, ...]:
    """`FRAMES` indices spread evenly over a sequence of `count` frames, without the first, whose box is given."""
    return tuple(sorted({round(part * (count - 1) / FRAMES) for part in range(1, FRAMES + 1)} - {0}))


def check_strips(chosen: Sequence[tuple[str, tuple[int, ...]]], sequences: Sequence[datasets.Sequence]) -> None:
    """Raise ConfigError where a chosen sequence or 0-based frame is not there; the text counts from 1."""
    counts = {sequence.name: len(sequence.images) for sequence in sequences}
    for name, frames in chosen:
        if name not in counts:
            raise ConfigError(f"there is no sequence {name!r} to show: choose from {', '.join(counts)}")
        wrong = [frame + 1 for frame in frames if not 0 <= frame < counts[name]]
        if wrong:
            raise ConfigError(f"{name} has no frame {wrong[0]} to show: give 1..{counts[name]}")


def draw_strips(
    records: Sequence[Record],
    sequences: Sequence[datasets.Sequence],
    summary: Summary,
    chosen: Sequence[tuple[str, tuple[int, ...]]],
) -> tuple[Strip, ...]:
    """Strips of the chosen sequences and 0-based frames, or of `most_telling` ones where none is chosen.

    A sequence that is chosen without frames is shown at `spread_frames`.

    The boxes are those of each record's first run.

    Raises
    ------
    ConfigError
        If a chosen sequence or frame is not there.
    SourceError
        If an image cannot be decoded.
    """
    check_strips(chosen, sequences)
    by_name = {sequence.name: sequence for sequence in sequences}
    runs = {(record.sequence, record.tracker): record.runs[0] for record in records if record.runs}
    if not chosen:
        long = [name for name, sequence in by_name.items() if len(sequence.images) > 1]
        chosen = [(name, spread_frames(len(by_name[name].images))) for name in most_telling(summary, long)]
    strips = []
    for name, numbers in chosen:
        sequence = by_name[name]
        frames = numbers or spread_frames(len(sequence.images))
        tracks = {tracker: runs[name, tracker] for tracker in summary.trackers if (name, tracker) in runs}
        strips.append(Strip(name, tuple(frames), _picture(sequence, frames, tracks, summary.trackers)))
    return tuple(strips)


def view_of(boxes: Sequence[Box], target: Box | None, frame_hw: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a frame that a panel shows: of the frame's shape, with all of the boxes that is inside it.

    Parameters
    ----------
    boxes : all that are drawn; without one it is the whole frame.
    target : the true box among them; None where it is absent.
    """
    rows, cols = frame_hw
    if not boxes:
        return slice(0, rows), slice(0, cols)
    # of a box that has left the frame, the edge it left by
    x = np.clip([edge for box in boxes for edge in (box.x, box.x + box.w)], 0, cols)
    y = np.clip([edge for box in boxes for edge in (box.y, box.y + box.h)], 0, rows)
    parts = [LEAST_VIEW, AROUND * np.ptp(x) / cols, AROUND * np.ptp(y) / rows]
    if target is not None:
        parts.append(AROUND_TARGET * math.sqrt(target.w * target.h / (rows * cols)))
    part = min(1.0, float(max(parts)))
    h, w = math.ceil(part * rows), math.ceil(part * cols)
    top = round(float(np.clip((y.min() + y.max() - h) / 2, 0, rows - h)))
    left = round(float(np.clip((x.min() + x.max() - w) / 2, 0, cols - w)))
    return slice(top, top + h), slice(left, left + w)


def _picture(
    sequence: datasets.Sequence, frames: Sequence[int], tracks: Mapping[str, Run], trackers: Sequence[str]
) -> Image:
    strokes = {name: Stroke.of(index) for index, name in enumerate(trackers)}
    panels = []
    for index in frames:
        boxes = {
            name: run.boxes[index - run.first]
            for name, run in tracks.items()
            if run.first <= index < run.first + len(run.boxes)
        }
        drawn = [(box, strokes[name].bgr) for name, box in boxes.items() if box.is_finite]
        panels.append(_panel(sequence.read(index), drawn, sequence.truth[index], index))
    height = panels[0].shape[0]
    gap = np.full((height, GAP_PX, 3), PAPER_BGR, np.uint8)
    pieces = [piece for panel in panels for piece in (_fit(panel, height), gap)][:-1]
    row = np.concatenate(pieces, axis=1)
    entries = [(name, strokes[name].bgr) for name in tracks] + [("true box", TRUTH_BGR)]
    return np.concatenate([row, _legend(sequence.name, entries, row.shape[1])])


def _fit(panel: Image, height: int) -> Image:
    """A panel as high as the first one, should a sequence have frames of several shapes."""
    if panel.shape[0] == height:
        return panel
    return np.asarray(cv2.resize(panel, (PANEL_PX, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _panel(frame: Image, boxes: Sequence[tuple[Box, tuple[int, int, int]]], truth: Box | None, index: int) -> Image:
    rows, cols = frame.shape[:2]
    known = [box for box, _ in boxes] + ([] if truth is None else [truth])
    view = view_of(known, truth, (rows, cols))
    part = frame[view]
    height = max(1, round(PANEL_PX * rows / cols))
    how = cv2.INTER_AREA if part.shape[1] > PANEL_PX else cv2.INTER_CUBIC
    panel = np.array(cv2.resize(part, (PANEL_PX, height), interpolation=how), dtype=np.uint8)
    if truth is not None:  # below the others, which it frames where they are right
        for bgr, width_px in ((INK_BGR, LINE_PX + 4), (TRUTH_BGR, LINE_PX + 2)):
            _rectangle(panel, truth, view, bgr, width_px)
    for box, bgr in reversed(boxes):  # the first tracker on top
        _rectangle(panel, box, view, bgr, LINE_PX)
    _text(panel, f"#{index + 1}", (8, 24), 0.7, (60, 240, 255), outlined=True)  # counted from 1, as data sets do
    return panel


def _rectangle(panel: Image, box: Box, view: tuple[slice, slice], bgr: tuple[int, int, int], width_px: int) -> None:
    """Outline of a box of the frame in the panel that shows `view` of it."""
    rows, cols = view
    zoom_y, zoom_x = panel.shape[0] / (rows.stop - rows.start), panel.shape[1] / (cols.stop - cols.start)
    # edges of pixel areas; OpenCV counts from the middle of the first pixel
    x = zoom_x * (np.array([box.x, box.x + box.w]) - cols.start) - 0.5
    y = zoom_y * (np.array([box.y, box.y + box.h]) - rows.start) - 0.5
    limit = 4 * PANEL_PX  # a box far outside would overflow OpenCV's fixed-point coordinates
    (x0, x1), (y0, y1) = np.clip([x, y], -limit, limit).round().astype(int).tolist()
    cv2.rectangle(panel, (x0, y0), (x1, y1), bgr, width_px, cv2.LINE_AA)


def _legend(title: str, entries: Sequence[tuple[str, tuple[int, int, int]]], width_px: int) -> Image:
    """Name of the sequence and a swatch for each box, on as many lines as it takes."""
    placed: list[tuple[int, int, str, tuple[int, int, int]]] = []
    x, line = _width_px(title) + 36, 0
    for name, bgr in entries:
        wide = _width_px(name) + 64
        if x + wide > width_px and x > 0:
            x, line = 8, line + 1
        placed.append((x, line, name, bgr))
        x += wide
    legend = np.full(((line + 1) * _LEGEND_LINE_PX + 4, width_px, 3), PAPER_BGR, np.uint8)
    _text(legend, title, (8, 22), 0.6, INK_BGR, width_px=2)
    for left, row, name, bgr in placed:
        base = row * _LEGEND_LINE_PX + 22
        cv2.rectangle(legend, (left, base - 12), (left + 26, base), INK_BGR, cv2.FILLED)
        cv2.rectangle(legend, (left + 1, base - 11), (left + 25, base - 1), bgr, cv2.FILLED)
        _text(legend, name, (left + 34, base), 0.6, INK_BGR)
    return legend


def _width_px(text: str) -> int:
    return int(cv2.getTextSize(text, _FONT, 0.6, 2)[0][0])


def _text(
    picture: Image,
    text: str,
    origin_xy: tuple[int, int],
    scale: float,
    bgr: tuple[int, int, int],
    *,
    width_px: int = 1,
    outlined: bool = False,
) -> None:
    if outlined:
        cv2.putText(picture, text, origin_xy, _FONT, scale, (0, 0, 0), 4, cv2.LINE_AA)
        width_px = 2
    cv2.putText(picture, text, origin_xy, _FONT, scale, bgr, width_px, cv2.LINE_AA)
