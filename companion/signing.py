"""MAVLink 2 signing: a key that all who may be heard share, and a time stamp that never goes back.

Source: "Message Signing" of the MAVLink developer guide. `Signing` is what the wire needs, without files or clocks;
`SigningKeeper` keeps its stamp over restarts, and `read_key` finds the key.
"""

import hashlib
import hmac
import logging
import os
import stat
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.config import SigningConfig
from companion.errors import ConfigError

logger = logging.getLogger(__name__)
CREDENTIAL = "signing-key"
STAMP_NAME = "signing-timestamp"
KEY_SIZE = 32
MIN_PASSPHRASE = 8  # characters; QGroundControl asks for as many
STAMPS_PER_S = 100_000  # a stamp is 10 us
EPOCH_S = 1_420_070_400  # 2015-01-01, in Unix time
MAX_BEHIND = 60 * STAMPS_PER_S  # of a sender that was not heard before
MARGIN = 60 * STAMPS_PER_S  # by which the stamp on the disk is ahead of what was sent
_MAX_KEY_FILE = 1024  # bytes
_MAX_STAMP = 1 << 48
_LIKELY_HEX = 32  # hexadecimal digits: as many are a key that was cut or doubled, not a passphrase
_SIGNATURE, _STAMP = 6, 6  # bytes at the end of a packet, after the link number
_JOIN_S = 1.0


def stamp_at(wall_s: float) -> int:
    """Time stamp of a moment in Unix time; 0 before 2015, as on a computer without a battery for its clock."""
    return max(0, int((wall_s - EPOCH_S) * STAMPS_PER_S))


class Signing:
    """Signs what leaves on a link, and tells who has signed what arrives.

    Parameters
    ----------
    key : 32 bytes.
    link_id : of what we sign.
    stamp : where to begin, in 10 us since 2015; nothing that was signed before is heard from anybody. Otherwise what
        was recorded before a restart could be sent to us again: an order, for instance.
    """

    def __init__(self, key: bytes, link_id: int, stamp: int) -> None:
        self._shared = mavlink.MAVLinkSigning()  # one for all ends, so that no two messages have the same stamp
        self._shared.secret_key = key
        self._shared.link_id = link_id
        self._shared.timestamp = stamp
        self._shared.sign_outgoing = True
        self._key = key
        self._first = stamp
        self._streams: dict[tuple[int, int, int], int] = {}  # the last stamp by link, system and component

    @property
    def stamp(self) -> int:
        """That of the next message; everything before was smaller."""
        return int(self._shared.timestamp)

    def follow(self, wall_s: float) -> None:
        """Come up to the wall clock, where that is ahead; a clock that goes back is not followed."""
        self._shared.timestamp = max(self.stamp, stamp_at(wall_s))

    def equip(self, end: Any) -> None:
        """Let an end of the link, pymavlink's `MAVLink`, sign all it sends and hear only what is signed.

        pymavlink's own check is replaced. It stores a sender's stamp before it has looked at the signature: a forged
        message with a stamp of the future would lock the sender out.
        """
        end.signing = self._shared
        end.check_signature = self.is_genuine

    def is_genuine(self, packet: bytes, system_id: int, component_id: int) -> bool:
        """Whether a signed packet is signed with our key, and newer than all that its sender has sent."""
        signed, signature = bytes(packet[:-_SIGNATURE]), bytes(packet[-_SIGNATURE:])
        if not hmac.compare_digest(hashlib.sha256(self._key + signed).digest()[:_SIGNATURE], signature):
            return False
        stamp = int.from_bytes(signed[-_STAMP:], "little")
        stream = (signed[-_STAMP - 1], system_id, component_id)
        if stamp <= self._streams.get(stream, max(self._first, self.stamp - MAX_BEHIND) - 1):
            return False
        self._streams[stream] = stamp
        self._shared.timestamp = max(self.stamp, stamp)
        return True


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


def read_key(config: SigningConfig, environ: Mapping[str, str]) -> bytes | None:
    """The key in `signing.key_file`, else in systemd's credential `signing-key`; None where neither is there.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds no key; the text says how to mend it, and nothing of what is in the file.
    """
    if config.key_file:
        path = Path(config.key_file)
    else:
        folder = environ.get("CREDENTIALS_DIRECTORY", "")
        path = Path(folder, CREDENTIAL)
        if not folder or not path.exists():
            return None
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(_MAX_KEY_FILE + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a null in it
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"signing: {path} cannot be read: {why}; give a file that this account may read") from error
    if mode & (stat.S_IROTH | stat.S_IWOTH):
        logger.warning("signing: %s is open to everybody on this computer: chmod o= it, and change the key", path)
    try:
        return parse_key(data)
    except ConfigError as error:
        raise ConfigError(f"signing: {path}: {error}") from error


def parse_key(data: bytes) -> bytes:
    """Key of a key file: 64 hexadecimal digits, which are the key, or a passphrase, whose SHA-256 is.

    Mission Planner, MAVProxy and QGroundControl up to 5.0 make their keys of a passphrase in the same way (SHA-256 of
    its UTF-8 text). Newer QGroundControl derives them by PBKDF2: there, give it the 64 digits.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    mend = "write one line, 64 hexadecimal digits or a passphrase"
    if len(data) > _MAX_KEY_FILE:
        raise ConfigError(f"longer than {_MAX_KEY_FILE} bytes: {mend}")
    try:
        text = data.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise ConfigError(f"neither text nor digits: {mend}") from error
    digits = text.strip()
    if digits and all(letter in "0123456789abcdefABCDEF" for letter in digits) and len(digits) >= _LIKELY_HEX:
        if len(digits) != 2 * KEY_SIZE:
            raise ConfigError(f"{len(digits)} hexadecimal digits: a key has {2 * KEY_SIZE}")
        key = bytes.fromhex(digits)
        if not any(key):
            raise ConfigError("a key of zeros means no signing to the others: make a random one")
        return key
    if not text.isprintable():
        raise ConfigError(f"more than one line, or no text: {mend}")
    if len(digits) < MIN_PASSPHRASE:
        raise ConfigError(f"{len(digits)} characters: a passphrase has {MIN_PASSPHRASE} or more")
    return hashlib.sha256(text.encode()).digest()


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
