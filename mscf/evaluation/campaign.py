"""Running all trackers over all sequences: processes, progress, and going on after an interruption.

A process runs one sequence and ends: what a tracker leaves behind in it, or a crash, is that sequence's alone. Each
frame is decoded once, and all trackers from all their starts step on it, so that memory does not grow with the length.
"""

import hashlib
import json
import math
import os
import platform
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Self, TextIO

import cv2
import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from mscf.arrays import Image
from mscf.errors import MscfError, OutputError, SourceError
from mscf.evaluation.datasets import Dataset, Sequence
from mscf.evaluation.metrics import errors_of
from mscf.evaluation.peers import NO_MODELS, BoxTracker, Models, first_line, tracker_factory
from mscf.evaluation.protocol import TRE_STARTS, Start, starts
from mscf.evaluation.record import RUNS, Record, Run, read_record, write_record
from mscf.geometry import Box
from mscf.kernels.choice import chosen_kernels
from mscf.whole_file import write_whole

EVALUATION = "evaluation.json"  # what an evaluation says of itself
# results that differ in one of these do not go into one folder
IDENTITY = ("dataset", "protocol", "starts", "mscf", "numpy", "opencv")
OWN_TABLE = "the package's own"
LINE_EVERY_S = 30.0  # without a terminal, a line of progress this often


@dataclass(frozen=True, slots=True)
class EvaluationOptions:
    """How an evaluation is run."""

    protocol: str = "ope"
    tre_starts: int = TRE_STARTS  # of protocol tre
    jobs: int = 1  # processes at a time
    is_resumed: bool = False  # what the folder holds is not run again
    models: Models = NO_MODELS
    color_table: Path | None = None  # of our presets; None: the package's own


def evaluate(
    dataset: Dataset, names: tuple[str, ...], options: EvaluationOptions, folder: Path, log: TextIO
) -> tuple[Record, ...]:
    """Run every tracker over every sequence, and keep the results in `folder`.

    A sequence with a broken image, or whose process dies, is reported and left out; the rest goes on. Ctrl-C ends at
    once: what is whole stays, and goes on with `is_resumed`.

    Parameters
    ----------
    names : of trackers, as `tracker_factory` knows them.
    folder : is made where it is missing. Besides the records it gets `evaluation.json`: data set, protocol, sequences,
        what was left out and why, versions, machine and command.
    log : is told the progress, as a bar where it is a terminal.

    Returns
    -------
    Records of these trackers and sequences, by tracker, as named, and sequence; without sequences that were left out.

    Raises
    ------
    MscfError
        If a tracker is unknown or missing, or the folder cannot be written, or holds results of something else, or
        holds results and is not resumed.
    """
    names = tuple(dict.fromkeys(names))
    for name in names:
        tracker_factory(name, options.models, options.color_table)  # fails now rather than in every process
    about = _about(dataset, names, options)
    _open_folder(folder, about, is_resumed=options.is_resumed)
    left_out: dict[str, str] = {}
    try:
        jobs = []
        for sequence in dataset.sequences:
            begins = starts(sequence, options.protocol, options.tre_starts)
            if not begins:
                left_out[sequence.name] = f"no true box to start protocol {options.protocol} from"
                print(f"{sequence.name} is left out: {left_out[sequence.name]}", file=log)
            elif todo := tuple(name for name in names if not _is_done(folder, name, sequence, begins)):
                jobs.append(_Job(sequence, begins, todo, options, folder))
        with _Progress(sum(job.frames for job in jobs), log) as progress:
            left_out |= _run_all(jobs, options.jobs, progress)
        _write_about(folder, about | {"left_out": {**_rest_of(about["left_out"], dataset), **left_out}})
    except KeyboardInterrupt:
        print(f"interrupted: what is whole is in {folder}; the same command with --resume goes on", file=log)
        raise
    records = (read_record(folder, n, s.name) for n in names for s in dataset.sequences if s.name not in left_out)
    return tuple(record for record in records if record is not None)


# --- the folder ---


def _about(dataset: Dataset, names: tuple[str, ...], options: EvaluationOptions) -> dict[str, Any]:
    """Content of evaluation.json."""
    files = {name: path for name, path in asdict(options.models).items() if path is not None}
    table = OWN_TABLE if options.color_table is None else _fingerprint(options.color_table)
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "dataset": dataset.name,
        "protocol": options.protocol,
        "starts": options.tre_starts if options.protocol == "tre" else None,
        "trackers": list(names),
        "files": {"color_table": table} | {name: _fingerprint(path) for name, path in files.items()},
        "mscf": version("mscf-companion"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "kernels": chosen_kernels().name,
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "jobs": options.jobs,
        "sequences": [sequence.name for sequence in dataset.sequences],
        "left_out": {},
    }


def _fingerprint(path: Path) -> str:
    try:
        return f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error


def _open_folder(folder: Path, about: dict[str, Any], *, is_resumed: bool) -> None:
    """Refuse a folder with other results; write evaluation.json into it, and its older content into `about`."""
    path = folder / EVALUATION
    if path.exists() or (folder / RUNS).exists():
        if not is_resumed:
            raise OutputError(f"{folder} holds results: go on with them by --resume, or give another folder")
        old = _read_about(path)
        for name in IDENTITY:
            if old.get(name) != about[name]:
                text = f"{folder} holds results with {name} {old.get(name)}, and this is {about[name]}"
                raise OutputError(f"{text}: give another folder")
        old_files = old.get("files", {})
        for name, fingerprint in about["files"].items():
            if old_files.get(name, fingerprint) != fingerprint:
                text = f"{folder} holds results with {name} {old_files[name]}, and this is {fingerprint}"
                raise OutputError(f"{text}: give another folder")
        about["files"] = old_files | about["files"]
        about["left_out"] = old.get("left_out", {})
        for name in ("trackers", "sequences"):
            about[name] = list(dict.fromkeys([*old.get(name, []), *about[name]]))
    _write_about(folder, about)


def read_left_out(folder: Path) -> dict[str, str]:
    """Sequences that an evaluation left out, and why.

    Raises
    ------
    OutputError
        If its evaluation.json cannot be read.
    """
    return dict(_read_about(folder / EVALUATION).get("left_out", {}))


def _read_about(path: Path) -> dict[str, Any]:
    try:
        about = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}, which says what the results are of, cannot be read: {error}") from error
    if not isinstance(about, dict):
        raise OutputError(f"{path} is not of an evaluation: give another folder")
    return about


def _write_about(folder: Path, about: Mapping[str, Any]) -> None:
    write_whole(folder / EVALUATION, (json.dumps(about, indent=2) + "\n").encode())


def _rest_of(left_out: Mapping[str, str], dataset: Dataset) -> dict[str, str]:
    """What was left out before, without sequences that were run again."""
    again = {sequence.name for sequence in dataset.sequences}
    return {name: why for name, why in left_out.items() if name not in again}


def _is_done(folder: Path, name: str, sequence: Sequence, begins: tuple[Start, ...]) -> bool:
    """Whether the folder has the record.

    Raises
    ------
    OutputError
        If it is of other starts, or damaged.
    """
    record = read_record(folder, name, sequence.name)
    if record is None:
        return False
    count = len(sequence.images)
    expected = [(begin.index, begin.box, count - begin.index) for begin in begins]
    if [(run.first, run.boxes[0], len(run.boxes)) for run in record.runs] != expected:
        text = f"{folder} holds results of another {sequence.name}: {name} started from other frames or boxes there"
        raise OutputError(f"{text}; give another folder")
    return True


# --- one sequence, in a process of its own ---


@dataclass(frozen=True, slots=True)
class _Job:
    """What one process is to run."""

    sequence: Sequence
    begins: tuple[Start, ...]
    names: tuple[str, ...]  # of trackers
    options: EvaluationOptions
    folder: Path

    @property
    def frames(self) -> int:
        """Of all runs together."""
        return len(self.names) * sum(len(self.sequence.images) - begin.index for begin in self.begins)


@dataclass(slots=True)
class _Course:
    """A tracker on its way from one start."""

    make: Callable[[], BoxTracker]
    begin: Start
    tracker: BoxTracker | None = None  # None: not begun, or refused to
    boxes: list[Box] = field(default_factory=list)
    is_lost: list[bool] = field(default_factory=list)
    update_ms: list[float] = field(default_factory=list)
    fault: str = ""

    def step(self, frame: Image) -> None:
        """Begin, or follow; a tracker that raises keeps its last box, and no time counts where there is no answer."""
        if not self.boxes:
            self.boxes.append(self.begin.box)
            self.is_lost.append(False)
            with self._noting_fault():
                tracker = self.make()
                tracker.init(frame, self.begin.box)
                self.tracker = tracker
            return
        box, is_found, ms = self.boxes[-1], False, math.nan
        if self.tracker is not None:
            with self._noting_fault():
                begin_s = time.perf_counter()
                result = self.tracker.update(frame)
                ms = (time.perf_counter() - begin_s) * 1e3
                box, is_found = result.box, result.is_found
        self.boxes.append(box)
        self.is_lost.append(not is_found)
        self.update_ms.append(ms)

    @contextmanager
    def _noting_fault(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # noqa: BLE001 - of somebody's tracker: whatever it is, it is counted
            self.fault = self.fault or f"{type(error).__name__}: {first_line(error)}"


def run_sequence(
    sequence: Sequence,
    makes: Mapping[str, Callable[[], BoxTracker]],
    begins: tuple[Start, ...],
    advance: Callable[[int], None],
) -> tuple[Record, ...]:
    """Run trackers over one sequence, all from all starts on the same frames, which they cannot write to.

    Parameters
    ----------
    makes : by the tracker's name.
    begins : at least one, sorted by index.
    advance : is told how many runs have taken each frame.

    Raises
    ------
    SourceError
        If an image cannot be decoded; it names the file.
    """
    courses = {name: [_Course(make, begin) for begin in begins] for name, make in makes.items()}
    for index in range(begins[0].index, len(sequence.images)):
        frame = sequence.read(index)
        frame.setflags(write=False)  # else one tracker could spoil it for the others
        going = [course for each in courses.values() for course in each if course.begin.index <= index]
        for course in going:
            course.step(frame)
        advance(len(going))
    return tuple(
        Record(sequence.name, name, sequence.attributes, tuple(_run(course, sequence) for course in each))
        for name, each in courses.items()
    )


def _run(course: _Course, sequence: Sequence) -> Run:
    return Run(
        course.begin.index,
        tuple(course.boxes),
        tuple(course.is_lost),
        tuple(course.update_ms),
        errors_of(course.boxes, sequence.truth[course.begin.index :]),
        course.fault,
    )


def _work(job: _Job, parent: Connection) -> None:
    """Body of a process: sends the number of frames taken, again and again, or the error that ended it."""
    try:
        makes = {name: tracker_factory(name, job.options.models, job.options.color_table) for name in job.names}
        # after all modules of one's own trackers are loaded, with whatever they bring
        cv2.setNumThreads(1)
        threadpool_limits(1, "blas")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # faults are counted, not printed
        for record in run_sequence(job.sequence, makes, job.begins, parent.send):
            write_record(record, job.folder)
    except BrokenPipeError:
        pass  # whoever asked has died
    except MscfError as error:
        parent.send(error)


# --- all sequences ---


@dataclass(slots=True)
class _Worker:
    """A process and what is heard of it."""

    job: _Job
    process: BaseProcess
    connection: Connection
    rest: int  # frames of runs to come
    error: MscfError | None = None

    @classmethod
    def start(cls, job: _Job) -> Self:
        context = get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(job, sender), name=job.sequence.name, daemon=True)
        # Ctrl-C is for the parent, which ends its processes: they inherit that it does not reach them. Before, as it
        # would let Ctrl-C through again, Python's own process beside them is started.
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        sender.close()  # ours: the end of the process's is the end of the file
        return cls(job, process, receiver, job.frames)

    def end(self) -> None:
        self.process.terminate()
        self.process.join()
        self.connection.close()


def _run_all(jobs: list[_Job], at_once: int, progress: "_Progress") -> dict[str, str]:
    """Run the jobs, the longest first; names of the sequences that failed, and why.

    Raises
    ------
    MscfError
        If it is not of a sequence alone.
    """
    waiting = sorted(jobs, key=lambda job: job.frames)
    workers: dict[Connection, _Worker] = {}
    left_out: dict[str, str] = {}
    try:
        while waiting or workers:
            while waiting and len(workers) < at_once:
                worker = _Worker.start(waiting.pop())
                workers[worker.connection] = worker
            for connection in wait(list(workers)):
                assert isinstance(connection, Connection)
                worker = workers[connection]
                try:
                    message = connection.recv()
                except EOFError:
                    worker.process.join()
                    del workers[connection]
                    connection.close()
                    progress.drop(worker.rest)
                    if why := _failure(worker):
                        left_out[worker.job.sequence.name] = why
                        progress.say(f"{worker.job.sequence.name} is left out: {why}")
                    continue
                if isinstance(message, MscfError):
                    worker.error = message
                else:
                    worker.rest -= message
                    progress.advance(message)
    finally:
        for worker in workers.values():
            worker.end()
    return left_out


def _failure(worker: _Worker) -> str:
    """Why a sequence is left out; empty where it is not."""
    if worker.error is not None:
        if not isinstance(worker.error, SourceError):
            raise worker.error
        return str(worker.error)
    status = worker.process.exitcode
    return f"its process ended with status {status}: a tracker crashed, or memory was short" if status else ""


class _Progress:
    """A bar with the time left on a terminal, a line now and then elsewhere."""

    def __init__(self, total: int, log: TextIO) -> None:
        self._total = total
        self._log = log
        self._done = 0
        self._begin_s = time.monotonic()
        self._next_line_s = self._begin_s + LINE_EVERY_S
        self._bar = tqdm(total=total, unit=" frames", file=log, leave=False) if log.isatty() else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, text: str) -> None:
        """Print a line of its own."""
        if self._bar is not None:
            self._bar.clear()
        print(text, file=self._log, flush=True)

    def advance(self, frames: int) -> None:
        """So many more are done, of all runs together."""
        self._done += frames
        now_s = time.monotonic()
        if self._bar is not None:
            self._bar.update(frames)
        elif now_s >= self._next_line_s:
            self._next_line_s = now_s + LINE_EVERY_S
            left_s = (now_s - self._begin_s) * (self._total - self._done) / self._done
            share = f"{self._done} of {self._total} frames ({self._done / self._total:.0%})"
            print(f"{share}, {tqdm.format_interval(left_s)} left", file=self._log, flush=True)

    def drop(self, frames: int) -> None:
        """So many are not going to be done."""
        self._total -= frames
        if self._bar is not None:
            self._bar.total = self._total
