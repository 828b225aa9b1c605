"""`mscf bench`: milliseconds by stage, beside OpenCV's CSRT on the same frames in the same run."""

import json
import platform
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import fmean, median
from typing import Any, TextIO

import cv2
import numpy as np
import numpy.typing as npt

from mscf.arrays import Image
from mscf.config import TrackerConfig
from mscf.errors import SourceError
from mscf.evaluation.peers import CSRT_MISSING, CsrtTracker, has_csrt
from mscf.geometry import Box
from mscf.recording import check_writable
from mscf.source import Source
from mscf.tracker import Tracker

# which stage ends where the tracker shows an array of this name
STAGE_ENDS = {
    "patch_detect": "sample (detection)",
    "features_detect": "features (detection)",
    "sample_f": "DFT and response",
    "response": "DFT and response",
    "threat_window": "threat",
    "threat_maxima": "threat",
    "threat": "threat",
    "confidence": "confidence",
    "pos_rc": "peak",
    "scale_features_detect": "scale samples (detection)",
    "scale_response": "scale response",
    "patch_train": "sample (training)",
    "features_train": "features (training)",
    "h_stage1": "ADMM",
    "model_f": "DFT and model",
    "ideal_label_f": "label",
    "label_f": "ADMM",
    "filter_f": "ADMM",
    "scale_features_train": "scale samples (training)",
    "scale_numerator_f": "scale training",
    "scale_denominator": "scale training",
}
LAST_STAGE = "result"
FLATNESS_UPDATES = 40
FLATNESS_CASES = (("720p, 40 px", 720, 1280, 40), ("4K, 40 px", 2160, 3840, 40), ("720p, 400 px", 720, 1280, 400))


class StageClock:
    """A probe that charges the time since the last call to the stage that ends there."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = defaultdict(float)  # of all frames together
        self._last_s = 0.0

    def start(self) -> None:
        """A frame begins."""
        self._last_s = time.perf_counter()

    def __call__(self, name: str, array: npt.NDArray[Any], /) -> None:
        self._charge(STAGE_ENDS[name])

    def stop(self) -> None:
        """The frame has ended; what was left is the last stage."""
        self._charge(LAST_STAGE)

    def _charge(self, stage: str) -> None:
        now_s = time.perf_counter()
        self.ms[stage] += (now_s - self._last_s) * 1e3
        self._last_s = now_s


@dataclass(frozen=True, slots=True)
class BenchResult:
    """What was measured; times in ms."""

    frames: int
    stage_ms: dict[str, float]  # mean of an update
    update_ms: tuple[float, ...]
    csrt_ms: tuple[float, ...]  # empty: no CSRT in this cv2
    flatness_ms: dict[str, float]  # mean of an update, by case


def run_bench(source: Source, preset: str, max_frames: int, out: TextIO, json_path: Path | None = None) -> BenchResult:
    """Measure and print.

    The frames are decoded beforehand. Tracker and CSRT take turns frame by frame, so that both see the same
    noise of the machine; a second tracker of ours carries the stage clock.

    Raises
    ------
    SourceError
        If the source has fewer than three frames or no first box.
    """
    cv2.setNumThreads(1)
    frames = list(islice(source, max_frames))
    box = source.truth[0] if source.truth else None
    if len(frames) < 3 or box is None:
        raise SourceError(f"{source.name}: a measurement needs at least three frames and a groundtruth.txt")
    if json_path is not None:
        check_writable(json_path)
    config = TrackerConfig.preset(preset)
    result = _measure(frames, box, config)
    _print(result, source.name, preset, out)
    if json_path is not None:
        json_path.write_text(json.dumps(_as_json(result, source.name, preset), indent=2) + "\n")
    return result


def _measure(frames: Sequence[Image], box: Box, config: TrackerConfig) -> BenchResult:
    tracker, clocked, clock = Tracker(config), Tracker(config), StageClock()
    csrt = CsrtTracker() if has_csrt() else None
    tracker.init(frames[0], box)
    clocked.init(frames[0], box)
    if csrt is not None:
        csrt.init(frames[0], box)
    update_ms, csrt_ms = [], []
    for frame in frames[1:]:
        update_ms.append(_time_ms(lambda: tracker.update(frame)))  # noqa: B023 - called at once
        if csrt is not None:
            csrt_ms.append(_time_ms(lambda: csrt.update(frame)))  # noqa: B023 - called at once
        clock.start()
        clocked.update(frame, probe=clock)
        clock.stop()
    stage_ms = {stage: ms / (len(frames) - 1) for stage, ms in clock.ms.items()}
    return BenchResult(len(frames), stage_ms, tuple(update_ms), tuple(csrt_ms), _flatness(config))


def _time_ms(action: Any) -> float:
    begin_s = time.perf_counter()
    action()
    return (time.perf_counter() - begin_s) * 1e3


def _flatness(config: TrackerConfig) -> dict[str, float]:
    """Mean update by size of frame and target, interleaved, on noise textures.

    The picture jumps to and fro by more than a sample is shifted for, so that every update cuts a second one.
    """
    rng = np.random.default_rng(0)
    cases = []
    for name, rows, cols, side in FLATNESS_CASES:
        coarse = rng.integers(0, 256, (rows // 8, cols // 8, 3), dtype=np.uint8)
        still = np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        jump_px = round(0.1 * side * (config.shift_limit_cells + 2))  # a cell is about a tenth of the target
        frames = still, np.roll(still, jump_px, axis=1)
        tracker = Tracker(config)
        tracker.init(still, Box((cols - side) / 2, (rows - side) / 2, side, side))
        cases.append((name, frames, tracker))
    times: dict[str, list[float]] = {name: [] for name, _, _ in cases}
    for index in range(1, FLATNESS_UPDATES + 1):
        for name, frames, tracker in cases:
            times[name].append(_time_ms(lambda: tracker.update(frames[index % 2])))  # noqa: B023 - called at once
    return {name: fmean(ms[2:]) for name, ms in times.items()}


def _print(result: BenchResult, source: str, preset: str, out: TextIO) -> None:
    print(f"{source}, {result.frames} frames, preset {preset}; one thread", file=out)
    print(
        f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}, {platform.machine()}",
        file=out,
    )
    total = sum(result.stage_ms.values())
    print(f"\n{'stage':28}{'ms':>8}{'share':>8}", file=out)
    for stage, ms in result.stage_ms.items():
        print(f"{stage:28}{ms:8.3f}{ms / total:8.0%}", file=out)
    print(f"{'sum':28}{total:8.3f}", file=out)
    print(f"\n{'an update':28}{'mean':>8}{'median':>8}{'p99':>8}", file=out)
    for name, times in ((preset, result.update_ms), ("csrt", result.csrt_ms)):
        if times:
            p99 = float(np.percentile(times, 99))
            print(f"{name:28}{fmean(times):8.2f}{median(times):8.2f}{p99:8.2f}", file=out)
    if result.csrt_ms:
        mean_ratio = fmean(result.csrt_ms) / fmean(result.update_ms)
        print(f"CSRT takes {mean_ratio:.2f} times as long (mean), interleaved frame by frame", file=out)
    else:
        print(CSRT_MISSING, file=out)
    base = next(iter(result.flatness_ms.values()))
    print(f"\n{'frame and target':28}{'ms':>8}{'ratio':>8}", file=out)
    for name, ms in result.flatness_ms.items():
        print(f"{name:28}{ms:8.2f}{ms / base:8.2f}", file=out)


def _as_json(result: BenchResult, source: str, preset: str) -> dict[str, Any]:
    return {
        "source": source,
        "preset": preset,
        "frames": result.frames,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
        "stage_ms": result.stage_ms,
        "update_ms": {"mean": fmean(result.update_ms), "median": median(result.update_ms)},
        "csrt_ms": {"mean": fmean(result.csrt_ms), "median": median(result.csrt_ms)} if result.csrt_ms else None,
        "flatness_ms": result.flatness_ms,
    }
