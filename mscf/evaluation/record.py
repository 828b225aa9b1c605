"""What is kept of runs, and its files."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from mscf.errors import OutputError
from mscf.evaluation.metrics import Errors
from mscf.geometry import Box
from mscf.whole_file import write_whole

RUNS = "runs"  # folder of what is the same on every machine
TIMES = "times"  # folder of the rest
SUFFIX = ".csv"
SEAL = "# mscf record 1, sha256 of what follows: "
RUNS_HEAD = ("run", "frame", "x", "y", "w", "h", "is_lost", "overlap", "center_px", "center_norm")
TIMES_HEAD = ("run", "frame", "update_ms")


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One tracker's run from one start, for n frames; `update_ms` is of the n - 1 updates."""

    first: int  # index of the frame it starts at
    boxes: tuple[Box, ...]  # of frames first, first + 1, ...; the first one was given
    is_lost: tuple[bool, ...]  # whether the tracker said so, or raised: its last box was kept
    update_ms: tuple[float, ...]  # of the update alone, image decoding excluded
    errors: Errors
    fault: str = ""  # what it raised first


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """All runs of one tracker over one sequence."""

    sequence: str
    tracker: str
    attributes: frozenset[str]  # of the sequence
    runs: tuple[Run, ...]


def write_record(record: Record, folder: Path) -> None:
    """Write FOLDER/times/TRACKER/SEQUENCE.csv, then FOLDER/runs/TRACKER/SEQUENCE.csv, each whole or not at all.

    The file under runs says that the record is done; it is written last, and one that is there goes first, so that it
    never stands beside the times of other runs. It has the same bytes wherever the tracker gave the same boxes.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    runs, times = _paths(folder, record.tracker, record.sequence)
    runs_data, times_data = _runs_data(record), _times_data(record)
    with _naming(runs, "written"):
        runs.unlink(missing_ok=True)
    for path, data in ((times, times_data), (runs, runs_data)):
        write_whole(path, data)


def read_record(folder: Path, tracker: str, sequence: str) -> Record | None:
    """Read what `write_record` wrote there, to the last bit; None if it is not there.

    Raises
    ------
    OutputError
        If a file is not as it was written, or cannot be read.
    """
    runs_path, times_path = _paths(folder, tracker, sequence)
    if not os.path.lexists(runs_path):
        return None
    head, rows = _read_rows(runs_path)
    _, times = _read_rows(times_path)
    about, updates = json.loads(head), (float(ms) for _, _, ms in times)
    frames = sum(part["frames"] for part in about["runs"])
    if len(times) != frames - len(about["runs"]):
        raise OutputError(f"{times_path} is not of the runs in {runs_path}: remove both, and run again")
    lines = iter(rows)
    runs = tuple(
        _run(part["first"], part["fault"], list(islice(lines, part["frames"])), islice(updates, part["frames"] - 1))
        for part in about["runs"]
    )
    return Record(sequence, tracker, frozenset(about["attributes"]), runs)


def read_records(folder: Path) -> tuple[Record, ...]:
    """All records of an evaluation's folder, sorted by tracker and sequence.

    Raises
    ------
    OutputError
        As `read_record`.
    """
    folders = (path for path in (folder / RUNS).glob("*") if path.is_dir())
    trackers = sorted(_name(path.name) for path in folders)
    return tuple(record for tracker in trackers for record in read_tracker(folder, tracker))


def read_tracker(folder: Path, tracker: str) -> tuple[Record, ...]:
    """All records of one tracker, sorted by sequence; none if it has not run.

    Raises
    ------
    OutputError
        As `read_record`.
    """
    files = (folder / RUNS / _file_name(tracker)).glob(f"*{SUFFIX}")
    sequences = sorted(_name(path.name.removesuffix(SUFFIX)) for path in files)
    records = (read_record(folder, tracker, sequence) for sequence in sequences)
    return tuple(record for record in records if record is not None)


def tracker_of(runs: Path) -> str:
    """Name of the tracker whose records are in FOLDER/runs/TRACKER."""
    return _name(runs.name)


def _paths(folder: Path, tracker: str, sequence: str) -> tuple[Path, Path]:
    """Files of the runs and of the times."""
    inside = Path(_file_name(tracker)) / (_file_name(sequence) + SUFFIX)
    return folder / RUNS / inside, folder / TIMES / inside


def _file_name(name: str) -> str:
    """Name as a file's: what is not a letter, digit or one of _.-~+ is written as %XX, and so is a leading dot."""
    quoted = quote(name, safe="+", errors="surrogateescape")
    return "%2E" + quoted[1:] if quoted.startswith(".") else quoted


def _name(file_name: str) -> str:
    """Inverse of `_file_name`."""
    return unquote(file_name, errors="surrogateescape")


def _runs_data(record: Record) -> bytes:
    """Content of the file under runs."""
    parts = [{"first": run.first, "frames": len(run.boxes), "fault": run.fault} for run in record.runs]
    rows = (
        (number, run.first + index, *map(float, (box.x, box.y, box.w, box.h)), int(is_lost), *map(float, errors))
        for number, run in enumerate(record.runs)
        for index, (box, is_lost, *errors) in enumerate(
            zip(
                run.boxes,
                run.is_lost,
                run.errors.overlap,
                run.errors.center_px,
                run.errors.center_norm,
                strict=True,
            )
        )
    )
    return _sealed(json.dumps({"attributes": sorted(record.attributes), "runs": parts}), RUNS_HEAD, rows)


def _times_data(record: Record) -> bytes:
    """Content of the file under times."""
    rows = (
        (number, frame, float(ms))
        for number, run in enumerate(record.runs)
        for frame, ms in zip(
            range(run.first + 1, run.first + len(run.boxes)),
            run.update_ms,
            strict=True,
        )
    )
    return _sealed("{}", TIMES_HEAD, rows)


def _run(first: int, fault: str, rows: list[list[str]], update_ms: Iterable[float]) -> Run:
    """Run from its rows."""
    x, y, w, h, _, overlap, center_px, center_norm = np.array([row[2:] for row in rows], dtype=np.float64).T
    boxes = tuple(map(Box, x.tolist(), y.tolist(), w.tolist(), h.tolist()))
    is_lost = tuple(row[6] == "1" for row in rows)
    return Run(first, boxes, is_lost, tuple(update_ms), Errors(overlap, center_px, center_norm), fault)


def _sealed(about: str, head: tuple[str, ...], rows: Iterable[tuple[float, ...]]) -> bytes:
    """Lines of a file: the seal, what is said of the whole as JSON, the head and the rows."""
    lines = [f"# {about}", ",".join(head), *(",".join(map(repr, row)) for row in rows)]
    body = ("\n".join(lines) + "\n").encode("ascii")
    return f"{SEAL}{hashlib.sha256(body).hexdigest()}\n".encode("ascii") + body


def _read_rows(path: Path) -> tuple[str, list[list[str]]]:
    """JSON of the whole, and cells of the rows.

    Raises
    ------
    OutputError
        If the file is not as it was written, or cannot be read.
    """
    with _naming(path, "read"):
        data = path.read_bytes()
    seal, _, body = data.partition(b"\n")
    if seal != f"{SEAL}{hashlib.sha256(body).hexdigest()}".encode("ascii"):
        raise OutputError(f"{path} is damaged, or has been changed by hand: remove it, and run again")
    about, _head, *lines = body.decode("ascii").splitlines()
    return about.removeprefix("# "), [line.split(",") for line in lines]


@contextmanager
def _naming(path: Path, done: str) -> Iterator[None]:
    """Turn what the system says into one line with the path."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be {done}: {error.strerror or error}") from error
