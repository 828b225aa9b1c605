"""A file that is as it was or as it is to be, whatever happens meanwhile."""

import os
from contextlib import suppress
from pathlib import Path

from mscf.errors import OutputError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, and the folders it lies in; after a crash or a loss of power it is whole or as it was.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # without it, files may be renamed on disk in another order than they were here
        finally:
            os.close(folder)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; give another folder") from error
