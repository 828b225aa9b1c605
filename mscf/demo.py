"""`mscf demo`: track a target through a source of frames, and show it."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any, Literal, Self, TextIO

import numpy.typing as npt
from tqdm import tqdm

from mscf.arrays import Image, Real
from mscf.config import TrackerConfig
from mscf.errors import FrameError, OutputError, SourceError
from mscf.evaluation.metrics import errors_of, score
from mscf.figure import Track, check_plottable, save_figure
from mscf.geometry import Box
from mscf.mutation import threat_of_peaks
from mscf.overlay import Shown, draw
from mscf.recording import BoxFile, VideoFile, check_writable
from mscf.source import Source
from mscf.tracker import Tracker

ProgressStyle = Literal["bar", "lines", "none"]  # a bar is for a terminal

RATE_FRAMES = 30  # the frame rate shown is over this many updates
LINE_EVERY_S = 5.0  # without a terminal, a line of progress this often


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What `mscf demo` was asked for."""

    presets: tuple[str, ...]  # the first is the one whose boxes are written
    box: Box | None = None  # None: the source's true box
    save: Path | None = None
    boxes: Path | None = None
    plot: Path | None = None
    max_frames: int | None = None
    progress: ProgressStyle = "lines"


@dataclass(slots=True)
class _Contestant:
    """A tracker on its way through the frames."""

    name: str
    tracker: Tracker
    boxes: list[Box] = field(default_factory=list)
    threats: list[float] = field(default_factory=list)  # by the paper's rule, so that presets can be compared
    update_ms: list[float] = field(default_factory=list)
    response: Real | None = None  # of the last update

    def start(self, frame: Image, box: Box) -> None:
        self.tracker.init(frame, box)
        self.boxes.append(box)
        self.threats.append(math.nan)

    def follow(self, frame: Image) -> None:
        begin_s = time.perf_counter()
        result = self.tracker.update(frame, probe=self._keep_response)
        self.update_ms.append((time.perf_counter() - begin_s) * 1e3)
        assert self.response is not None  # every update shows it
        cfg = self.tracker.config
        threat = threat_of_peaks(self.response, nu=cfg.threat_nu, delta=cfg.threat_delta)
        self.boxes.append(result.box)
        self.threats.append(threat)

    def _keep_response(self, name: str, array: npt.NDArray[Any], /) -> None:
        if name == "response":
            self.response = array

    @property
    def updates_per_s(self) -> float:
        return 1e3 / median(self.update_ms[-RATE_FRAMES:]) if self.update_ms else 0.0


def run_demo(source: Source, options: DemoOptions, out: TextIO, log: TextIO) -> bool:
    """Track through `source` and write what was asked for.

    Whatever ends the run - the last frame, Ctrl-C, a broken frame - the files hold all frames tracked so far.

    Parameters
    ----------
    out : is told the results at the end.
    log : is told the progress.

    Returns
    -------
    Whether it ran to its end, rather than being interrupted by Ctrl-C.

    Raises
    ------
    MscfError
        As the source, the tracker and the files raise it; also if there is no box to start from.
    """
    box = options.box or _first_truth(source)
    contestants = [_Contestant(name, Tracker(TrackerConfig.preset(name))) for name in options.presets]
    _check_outputs(source, options)
    is_complete = True
    try:
        with ExitStack() as files:
            boxes_out = files.enter_context(BoxFile(options.boxes)) if options.boxes else None
            video = files.enter_context(VideoFile(options.save, source.frames_per_s)) if options.save else None
            progress = files.enter_context(_Progress(source, options, log))
            frames = iter(source)
            try:
                _track(frames, box, contestants, source, options, boxes_out, video, progress)
            except KeyboardInterrupt:
                is_complete = False
    finally:
        if contestants[0].boxes:
            _report(source, options, contestants, out)
            if options.plot is not None:
                _plot(options.plot, source, contestants, out)
    return is_complete


def _check_outputs(source: Source, options: DemoOptions) -> None:
    """Refuse now what would fail, or do harm, after a long run."""
    outputs = [path for path in (options.save, options.boxes, options.plot) if path is not None]
    read = {path.resolve() for path in source.files}
    for path in outputs:
        if path.resolve() in read:
            raise OutputError(f"{path} is read by this run: give another place to write to")
        if sum(path.resolve() == other.resolve() for other in outputs) > 1:
            raise OutputError(f"{path} is given for two outputs: give each a place of its own")
        check_writable(path)
    if options.plot is not None:
        check_plottable(options.plot)


def _track(
    frames: Iterator[Image],
    box: Box,
    contestants: Sequence[_Contestant],
    source: Source,
    options: DemoOptions,
    boxes_out: BoxFile | None,
    video: VideoFile | None,
    progress: "_Progress",
) -> None:
    leader = contestants[0]
    for index, frame in enumerate(islice(frames, options.max_frames)):
        try:
            for contestant in contestants:
                if index == 0:
                    contestant.start(frame, box)
                else:
                    contestant.follow(frame)
        except FrameError as error:
            raise SourceError(f"{source.name}, frame {index + 1}: {error}") from error
        if boxes_out is not None:
            boxes_out.write(leader.boxes[-1])
        if video is not None:
            video.write(_picture(frame, index, contestants, source))
        progress.advance(leader.updates_per_s)
    if not leader.boxes:
        raise SourceError(f"{source.name} holds no frame")


def _picture(frame: Image, index: int, contestants: Sequence[_Contestant], source: Source) -> Image:
    leader = contestants[0]
    rate = leader.updates_per_s
    caption = f"{source.name}  frame {index + 1}" + (f"  {rate:.0f} frames/s" if rate else "")
    return draw(
        frame,
        [Shown(c.name, c.boxes[-1], c.threats) for c in contestants],
        response=leader.response,
        truth=source.truth[index] if index < len(source.truth) else None,
        caption=caption,
    )


def _first_truth(source: Source) -> Box:
    if source.truth and source.truth[0] is not None:
        return source.truth[0]
    text = f"{source.name} has no groundtruth.txt with a box in its first line"
    raise SourceError(f"{text}: say where the target is in the first frame with --box X,Y,W,H (pixels, from 0,0)")


def _report(source: Source, options: DemoOptions, contestants: Sequence[_Contestant], out: TextIO) -> None:
    for contestant in contestants:
        truth = source.truth[: len(contestant.boxes)]
        text = f"{contestant.name}: {len(contestant.boxes)} frames"
        if contestant.update_ms:
            kernels = contestant.tracker.kernels.name
            text += f", {median(contestant.update_ms):.1f} ms an update (median, {kernels} kernels)"
        if any(true is not None for true in truth):
            found = score(errors_of(contestant.boxes[: len(truth)], truth))
            text += f", precision at 20 px {found.precision:.3f}, AUC {found.auc:.3f}"
        print(text, file=out)
    for path in (options.save, options.boxes):
        if path is not None:
            print(f"wrote {path}", file=out)


def _plot(path: Path, source: Source, contestants: Sequence[_Contestant], out: TextIO) -> None:
    # Ctrl-C may have come between two trackers of one frame
    count = min(len(contestant.threats) for contestant in contestants)
    if count:
        tracks = [Track(c.name, c.boxes[:count], c.threats[:count]) for c in contestants]
        save_figure(path, f"{source.name}, {count} frames", tracks, source.truth)
        print(f"wrote {path}", file=out)


class _Progress:
    """A bar on a terminal, plain lines elsewhere."""

    def __init__(self, source: Source, options: DemoOptions, log: TextIO) -> None:
        limits = [limit for limit in (source.frame_count, options.max_frames) if limit is not None]
        self._total = min(limits) if limits else None
        self._log = log
        self._done = 0
        self._next_line_s = time.monotonic() + LINE_EVERY_S
        is_bar = options.progress == "bar"
        self._bar = tqdm(total=self._total, unit=" frames", file=log, leave=False) if is_bar else None
        self._has_lines = options.progress == "lines"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def advance(self, updates_per_s: float) -> None:
        """One more frame is done."""
        self._done += 1
        if self._bar is not None:
            self._bar.set_postfix_str(f"tracker {updates_per_s:.0f} frames/s", refresh=False)
            self._bar.update()
        elif self._has_lines and time.monotonic() >= self._next_line_s:
            self._next_line_s += LINE_EVERY_S
            of_total = f" of {self._total}" if self._total is not None else ""
            print(f"frame {self._done}{of_total}, tracker {updates_per_s:.0f} frames/s", file=self._log, flush=True)
