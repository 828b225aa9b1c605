"""The record of a flight: a folder with all that went over the link, was given to the controller, and was decided.

| file | what |
|---|---|
| `about.json` | that this is a record, of which versions, and when it began |
| `config.toml` | the configuration in force, every key |
| `flight.tlog` | MAVLink as ground stations log it: 8 bytes of microseconds since 1970, big-endian, then the packet |
| `control.jsonl` | a line a step: `ControlInput` and `ControlOutput`, to the last bit |
| `flight.mp4` | what the camera saw, where that is recorded |

A line for each of three other things: steps that are missing, the step whose controller raised, the last words. The
lines are JSON: an object of ours is an object with its class in "is", an enumeration's value one with its "name", a
tuple a list. Numbers keep every bit, and those that are not finite are spelled out. A record whose writer
was killed ends with half a line, which readers leave out.
"""

import dataclasses
import json
import math
import os
import platform
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from itertools import starmap
from pathlib import Path
from typing import Any, BinaryIO, get_args, get_origin, get_type_hints

import cv2
import numpy as np

from companion.config import FILE_NAME, Config, text_of, without_passwords
from companion.errors import UsageError
from companion.follower import FailedStep, Step
from companion.types import ControlInput
from mscf.kernels.choice import chosen_kernels

ABOUT = "about.json"
CONFIG = FILE_NAME
TLOG = "flight.tlog"
CONTROL = "control.jsonl"
VIDEO = "flight.mp4"
FILES = (ABOUT, CONFIG, TLOG, CONTROL, VIDEO)
KIND = "mscf-companion flight"  # what `about.json` says of itself
STATUSTEXT = 253
FLUSH_S = 0.5  # of flight that a killed process may lose
_STAMP = struct.Struct(">Q")
_MAX_WHOLE = 2**63  # what stands for a float must be one that a float can hold
_IS = "is"  # key of the class's name; no field is called so


# ------------------------------------------------------------------------------------------------ values as JSON
def encoded(value: Any) -> Any:
    """A value of the controller's as what JSON can say, strictly.

    Raises
    ------
    TypeError
        If a part of it is of no kind that is known here.
    """
    match value:
        case Enum():  # first: some are numbers, too
            return {_IS: type(value).__name__, "name": value.name}
        case None | bool() | int() | str():
            return value
        case float():
            return float(value) if math.isfinite(value) else {_IS: "float", "name": repr(float(value))}
        case tuple():
            return [encoded(item) for item in value]
        case np.ndarray() | np.generic():
            return encoded(_nested(value.tolist()))
    if dataclasses.is_dataclass(value):
        parts = {field.name: encoded(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {_IS: type(value).__name__, **parts}
    raise TypeError(f"{type(value).__name__} cannot be recorded")


def _nested(values: Any) -> Any:
    return tuple(map(_nested, values)) if isinstance(values, list) else values


def decoded(value: Any) -> Any:
    """What `encoded` made the JSON from, for all that a `ControlInput` can hold.

    Raises
    ------
    KeyError, TypeError, ValueError
        If it is no such thing.
    """
    if isinstance(value, list):
        return tuple(map(decoded, value))
    if not isinstance(value, dict):
        return value
    name = value[_IS]
    if name == "float":
        return float(value["name"])
    kind = _INPUT_KINDS[name]
    if issubclass(kind, Enum):
        return kind[value["name"]]
    return kind(**{key: decoded(part) for key, part in value.items() if key != _IS})


def _kinds_in(kind: Any) -> Iterator[type]:
    """The classes and enumerations that a value of a type can be made of."""
    if isinstance(kind, type) and issubclass(kind, Enum):
        yield kind
    elif dataclasses.is_dataclass(kind) and isinstance(kind, type):
        yield kind
        for part in get_type_hints(kind).values():
            yield from _kinds_in(part)
    for part in get_args(kind):
        yield from _kinds_in(part)


_INPUT_KINDS = {kind.__name__: kind for kind in _kinds_in(ControlInput)}
_HINTS = {kind: get_type_hints(kind) for kind in _INPUT_KINDS.values() if dataclasses.is_dataclass(kind)}


def misfit(value: Any, hint: Any, name: str) -> str:
    """What of a value is not of the type that a field says, by its name; empty: nothing.

    A whole number may stand for a float.
    """
    if hint in _HINTS and type(value) is hint:
        parts = ((getattr(value, part), kind, f"{name}.{part}") for part, kind in _HINTS[hint].items())
        return next(filter(None, starmap(misfit, parts)), "")
    kinds = get_args(hint)
    if get_origin(hint) is tuple and isinstance(value, tuple):
        kinds = kinds[:1] * len(value) if kinds[1:] == (...,) else kinds
        if len(kinds) == len(value):
            numbered = ((part, kind, f"{name}[{k}]") for k, (part, kind) in enumerate(zip(value, kinds, strict=True)))
            return next(filter(None, starmap(misfit, numbered)), "")
    elif kinds and get_origin(hint) is not tuple:  # one of several
        own = type(value) if type(value) in kinds else None
        found = [misfit(value, kind, name) for kind in ((own,) if own is not None else kinds)]
        if own is not None or "" in found:
            return "" if "" in found else found[0]
    elif type(value) is hint or (hint is float and type(value) is int and abs(value) < _MAX_WHOLE):
        return ""
    return f"{name} = {str(value)[:40]!r} is of another type"


def line_of(content: dict[str, Any]) -> bytes:
    """A line of the record: the same content gives the same bytes."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode() + b"\n"


# ------------------------------------------------------------------------------------------------ writing
class FlightRecord:
    """Writes the record of a flight.

    Parameters
    ----------
    folder : made if it is not there.
    start_s : our clock at the start of the record.
    start_us : the same instant in microseconds since 1970 UTC; the offset between both stays what it is then.

    Raises
    ------
    OSError
        If a file cannot be written; so do `add` and what follows.
    """

    def __init__(self, folder: Path, config: Config, start_s: float, start_us: int) -> None:
        self.folder = folder
        self._start_s, self._start_us = start_s, start_us
        self._flushed_s = start_s
        folder.mkdir(parents=True, exist_ok=True)
        start_utc = datetime.fromtimestamp(start_us / 1e6, UTC).isoformat(timespec="milliseconds")
        about = {"record": KIND, "start_utc": start_utc, **versions()}
        # first of all: it makes the folder one that may be removed one day
        (folder / ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        (folder / CONFIG).write_text(text_of(without_passwords(config)), encoding="utf-8")
        self._tlog: BinaryIO = (folder / TLOG).open("wb")
        self._control: BinaryIO = (folder / CONTROL).open("wb")

    def add(self, step: Step) -> None:
        """Append a step."""
        now_s = step.inputs.now_s
        self._add_packets(now_s, (*step.received, *step.sent))
        line = {"inputs": encoded(step.inputs), "output": encoded(step.control)}
        if step.texts:
            line["texts"] = [text.text for text in step.texts]
        self._control.write(line_of(line))
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            self.flush()

    def add_failed(self, failed: FailedStep) -> None:
        """Append the step whose controller raised, and hand it over to the system at once.

        Inputs that cannot be recorded may be what it raised of: then the exception stands alone.
        """
        self._add_packets(failed.inputs.now_s, failed.received)
        try:
            line = line_of({"inputs": encoded(failed.inputs), "raised": failed.raised})
        except (TypeError, ValueError, RecursionError):
            line = line_of({"raised": failed.raised})
        self._control.write(line)
        self.flush()

    def add_gap(self, count: int) -> None:
        """Say that so many steps are missing here."""
        self._control.write(line_of({"missing": count}))

    def add_farewell(self, now_s: float, packets: Sequence[bytes]) -> None:
        """Append the last words, after which no step comes."""
        self._add_packets(now_s, packets)
        line = {"farewell": encoded(now_s), "messages": [message_id(packet) for packet in packets]}
        texts = [status_text(packet) for packet in packets if message_id(packet) == STATUSTEXT]
        self._control.write(line_of(line | {"texts": texts}))
        self.flush()

    def _add_packets(self, now_s: float, packets: Sequence[bytes]) -> None:
        stamp = _STAMP.pack(self._start_us + round((now_s - self._start_s) * 1e6))
        for packet in packets:
            self._tlog.write(stamp + packet)

    @property
    def size_bytes(self) -> int:
        """Of what grows with the flight."""
        return self._tlog.tell() + self._control.tell()

    def flush(self) -> None:
        """Hand over to the system what was added: no death of this process loses it."""
        self._tlog.flush()
        self._control.flush()

    def sync(self) -> None:
        """Wait until the disk has what the system has: then no loss of power loses it.

        A file that is not there any more is an error: what is written into it is lost without one.
        """
        for name in FILES:
            with suppress(FileNotFoundError) if name == VIDEO else nullcontext():  # not every record has one
                descriptor = os.open(self.folder / name, os.O_RDONLY)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)

    def close(self) -> None:
        """Finish; safe to call twice, and after an error."""
        try:
            self._tlog.close()
        finally:
            self._control.close()


def message_id(packet: bytes) -> int:
    """Number of the message in a packet of MAVLink 2."""
    return int.from_bytes(packet[7:10], "little")


def status_text(packet: bytes) -> str:
    """Text of a STATUSTEXT in a packet of MAVLink 2, which leaves out zeros at the end of its payload.

    Source: MAVLink's common.xml, message 253 (severity, then 50 characters), and the serialization of MAVLink 2.
    """
    payload = packet[10 : 10 + packet[1]]
    return payload[1:51].rstrip(b"\0").decode("ascii", "replace")


def versions() -> dict[str, str]:
    """Versions of what computes, and the kind of machine; nothing that names this one."""
    return {
        "mscf-companion": _version("mscf-companion"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "pymavlink": _version("pymavlink"),
        "kernels": chosen_kernels().name,
        "system": platform.system(),
        "architecture": platform.machine(),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


# ------------------------------------------------------------------------------------------------ reading
@dataclass(frozen=True, slots=True)
class RecordedStep:
    """A step as it was recorded; the output as JSON, which is compared and not computed with."""

    inputs: ControlInput
    output: dict[str, Any]
    texts: tuple[str, ...]  # what the operator was told


@dataclass(frozen=True, slots=True)
class RecordedFailure:
    """The step whose controller raised, which ended the flight."""

    inputs: ControlInput | None  # None: they could not be recorded
    raised: str  # class and text of the exception


@dataclass(frozen=True, slots=True)
class Gap:
    """Steps that were not recorded, as the writer came to nothing."""

    count: int


@dataclass(frozen=True, slots=True)
class Farewell:
    """The end of the flight by our own will."""

    now_s: float
    message_ids: tuple[int, ...]  # of the packets that were written then
    texts: tuple[str, ...] = ()  # what the operator was told with them


@dataclass(frozen=True, slots=True)
class Damage:
    """A line that is none of ours."""

    text: str  # where it is, and what is wrong with it


Entry = RecordedStep | RecordedFailure | Gap | Farewell | Damage


def read_about(folder: Path) -> dict[str, Any]:
    """What a record says of itself.

    Raises
    ------
    UsageError
        If the folder holds no record.
    """
    try:
        about = json.loads((folder / ABOUT).read_bytes())
    except OSError as error:
        raise UsageError(f"{folder} is no flight record: {ABOUT}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{folder} is no flight record: {ABOUT} is not JSON: {error}") from error
    if not isinstance(about, dict) or about.get("record") != KIND:
        raise UsageError(f"{folder} is no flight record: its {ABOUT} is of something else")
    return about


def read_control(folder: Path) -> Iterator[Entry]:
    """The lines of a record, in order; half a line at the end is left out.

    A line that is none of ours, or whose time cannot be right, comes as `Damage`: whoever reads on must say so.

    Raises
    ------
    UsageError
        If the file is not there.
    """
    path = folder / CONTROL
    try:
        with path.open("rb") as file:
            yield from _in_order(path, file)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error


def _in_order(path: Path, lines: Iterable[bytes]) -> Iterator[Entry]:
    """The entries of lines, each held back until the next time shows that its own can be right.

    Of two whose times go back one is wrong: the earlier one where the later one is not before the entry before both, so
    that a single time far ahead takes none of what follows with it; else the later one.
    """
    held: list[Entry] = []  # the last one with a time, and those without one since
    number_of_last, last_s, before_s = 0, -math.inf, -math.inf  # the time of the last one, and of the one before it
    for number, line in enumerate(lines, start=1):
        if not line.endswith(b"\n"):
            break
        try:
            entry = _entry(line)
            time_s = _checked_time_s(entry, before_s)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            entry, time_s = _damage(path, number, f"{type(error).__name__}: {error}"), None
        if time_s is None:
            held.append(entry)
            continue
        if time_s < last_s:
            held[0] = _damage(path, number_of_last, f"its time is {last_s}, before one of {time_s}")
        else:
            before_s = last_s
        yield from held
        held, number_of_last, last_s = [entry], number, time_s
    yield from held


def _damage(path: Path, number: int, why: str) -> Damage:
    return Damage(f"{path}, line {number} is damaged, or of another version: {why}")


def _entry(line: bytes) -> Entry:
    content = json.loads(line, parse_constant=_finite, parse_float=_finite)
    if not isinstance(content, dict):
        raise TypeError("it is no object")
    if "missing" in content:
        count = _checked(content["missing"], int, "missing")
        if count < 1:
            raise ValueError(f"{count} steps cannot be missing")
        return Gap(count)
    texts = _checked(decoded(content.get("texts", [])), tuple[str, ...], "texts")
    if "farewell" in content:
        time_s = _checked(decoded(content["farewell"]), float, "farewell")
        return Farewell(time_s, _checked(decoded(content["messages"]), tuple[int, ...], "messages"), texts)
    if "raised" in content and "inputs" not in content:
        return RecordedFailure(None, _checked(content["raised"], str, "raised"))
    inputs = _checked(decoded(content["inputs"]), ControlInput, "inputs")
    if "raised" in content:
        return RecordedFailure(inputs, _checked(content["raised"], str, "raised"))
    return RecordedStep(inputs, _checked(content["output"], dict, "output"), texts)


def _checked(value: Any, hint: Any, name: str) -> Any:
    wrong = misfit(value, hint, name)
    if wrong:
        raise TypeError(wrong)
    return value


def _finite(text: str) -> float:
    """A number of strict JSON that a float can hold."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no finite number")
    return value


def time_of(entry: Entry) -> float | None:
    """When it was, on the clock of the record; None: it does not say."""
    match entry:
        case RecordedStep() | RecordedFailure():
            return entry.inputs.now_s if entry.inputs is not None else None
        case Farewell():
            return entry.now_s
    return None


def _checked_time_s(entry: Entry, before_s: float) -> float | None:
    """Time of an entry, if it has one, which must not be before another."""
    time_s = time_of(entry)
    if time_s is not None and not before_s <= time_s < math.inf:
        raise ValueError(f"its time is {time_s}, after one of {before_s}")
    return time_s
