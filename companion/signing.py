"""MAVLink 2 signing: a key that all who may be heard share, and a time stamp that never goes back.

Source: "Message Signing" of the MAVLink developer guide. `Signing` is what the wire needs, without files or clocks;
`read_key` finds the key. `signing_keeper` keeps the stamp over restarts.
"""

import hashlib
import hmac
import logging
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.config import SigningConfig
from companion.errors import ConfigError

logger = logging.getLogger(__name__)
CREDENTIAL = "signing-key"
KEY_SIZE = 32
MIN_PASSPHRASE = 8  # characters; QGroundControl asks for as many
STAMPS_PER_S = 100_000  # a stamp is 10 us
EPOCH_S = 1_420_070_400  # 2015-01-01, in Unix time
MAX_HEARD = (1 << 48) - (1 << 40)  # a stamp has 48 bits: nobody may bring ours, which follows, near their end
MAX_BEHIND = 60 * STAMPS_PER_S  # of a sender that was not heard before
_MAX_KEY_FILE = 1024  # bytes
_LIKELY_HEX = 32  # hexadecimal digits: as many are a key that was cut or doubled, not a passphrase
_SIGNATURE, _STAMP = 6, 6  # bytes at the end of a packet, after the link number


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
        if not self._streams.get(stream, max(self._first, self.stamp - MAX_BEHIND) - 1) < stamp < MAX_HEARD:
            return False
        self._streams[stream] = stamp
        self._shared.timestamp = max(self.stamp, stamp)
        return True


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
