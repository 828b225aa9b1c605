import json
import math
import platform
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavutil

from companion.config import Config, parse
from companion.errors import UsageError
from companion.flight_record import (
    ABOUT,
    CONFIG,
    CONTROL,
    FLUSH_S,
    KIND,
    TLOG,
    Damage,
    Farewell,
    FlightRecord,
    Gap,
    RecordedFailure,
    RecordedStep,
    decoded,
    encoded,
    line_of,
    misfit,
    read_about,
    read_control,
)
from companion.follower import FailedStep, Follower, Step
from companion.types import ControlInput, Parameter, Severity, Text
from mscf import Box
from sim.eyes import TrueEyes
from sim.scenarios import SCENARIOS, fly

START_S, START_US = 1000.0, 1_767_225_600_000_000
FLIGHT = replace(SCENARIOS["straight"], duration_s=8.0)


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    """Of a short flight that engages."""
    found: list[Step] = []
    fly(FLIGHT, "ardupilot", TrueEyes, recorder=found.append)
    return found


@pytest.fixture
def config() -> Config:
    return parse(
        '[camera]\nfocal_px = 900\ndistortion = [0.1, -0.02, 1e-7, 0]\n[record]\nfolder = "/a \\"b\\" \\u007f"\n'
    )


def written(folder: Path, config: Config, steps: list[Step]) -> Path:
    record = FlightRecord(folder, config, START_S, START_US)
    for step in steps:
        record.add(step)
    record.close()
    return folder


def refuse(constant: str) -> None:
    raise AssertionError(constant)


# ------------------------------------------------------------------------------------------------ values as JSON
@settings(max_examples=300, deadline=None)
@given(st.from_type(ControlInput))
def test_any_input_of_the_controller_is_rebuilt_to_the_bit_from_strict_json(inputs: ControlInput) -> None:
    text = line_of({"": encoded(inputs)})
    assert text.count(b"\n") == 1
    assert repr(decoded(json.loads(text, parse_constant=refuse)[""])) == repr(inputs)


def test_the_inputs_of_a_flight_are_rebuilt_with_their_types(steps: list[Step]) -> None:
    for step in steps:
        rebuilt = decoded(json.loads(line_of({"": encoded(step.inputs)}))[""])
        assert rebuilt == step.inputs
        assert repr(rebuilt) == repr(step.inputs)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (math.nan, '{"is":"float","name":"nan"}'),
        (-math.inf, '{"is":"float","name":"-inf"}'),
        (-0.0, "-0.0"),
        (0.1, "0.1"),
        (1, "1"),
        (True, "true"),
        (np.float64(0.1), "0.1"),
        (np.array([[1.0, math.inf]]), '[[1.0,{"is":"float","name":"inf"}]]'),
        (Severity.ERROR, '{"is":"Severity","name":"ERROR"}'),
        (Box(0.0, 1.0, 2.0, 3.0), '{"is":"Box","x":0.0,"y":1.0,"w":2.0,"h":3.0}'),
        ("a\n\ud800", '"a\\n\\ud800"'),
    ],
)
def test_values_are_written_as(value: object, text: str) -> None:
    assert line_of({"v": encoded(value)}).decode() == f'{{"v":{text}}}\n'


def test_what_could_not_be_rebuilt_is_refused() -> None:
    for value in ([1.0], {1: 2}, object(), b"bytes"):
        with pytest.raises(TypeError, match=f"{type(value).__name__} cannot be recorded"):
            encoded(value)


# ------------------------------------------------------------------------------------------------ files
def test_every_packet_is_read_back_from_the_log_as_ground_stations_read_it(
    tmp_path: Path, config: Config, steps: list[Step]
) -> None:
    log = mavutil.mavlogfile(str(written(tmp_path, config, steps) / TLOG))
    for step in steps:
        for packet in (*step.received, *step.sent):
            message = log.recv_msg()
            assert bytes(message.get_msgbuf()) == packet
            assert message._timestamp == pytest.approx(START_US / 1e6 + step.inputs.now_s - START_S, abs=2e-6)
    assert log.recv_msg() is None
    log.f.close()


def test_the_log_begins_with_eight_bytes_of_microseconds(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    first = next(step for step in steps if step.received or step.sent)
    data = (written(tmp_path, config, steps) / TLOG).read_bytes()
    assert struct.unpack(">Q", data[:8]) == (START_US + round((first.inputs.now_s - START_S) * 1e6),)
    assert data[8] == 0xFD


def test_every_step_is_read_back_with_its_output_and_what_was_told(
    tmp_path: Path, config: Config, steps: list[Step]
) -> None:
    entries = list(read_control(written(tmp_path, config, steps)))
    assert len(entries) == len(steps)
    for entry, step in zip(entries, steps, strict=True):
        assert isinstance(entry, RecordedStep)
        assert entry.inputs == step.inputs
        assert line_of(entry.output) == line_of(encoded(step.control))
        assert entry.texts == tuple(text.text for text in step.texts)
    assert any(step.control.setpoint is not None for step in steps)


def test_the_effective_configuration_is_there_and_nothing_that_names_the_machine(
    tmp_path: Path, config: Config
) -> None:
    written(tmp_path, config, [])
    assert parse((tmp_path / CONFIG).read_text()) == config
    about = read_about(tmp_path)
    assert about["record"] == KIND
    assert about["start_utc"] == "2026-01-01T00:00:00.000+00:00"
    assert {"mscf-companion", "python", "numpy", "opencv", "pymavlink", "system", "architecture"} <= set(about)
    assert platform.node() not in about.values()


def test_equal_flights_give_equal_bytes(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    again: list[Step] = []
    fly(FLIGHT, "ardupilot", TrueEyes, recorder=again.append)
    one, other = (written(tmp_path / name, config, flight) for name, flight in (("a", steps), ("b", again)))
    for name in (ABOUT, CONFIG, TLOG, CONTROL):
        assert (one / name).read_bytes() == (other / name).read_bytes()


def test_what_is_older_than_half_a_second_is_with_the_system(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    record = FlightRecord(tmp_path, config, START_S, START_US)
    for step in steps:
        record.add(step)
        kept = [entry for entry in read_control(tmp_path) if isinstance(entry, RecordedStep)]
        assert step.inputs.now_s - (kept[-1].inputs.now_s if kept else START_S) < FLUSH_S + 0.001
    record.sync()
    record.close()


def test_half_a_line_at_the_end_is_left_out(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    path = written(tmp_path, config, steps[:3]) / CONTROL
    data = path.read_bytes()
    third = len(data) - len(data.splitlines(keepends=True)[-1])
    for length in range(third, len(data)):
        path.write_bytes(data[:length])
        assert len(list(read_control(tmp_path))) == 2, length


def test_gaps_and_the_farewell_have_their_own_lines(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    packets = next(step.sent for step in steps if len(step.sent) > 1)
    record = FlightRecord(tmp_path, config, START_S, START_US)
    record.add(steps[0])
    record.add_gap(7)
    record.add_farewell(1005.5, packets)
    record.close()
    _, gap, farewell = read_control(tmp_path)
    assert gap == Gap(7)
    ids = tuple(int.from_bytes(packet[7:10], "little") for packet in packets)
    assert farewell == Farewell(1005.5, ids)


def test_a_folder_that_cannot_be_made_is_an_error_of_the_system(tmp_path: Path, config: Config) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OSError, match="taken"):
        FlightRecord(tmp_path / "taken" / "flight", config, START_S, START_US)


# ------------------------------------------------------------------------------------------------ what is no record
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "is no flight record: about.json: No such file or directory"),
        (b"{", "is no flight record: about.json is not JSON"),
        (b"\xff", "is no flight record: about.json is not JSON"),
        (b"[]", "its about.json is of something else"),
        (b'{"record": "other"}', "its about.json is of something else"),
    ],
)
def test_what_is_no_record_is_said_in_one_line(tmp_path: Path, content: bytes | None, said: str) -> None:
    if content is not None:
        (tmp_path / ABOUT).write_bytes(content)
    with pytest.raises(UsageError, match=said) as raised:
        read_about(tmp_path)
    assert "\n" not in str(raised.value)


def _without_time(line: dict[str, Any]) -> None:
    del line["inputs"]["now_s"]


def _with_more(line: dict[str, Any]) -> None:
    line["inputs"]["wishes"] = 1


def _of_another(line: dict[str, Any]) -> None:
    line["inputs"] = {"is": "Box", "x": 0, "y": 0, "w": 1, "h": 1}


def _of_nobody(line: dict[str, Any]) -> None:
    line["inputs"]["is"] = "os.system"


def _without_output(line: dict[str, Any]) -> None:
    line["output"] = 1


def _at_no_time(line: dict[str, Any]) -> None:
    line["inputs"]["now_s"] = {"is": "float", "name": "nan"}


def _back_in_time(line: dict[str, Any]) -> None:
    line["inputs"]["now_s"] = 1.0


def _with_a_word_for_a_number(line: dict[str, Any]) -> None:
    line["inputs"]["events"][0]["time_s"] = "12"


def _with_a_monstrous_number(line: dict[str, Any]) -> None:
    line["inputs"]["now_s"] = 10**400


def _with_a_number_for_a_track(line: dict[str, Any]) -> None:
    line["inputs"]["track"] = 3


def _with_words_for_a_list(line: dict[str, Any]) -> None:
    line["texts"] = "Following"


def _missing(line: dict[str, Any]) -> None:
    line["missing"] = "3"


def _farewell(line: dict[str, Any]) -> None:
    line["farewell"] = None


@pytest.mark.parametrize(
    "spoil",
    [
        _without_time,
        _with_more,
        _of_another,
        _of_nobody,
        _without_output,
        _at_no_time,
        _back_in_time,
        _with_a_word_for_a_number,
        _with_a_monstrous_number,
        _with_a_number_for_a_track,
        _with_words_for_a_list,
        _missing,
        _farewell,
    ],
)
def test_a_line_that_is_none_of_ours_is_named(
    tmp_path: Path, config: Config, steps: list[Step], spoil: Callable[[dict[str, Any]], None]
) -> None:
    path = written(tmp_path, config, steps[:3]) / CONTROL
    *before, third = path.read_bytes().splitlines(keepends=True)
    line = json.loads(third)
    spoil(line)
    path.write_bytes(b"".join([*before, line_of(line), third]))
    first, second, damage, again = read_control(tmp_path)
    assert isinstance(damage, Damage)
    assert "control.jsonl, line 3 is damaged, or of another version: " in damage.text
    assert "\n" not in damage.text
    for step in (first, second, again):  # what is good behind it is read
        assert isinstance(step, RecordedStep)


@pytest.mark.parametrize("number", [0, 1, 4, 8])
@pytest.mark.parametrize("ahead_s", [0.075, 800.0])
@pytest.mark.parametrize("has_gap", [False, True])
def test_one_time_far_ahead_makes_its_own_line_damaged_and_none_that_follows(
    tmp_path: Path,
    config: Config,
    steps: list[Step],
    number: int,
    ahead_s: float,
    has_gap: bool,  # noqa: FBT001 - a table
) -> None:
    path = written(tmp_path, config, steps[:10]) / CONTROL
    lines = path.read_bytes().splitlines(keepends=True)
    line = json.loads(lines[number])
    line["inputs"]["now_s"] += ahead_s
    lines[number] = line_of(line)
    if has_gap:
        lines.insert(number + 1, line_of({"missing": 2}))
    path.write_bytes(b"".join(lines))
    entries = list(read_control(tmp_path))
    damage = entries.pop(number)
    assert isinstance(damage, Damage)
    assert f"line {number + 1} is damaged" in damage.text
    if has_gap:
        assert entries.pop(number) == Gap(2)
    inputs = [step.inputs for step in (*steps[:number], *steps[number + 1 : 10])]
    assert [entry.inputs for entry in entries if isinstance(entry, RecordedStep)] == inputs
    assert len(entries) == len(inputs)


def test_a_time_before_both_that_it_follows_is_itself_the_damage(
    tmp_path: Path, config: Config, steps: list[Step]
) -> None:
    path = written(tmp_path, config, steps[:10]) / CONTROL
    lines = path.read_bytes().splitlines(keepends=True)
    line = json.loads(lines[5])
    line["inputs"]["now_s"] -= 0.5
    path.write_bytes(b"".join([*lines[:5], line_of(line), *lines[6:]]))
    assert [k for k, entry in enumerate(read_control(tmp_path)) if isinstance(entry, Damage)] == [5]


@pytest.mark.parametrize(
    "line",
    [
        b"\n",
        b"null\n",
        b"[]\n",
        b"{}\n",
        b"\xff\n",
        b"[" * 100_000 + b"\n",
        b"1\n",
        b'"missing"\n',
        b'{"missing":1e999}\n',
        b'{"missing":0}\n',
        b'{"farewell":NaN,"messages":[]}\n',
        b'{"farewell":1.0,"messages":["a"]}\n',
        b'{"inputs":{"is":"Contr{"missing":1}\n',
        b'{"raised":1}\n',
        b'{"raised":"ValueError: x","inputs":null}\n',
    ],
)
def test_no_line_makes_a_reader_raise_anything(tmp_path: Path, line: bytes) -> None:
    (tmp_path / CONTROL).write_bytes(line)
    (damage,) = read_control(tmp_path)
    assert isinstance(damage, Damage)
    assert "line 1 is damaged" in damage.text


@settings(max_examples=100, deadline=None)
@given(st.from_type(ControlInput))
def test_every_input_is_of_the_types_it_says(inputs: ControlInput) -> None:
    assert misfit(inputs, ControlInput, "inputs") == ""
    wrong = replace(inputs, is_sent=1)  # type: ignore[arg-type]
    assert misfit(wrong, ControlInput, "inputs") == "inputs.is_sent = '1' is of another type"


@pytest.mark.parametrize(
    ("value", "hint", "said"),
    [
        (1, float, ""),
        (True, float, "x = 'True' is of another type"),
        (2**63, float, f"x = '{2**63}' is of another type"),
        (2**63, int, ""),
        (None, float | None, ""),
        ("a", float | None, "x = 'a' is of another type"),
        ((1.0, 2.0), tuple[float, float], ""),
        ((1.0, 2.0), tuple[float, float, float], "x = '(1.0, 2.0)' is of another type"),
        ([1.0, 2.0], tuple[float, ...], "x = '[1.0, 2.0]' is of another type"),
        ((1.0, "a"), tuple[float, ...], "x[1] = 'a' is of another type"),
        ((), tuple[float, ...], ""),
        (Box(0, 0, "w", 1), Box | None, "x.w = 'w' is of another type"),  # type: ignore[arg-type]
        (Severity.ERROR, int, "x = '3' is of another type"),
    ],
)
def test_what_is_of_another_type_is_named(value: object, hint: object, said: str) -> None:
    assert misfit(value, hint, "x") == said


def test_what_the_operator_was_told_last_is_in_the_last_line(tmp_path: Path, config: Config) -> None:
    follower, record = Follower(config), FlightRecord(tmp_path, config, START_S, START_US)
    text = Text(Severity.WARNING, "x" * 50)
    sent = follower.step(START_S, b"", None, notices=(text,)).sent
    record.add_farewell(START_S + 1, sent)
    record.close()
    (farewell,) = read_control(tmp_path)
    assert isinstance(farewell, Farewell)
    assert len(farewell.message_ids) > 1
    assert farewell.texts == (text.text,)


def test_a_step_that_failed_is_read_back_with_its_exception(tmp_path: Path, config: Config, steps: list[Step]) -> None:
    record = FlightRecord(tmp_path, config, START_S, START_US)
    record.add(steps[0])
    record.add_failed(FailedStep(steps[1].inputs, steps[1].received, "ValueError: math domain error"))
    assert list(read_control(tmp_path))[1] == RecordedFailure(
        steps[1].inputs, "ValueError: math domain error"
    )  # flushed
    assert record.size_bytes == sum((tmp_path / name).stat().st_size for name in (CONTROL, TLOG))
    record.close()


NESTED = reduce(lambda inner, _: (inner,), range(5000), ())  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize("event", [object(), Parameter("X", {1: 2}), NESTED])  # type: ignore[arg-type]
def test_a_step_that_failed_by_inputs_that_cannot_be_recorded_leaves_its_exception(
    tmp_path: Path, config: Config, steps: list[Step], event: Any
) -> None:
    record = FlightRecord(tmp_path, config, START_S, START_US)
    record.add(steps[0])
    record.add_failed(FailedStep(replace(steps[1].inputs, events=(event,)), steps[1].received, "TypeError: x"))
    record.add_farewell(steps[1].inputs.now_s, ())
    record.close()
    _, failure, farewell = read_control(tmp_path)
    assert failure == RecordedFailure(None, "TypeError: x")
    assert farewell == Farewell(steps[1].inputs.now_s, ())


def test_lines_that_are_not_there_are_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"control\.jsonl cannot be read: No such file"):
        list(read_control(tmp_path))
