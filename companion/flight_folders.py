"""The folders of all flights: where they are, a new one, and which have to go."""

import errno
import itertools
import json
import logging
import os
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from companion.config import RecordConfig
from companion.errors import UsageError
from companion.flight_record import ABOUT, KIND, read_about

logger = logging.getLogger(__name__)
FOLDER = "mscf-companion/flights"  # below the user's own state folder
_MB = 1e6
_MAX_NAMED = 3
_SET_CLOCK_S = datetime(2025, 1, 1, tzinfo=UTC).timestamp()  # a clock that says less was never set


class NoRoomError(OSError):
    """No more may be written; the text names the value and the mend.

    Parameters
    ----------
    brief : the same in few words, for a status text.
    """

    def __init__(self, number: int, text: str, brief: str) -> None:
        super().__init__(number, text)
        self.brief = brief


def flights_folder(config: RecordConfig, environ: Mapping[str, str]) -> Path:
    """Where all flights are recorded: as configured, else as systemd or the user's session says."""
    if config.folder:
        return Path(config.folder)
    if environ.get("STATE_DIRECTORY"):  # systemd's; the first of several
        return Path(environ["STATE_DIRECTORY"].split(":")[0], "flights")
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME", "/tmp"), ".local", "state")  # noqa: S108 - no home
    return Path(home, FOLDER)


def new_folder(flights: Path, start: datetime) -> Path:
    """Make the folder of a flight, named by its start and a number that is above all others there.

    The number, not the time, says which flight was later: many a companion computer has no clock of its own.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    first = 1 + max((_number(path) for path in _records(flights)), default=0)
    for number in itertools.count(first):  # another process may be about to make the same
        folder = flights / f"{start:%Y%m%dT%H%M%SZ}-{number:04d}"
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise AssertionError(first)  # numbers do not end


def _records(flights: Path) -> list[Path]:
    """Folders of flights, the oldest first; what else lies there is not ours."""
    with os.scandir(flights) as entries:
        folders = [Path(entry.path) for entry in entries if entry.is_dir(follow_symlinks=False)]
    return sorted(filter(_is_record, folders), key=lambda path: (_number(path), path.name))


def _is_record(folder: Path) -> bool:
    try:
        about = json.loads((folder / ABOUT).read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(about, dict) and about.get("record") == KIND


def _number(folder: Path) -> int:
    last = folder.name.rpartition("-")[2]
    return int(last) if last.isascii() and last.isdigit() else 0


def remove_old(flights: Path, running: Path | None, config: RecordConfig, now_s: float) -> float:
    """Remove records that are too old, then the oldest ones that do not fit; never the running one.

    Parameters
    ----------
    now_s : since 1970 UTC.

    Returns
    -------
    Bytes of all that remain.
    """
    sizes: dict[Path, float] = {}
    for folder in _records(flights):
        size, written_s = _measured(folder)
        # of an age that rests on a clock that was not set then, nothing follows
        is_old = written_s > _SET_CLOCK_S and now_s - written_s > config.max_age_days * 86400
        if is_old and folder != running and _is_removed(folder):
            continue
        sizes[folder] = size
    for folder in list(sizes):
        if sum(sizes.values()) <= config.max_total_mb * _MB:
            break
        if folder != running and _is_removed(folder):
            del sizes[folder]
    return sum(sizes.values())


def make_room(flights: Path, running: Path | None, config: RecordConfig, now_s: float) -> None:
    """Remove what has to go, as `remove_old`, and see that there is room then.

    Raises
    ------
    NoRoomError
        If there is none.
    OSError
        If the folder cannot be read.
    """
    check_size(flights, remove_old(flights, running, config, now_s), config)  # of the running one alone, if too much
    check_free(flights, config)


def check_size(folder: Path, size_bytes: float, config: RecordConfig) -> None:
    """See that what a folder holds is no more than all flights may.

    Raises
    ------
    NoRoomError
        If it is.
    """
    if size_bytes > config.max_total_mb * _MB:
        most = f"record.max_total_mb = {config.max_total_mb:g}"
        text = f"{folder} holds {size_bytes / _MB:.0f} MB, {most}: fly shorter, or set it higher"
        raise NoRoomError(errno.EFBIG, text, "record.max_total_mb reached")


def check_free(flights: Path, config: RecordConfig) -> None:
    """See that the disk has what is to stay free.

    Raises
    ------
    NoRoomError
        If it has not.
    OSError
        If it cannot be asked.
    """
    free_mb = shutil.disk_usage(flights).free / _MB
    if free_mb < config.min_free_mb:
        least = f"record.min_free_mb = {config.min_free_mb:g}"
        text = f"{flights} has {free_mb:.0f} MB free, {least}: free some, or set it lower"
        raise NoRoomError(errno.ENOSPC, text, "below record.min_free_mb")


def try_folder(flights: Path, config: RecordConfig) -> float:
    """See that the folder of all flights can be made and written and has room; nothing is left of the trial.

    Returns
    -------
    MB that are free there.

    Raises
    ------
    NoRoomError
        If less is free than is to stay so.
    OSError
        If it cannot be made or written.
    """
    there = next(path for path in (flights, *flights.absolute().parents) if os.path.lexists(path))
    # a folder that this made would belong to whoever tries, and not to the service that is to write into it
    with tempfile.TemporaryDirectory(dir=there) as trial:
        Path(trial, ABOUT).write_bytes(b"{}")
    check_free(there, config)
    return shutil.disk_usage(there).free / _MB


def about_of(folder: Path) -> dict[str, Any]:
    """What a record says of itself; where there is none, those below the folder are named.

    Raises
    ------
    UsageError
        If the folder holds no record.
    """
    try:
        return read_about(folder)
    except UsageError as error:
        below = [path.parent for depth in ("*", "*/*") for path in folder.glob(f"{depth}/{ABOUT}")]
        found = sorted(filter(_is_record, below), key=lambda path: (_number(path), path.name), reverse=True)
        if not found:
            raise
        names = " or ".join(map(str, found[:_MAX_NAMED]))
        more = f", the newest of {len(found)}" if len(found) > _MAX_NAMED else ""
        raise UsageError(f"{error}; give a record below it: {names}{more}") from error


def _measured(folder: Path) -> tuple[float, float]:
    """Bytes, and when the last one was written, since 1970 UTC."""
    size, written_s = 0, 0.0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            status = path.lstat()
            size += status.st_size
            written_s = max(written_s, status.st_mtime)
    return size, written_s


def _is_removed(folder: Path) -> bool:
    """Remove a record; `ABOUT` goes last, so that one half removed is still known as ours."""
    try:
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name != ABOUT:
                path.unlink()
        (folder / ABOUT).unlink()
        folder.rmdir()
    except OSError as error:
        logger.warning("record: %s cannot be removed: %s", folder, error.strerror)
        return False
    logger.info("record: removed %s", folder)
    return True
