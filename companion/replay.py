"""A recorded flight, decided again: the recorded inputs through a new controller, every output compared to the bit."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.config import read
from companion.controller import Controller
from companion.errors import ConfigError, UsageError
from companion.flight_folders import about_of
from companion.flight_record import (
    CONFIG,
    CONTROL,
    STATUSTEXT,
    Damage,
    Farewell,
    Gap,
    RecordedFailure,
    encoded,
    line_of,
    read_control,
    time_of,
    versions,
)
from companion.follower import described
from companion.types import ControlInput

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")  # of an object in the text of an exception: another one in every process


@dataclass(frozen=True, slots=True)
class Difference:
    """The first thing that the controller decides otherwise than it did."""

    step: int  # the first is 1
    time_s: float  # since the first step
    field: str
    recorded: str
    replayed: str


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of it.

    steps : that were compared and are equal.
    missing : how many the recorder lost, or lost the inputs of, after which nothing can be compared; 0: none.
    recorded_by : version of the project; None: the one that replays.
    is_whole : whether the record has its end: it breaks off where the process was killed, or the disk was full.
    raised : what the controller raised in the last step, then as now; empty: nothing.
    """

    steps: int
    difference: Difference | None = None
    missing: int = 0
    recorded_by: str | None = None
    is_whole: bool = False
    raised: str = ""


def replay(folder: Path) -> Replay:
    """Decide a recorded flight again, up to the first difference.

    Raises
    ------
    UsageError
        If the folder holds no record, or one that cannot be read.
    """
    recorded_by = about_of(folder).get("mscf-companion")
    other = str(recorded_by) if recorded_by != versions()["mscf-companion"] else None
    try:
        controller = Controller(read(folder / CONFIG))
    except ConfigError as error:  # that of a record is no configuration to be mended
        raise UsageError(str(error)) from error
    steps, start_s, is_whole, raised = 0, None, False, ""
    for entry in read_control(folder):
        if isinstance(entry, Damage):
            raise UsageError(f"{entry.text}; from there on nothing can be compared, the {steps} steps before are equal")
        if isinstance(entry, Gap):
            return Replay(steps, missing=entry.count, recorded_by=other)
        now_s = time_of(entry)
        if now_s is None:  # a step that failed, whose inputs could not be recorded
            return Replay(steps, missing=1, recorded_by=other)
        start_s = now_s if start_s is None else start_s
        if isinstance(entry, Farewell):
            is_whole = True
            # a status text is sent at the end only together with a request for a flight mode
            was_asked, is_asked = STATUSTEXT in entry.message_ids, controller.shut_down() is not None
            found = None if was_asked is is_asked else ("request at the end", str(was_asked), str(is_asked))
        else:
            assert entry.inputs is not None  # it has a time
            output, raised = _decided(controller, entry.inputs)
            was_raised = entry.raised if isinstance(entry, RecordedFailure) else ""
            is_same = _lasting(raised) == _lasting(was_raised)
            found = None if is_same else ("exception", was_raised or "none", raised or "none")
            if found is None and not isinstance(entry, RecordedFailure):
                found = _difference(entry.output, output)
        if found is not None:
            return Replay(steps, Difference(steps + 1, now_s - start_s, found[0].lstrip("."), *found[1:]), 0, other)
        steps += not isinstance(entry, Farewell)
    if not steps:
        raise UsageError(f"{folder / CONTROL} has no step of a flight in it: there is nothing to replay")
    return Replay(steps, recorded_by=other, is_whole=is_whole, raised=raised)


def _decided(controller: Controller, inputs: ControlInput) -> tuple[Any, str]:
    """The output as JSON, and what was raised in its place, if anything was."""
    try:
        return encoded(controller.step(inputs)), ""
    except Exception as error:  # noqa: BLE001 - whatever it is, it is what is compared
        return None, described(error)


def _lasting(raised: str) -> str:
    """Text of an exception without what is another in every process."""
    return _ADDRESS.sub("", raised)


def _difference(recorded: Any, replayed: Any) -> tuple[str, str, str] | None:
    """Name and both values of the first field that differs; None: none."""
    # by their text: a number that is equal but not the same, as 0.0 and -0.0 or 1 and 1.0, differs
    if line_of({"": recorded}) == line_of({"": replayed}):
        return None
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        shared = [name for name in recorded if name in replayed]
        found = _first_of({f".{name}": (recorded[name], replayed[name]) for name in shared})
        return found or ("'s fields", ", ".join(recorded), ", ".join(replayed))  # of another version
    if isinstance(recorded, list) and isinstance(replayed, list) and len(recorded) == len(replayed):
        return _first_of({f"[{k}]": pair for k, pair in enumerate(zip(recorded, replayed, strict=True))})
    return "", _shown(recorded), _shown(replayed)


def _first_of(parts: dict[str, tuple[Any, Any]]) -> tuple[str, str, str] | None:
    for name, (recorded, replayed) in parts.items():
        found = _difference(recorded, replayed)
        if found is not None:
            return name + found[0], *found[1:]
    return None


def _shown(value: Any) -> str:
    """A value for the eye."""
    if isinstance(value, dict) and value.keys() == {"is", "name"}:
        return str(value["name"])
    return line_of({"": value}).decode()[4:-2]
