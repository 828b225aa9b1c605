"""`mscf bench`: milliseconds by stage with each of our kernels, beside OpenCV's trackers in the same run."""

import cProfile
import gc
import io
import json
import platform
import pstats
import time
import tracemalloc
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
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
from mscf.evaluation.peers import CSRT, CSRT_MISSING, NO_MODELS, Models, has_csrt, tracker_factory
from mscf.geometry import Box
from mscf.kernels import KernelsName
from mscf.kernels.choice import chosen_kernels, kernels_named, native_fault
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
WARM_UP = 10  # updates that are not measured: tables are made, memory is taken
PROFILE_LINES = 20
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

    stage_ms: dict[KernelsName, dict[str, float]]  # mean of an update, by kernels and stage
    update_ms: dict[str, dict[str, list[float]]]  # by source, then by tracker: `mscf native`, `csrt`
    allocated_kb: dict[KernelsName, float]  # most that an update takes on top of what it gives back
    flatness_ms: dict[str, float]  # mean of an update, by case, with the first kernels of `stage_ms`
    profile: str  # functions of these kernels by their own time; empty: not asked for

    def medians(self) -> dict[str, float]:
        """By tracker, over the frames of all sources."""
        return {name: median(times) for name, times in self.of_all().items()}

    def of_all(self) -> dict[str, list[float]]:
        """Times by tracker, of all sources."""
        times: dict[str, list[float]] = {}
        for of_source in self.update_ms.values():
            for name, ms in of_source.items():
                times.setdefault(name, []).extend(ms)
        return times


@dataclass(frozen=True, slots=True)
class BenchOptions:
    """What is to be measured."""

    preset: str = "mscf"
    max_frames: int = 150  # of each source
    models: Models = field(default=NO_MODELS)  # with those of nano it is measured, too
    is_profiled: bool = False
    json: Path | None = None


def run_bench(sources: Sequence[Source], options: BenchOptions, out: TextIO) -> BenchResult:
    """Measure and print.

    The frames of a source are decoded beforehand. All trackers take turns frame by frame, so that they see the same
    noise of the machine; further ones of ours carry the stage clocks.

    Raises
    ------
    SourceError
        If a source has fewer than three frames or no first box.
    """
    cv2.setNumThreads(1)
    if options.json is not None:
        check_writable(options.json)
    config = TrackerConfig.preset(options.preset)
    fault, chosen = native_fault(), chosen_kernels().name
    known: tuple[KernelsName, ...] = ("numpy",) if fault else ("native", "numpy")
    names = sorted(known, key=lambda name: name != chosen)  # the chosen ones first
    clocks = {name: StageClock() for name in names}
    update_ms: dict[str, dict[str, list[float]]] = {}
    updates = 0
    for source in sources:
        frames, box = _frames(source, options.max_frames)
        update_ms[source.name] = _interleaved(frames, box, config, options, clocks)
        updates += len(frames) - 1
    frames, box = _frames(sources[0], options.max_frames)
    result = BenchResult(
        stage_ms={name: {stage: ms / updates for stage, ms in clock.ms.items()} for name, clock in clocks.items()},
        update_ms=update_ms,
        allocated_kb={name: _allocated_kb(frames, box, config, name) for name in names},
        flatness_ms=_flatness(config, names[0]),
        profile=_profile(frames, box, config, names[0]) if options.is_profiled else "",
    )
    _print(result, options, out)
    if options.json is not None:
        options.json.write_text(json.dumps(_as_json(result, options), indent=2) + "\n")
    return result


def _frames(source: Source, most: int) -> tuple[list[Image], Box]:
    frames = list(islice(source, most))
    box = source.truth[0] if source.truth else None
    if len(frames) < 3 or box is None:
        raise SourceError(f"{source.name}: a measurement needs at least three frames and a groundtruth.txt")
    return frames, box


def _interleaved(
    frames: Sequence[Image],
    box: Box,
    config: TrackerConfig,
    options: BenchOptions,
    clocks: dict[KernelsName, StageClock],
) -> dict[str, list[float]]:
    """Milliseconds of each update by tracker; the clocks go on."""
    trackers: dict[str, Any] = {f"{options.preset} {name}": Tracker(config, kernels_named(name)) for name in clocks}
    if has_csrt():
        trackers[CSRT] = tracker_factory(CSRT)()
    if options.models.nano_backbone is not None:
        trackers["nano"] = tracker_factory("nano", options.models)()
    clocked = {name: Tracker(config, kernels_named(name)) for name in clocks}
    for tracker in (*trackers.values(), *clocked.values()):
        tracker.init(frames[0], box)
    times: dict[str, list[float]] = {name: [] for name in trackers}
    for frame in frames[1:]:
        for name, tracker in trackers.items():
            times[name].append(_time_ms(partial(tracker.update, frame)))
        for kernels, clock in clocks.items():
            clock.start()
            clocked[kernels].update(frame, probe=clock)
            clock.stop()
    return times


def _time_ms(action: Callable[[], Any]) -> float:
    begin_s = time.perf_counter()
    action()
    return (time.perf_counter() - begin_s) * 1e3


def _allocated_kb(frames: Sequence[Image], box: Box, config: TrackerConfig, kernels: KernelsName) -> float:
    """Median over the updates of how much more memory is held at one time in an update than before it."""
    tracker = Tracker(config, kernels_named(kernels))
    tracker.init(frames[0], box)
    peaks = []
    tracemalloc.start()
    try:
        for frame in frames[1:]:
            gc.collect(0)
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            tracker.update(frame)
            peaks.append((tracemalloc.get_traced_memory()[1] - before) / 1024)
    finally:
        tracemalloc.stop()
    return median(peaks[WARM_UP:] or peaks)


def _profile(frames: Sequence[Image], box: Box, config: TrackerConfig, kernels: KernelsName) -> str:
    """Functions by their own time over the updates."""
    tracker = Tracker(config, kernels_named(kernels))
    tracker.init(frames[0], box)
    profile = cProfile.Profile()
    for frame in frames[1:]:
        profile.runcall(tracker.update, frame)
    text = io.StringIO()
    pstats.Stats(profile, stream=text).strip_dirs().sort_stats("tottime").print_stats(PROFILE_LINES)
    return text.getvalue().strip()


def _flatness(config: TrackerConfig, kernels: KernelsName) -> dict[str, float]:
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
        tracker = Tracker(config, kernels_named(kernels))
        tracker.init(still, Box((cols - side) / 2, (rows - side) / 2, side, side))
        cases.append((name, frames, tracker))
    times: dict[str, list[float]] = {name: [] for name, _, _ in cases}
    for index in range(1, FLATNESS_UPDATES + 1):
        for name, frames, tracker in cases:
            times[name].append(_time_ms(partial(tracker.update, frames[index % 2])))
    return {name: fmean(ms[2:]) for name, ms in times.items()}


def _print(result: BenchResult, options: BenchOptions, out: TextIO) -> None:
    def say(text: str = "") -> None:
        print(text, file=out)

    frames = sum(len(next(iter(times.values()))) + 1 for times in result.update_ms.values())
    say(f"{', '.join(result.update_ms)}: {frames} frames, preset {options.preset}; one thread")
    say(f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}, {platform.machine()}")
    first, *_ = result.stage_ms
    totals = {name: sum(stages.values()) for name, stages in result.stage_ms.items()}
    columns = sorted(result.stage_ms, reverse=True)  # numpy, native
    heads = "".join(f"{name + ' ms':>12}" for name in columns)
    say(f"\n{'stage':28}{heads}{'share of ' + first:>17}")
    for stage, ms in result.stage_ms[first].items():
        row = "".join(f"{result.stage_ms[name].get(stage, 0.0):12.3f}" for name in columns)
        say(f"{stage:28}{row}{ms / totals[first]:17.0%}")
    say(f"{'sum':28}{''.join(f'{totals[name]:12.3f}' for name in columns)}")
    if native_fault():
        say(native_fault())

    say(f"\n{'an update, ms':28}{'mean':>8}{'median':>8}{'p99':>8}")
    for tracker, times in result.of_all().items():
        p99 = float(np.percentile(times, 99))
        say(f"{tracker:28}{fmean(times):8.2f}{median(times):8.2f}{p99:8.2f}")
    medians = result.medians()
    ours = medians[f"{options.preset} {first}"]
    for tracker, ms in list(medians.items())[1:]:
        say(f"{tracker} takes {ms / ours:.2f} times as long (median), interleaved frame by frame")
    if not has_csrt():
        say(CSRT_MISSING)
    if len(result.update_ms) > 1:
        say(f"\n{'median ms':28}{''.join(f'{tracker:>14}' for tracker in medians)}")
        for source, of_source in result.update_ms.items():
            say(f"{source:28}{''.join(f'{median(times):14.2f}' for times in of_source.values())}")

    say(
        f"\n{'memory of an update, KB':28}{'':8}" + "   ".join(f"{n} {kb:.0f}" for n, kb in result.allocated_kb.items())
    )
    base = next(iter(result.flatness_ms.values()))
    say(f"\n{'frame and target':28}{'ms':>8}{'ratio':>8}")
    for name, ms in result.flatness_ms.items():
        say(f"{name:28}{ms:8.2f}{ms / base:8.2f}")
    if result.profile:
        say(f"\n{first}: {result.profile}")


def _as_json(result: BenchResult, options: BenchOptions) -> dict[str, Any]:
    def figures(times: Sequence[float]) -> dict[str, float]:
        return {"mean": fmean(times), "median": median(times), "p99": float(np.percentile(times, 99))}

    return {
        "preset": options.preset,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
        "stage_ms": result.stage_ms,
        "update_ms": {name: figures(times) for name, times in result.of_all().items()},
        "sources": {
            source: {name: figures(times) for name, times in of_source.items()}
            for source, of_source in result.update_ms.items()
        },
        "allocated_kb": result.allocated_kb,
        "flatness_ms": result.flatness_ms,
    }
