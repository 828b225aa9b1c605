"""The time stamp of signing over restarts: a file that is ahead of all that was sent, and the thread that writes it."""

import logging
import os
import threading
from collections.abc import Mapping
from pathlib import Path

from companion.config import SigningConfig
from companion.signing import STAMPS_PER_S, Signing, read_key, stamp_at

logger = logging.getLogger(__name__)
STAMP_NAME = "signing-timestamp"
MARGIN = 60 * STAMPS_PER_S  # by which the stamp on the disk is ahead of what was sent
_MAX_STAMP = 1 << 48
_JOIN_S = 1.0


class SigningKeeper:
    """Keeps a stamp on the disk that is ahead of all that were sent, whenever the power is cut.

    It is written by a thread of its own: a card that hesitates must not hold the command loop.

    Parameters
    ----------
    path : of the file; None: there is no place to keep it.
    """

    def __init__(self, signing: Signing, path: Path | None) -> None:
        self.signing = signing
        self._path = path
        self._due = 0  # the stamp at which to write again
        self._writer: threading.Thread | None = None
        self._has_warned = False
        if path is None:
            self._warn("there is no $STATE_DIRECTORY and no signing.key_file to keep it beside")

    def keep(self, wall_s: float) -> None:
        """Follow the wall clock, and write where it is time: call it once a step, before anything is sent."""
        self.signing.follow(wall_s)
        if self._path is None or self.signing.stamp < self._due or (self._writer and self._writer.is_alive()):
            return
        self._due = self.signing.stamp + MARGIN // 2
        self._start(self._path, self.signing.stamp + MARGIN)

    def close(self) -> None:
        """Write the stamp as it is: after an orderly end no margin is needed."""
        if self._writer is not None:
            self._writer.join(_JOIN_S)
        if self._path is not None and not (self._writer and self._writer.is_alive()):
            self._start(self._path, self.signing.stamp)
            assert self._writer is not None
            self._writer.join(_JOIN_S)

    def _start(self, path: Path, stamp: int) -> None:
        # a disk that hangs must not keep the process from ending
        self._writer = threading.Thread(name="signing-stamp", target=self._write, args=(path, stamp), daemon=True)
        self._writer.start()

    def _write(self, path: Path, stamp: int) -> None:
        new = path.with_name(path.name + ".new")
        try:
            with new.open("w", encoding="ascii") as file:
                file.write(f"{stamp}\n")
                file.flush()
                os.fsync(file.fileno())  # else a cut of the power may leave an empty file behind
            new.replace(path)
        except OSError as error:
            self._warn(f"{path} cannot be written: {error.strerror or error}")

    def _warn(self, why: str) -> None:
        if not self._has_warned:
            self._has_warned = True
            logger.warning("signing: the time stamp is not kept, a restart with a wrong clock is not heard: %s", why)


def keeper_from(config: SigningConfig, environ: Mapping[str, str], wall_s: float) -> SigningKeeper | None:
    """Signing as configured; None where there is no key.

    Raises
    ------
    ConfigError
        If there is a key file that holds no key.
    """
    key = read_key(config, environ)
    if key is None:
        return None
    path = _stamp_path(config, environ)
    stamp = max(stamp_at(wall_s), _kept_stamp(path))
    return SigningKeeper(Signing(key, config.link_id, stamp), path)


def _stamp_path(config: SigningConfig, environ: Mapping[str, str]) -> Path | None:
    state = environ.get("STATE_DIRECTORY", "").split(":")[0]  # of several, the first
    if state:
        return Path(state, STAMP_NAME)
    return Path(config.key_file).with_name(STAMP_NAME) if config.key_file else None


def _kept_stamp(path: Path | None) -> int:
    if path is None:
        return 0
    try:
        stamp = int(path.read_bytes()[:32])
    except FileNotFoundError:  # the first start
        return 0
    except (OSError, ValueError):
        stamp = -1
    if 0 <= stamp < _MAX_STAMP - MARGIN:
        return stamp
    logger.warning("signing: %s holds no time stamp: the clock of this computer counts alone", path)
    return 0
