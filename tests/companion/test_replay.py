import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from companion import cli
from companion.config import text_of
from companion.controller import Controller
from companion.flight_record import ABOUT, CONFIG, CONTROL, STATUSTEXT, FlightRecord, line_of, message_id
from companion.follower import Follower, Step, StepError
from companion.replay import Difference, replay
from companion.types import Parameter
from sim.eyes import TrueEyes
from sim.loop import OUR_CLOCK_S, Loop
from sim.scenarios import AUTOPILOTS, SCENARIOS, WAIT_S, Operator
from sim.stages import stage

SCENARIO = SCENARIOS["straight"]
PLACE = stage(SCENARIO.stage, 7)
ENDS = ["ardupilot", "px4"]


@pytest.fixture(scope="module", params=ENDS)
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Step]]:
    """A flight that engages and is shut down, as it was recorded, and its steps."""
    folder, steps = tmp_path_factory.mktemp("flight"), []
    config = SCENARIO.config(PLACE)
    loop = Loop(
        PLACE,
        AUTOPILOTS[request.param],
        config,
        TrueEyes(PLACE),
        wait_s=WAIT_S,
        mode="GUIDED" if request.param == "ardupilot" else None,
        recorder=steps.append,
    )
    loop.run(9.0, Operator(SCENARIO).act)
    record = FlightRecord(folder, config, OUR_CLOCK_S, 0)
    for step in steps:
        record.add(step)
    record.add_farewell(OUR_CLOCK_S + 9, loop.follower.farewell(OUR_CLOCK_S + 9))
    record.close()
    return folder, steps


@pytest.fixture
def copy(flown: tuple[Path, list[Step]], tmp_path: Path) -> Path:
    for path in flown[0].iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def changed(folder: Path, number: int, change: Callable[[dict[str, Any]], None]) -> None:
    """Change a line, the first is 0."""
    lines = [json.loads(line) for line in (folder / CONTROL).read_bytes().splitlines()]
    change(lines[number])
    (folder / CONTROL).write_bytes(b"".join(map(line_of, lines)))


def test_a_flight_is_decided_again_to_the_bit(
    flown: tuple[Path, list[Step]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, steps = flown
    assert any(step.control.mode.is_engaged for step in steps)
    assert any(isinstance(event, Parameter) for step in steps for event in step.inputs.events)
    assert cli.main(["replay", str(folder)]) == 0
    assert capsys.readouterr().out == f"{len(steps)} steps, all equal\n"


def test_the_first_field_that_differs_is_named_with_both_values(
    copy: Path, flown: tuple[Path, list[Step]], capsys: pytest.CaptureFixture[str]
) -> None:
    number, step = next((k, s) for k, s in enumerate(flown[1]) if s.control.setpoint is not None)

    def turn(line: dict[str, Any]) -> None:
        line["output"]["setpoint"]["yaw_rate_radps"] = 0.25

    changed(copy, number, turn)
    assert step.control.setpoint is not None
    time_s, is_s = step.inputs.now_s - OUR_CLOCK_S, step.control.setpoint.yaw_rate_radps
    found = Difference(number + 1, time_s, "setpoint.yaw_rate_radps", "0.25", repr(is_s))
    assert replay(copy).difference == found
    assert cli.main(["replay", str(copy)]) == 1
    said = f"step {number + 1}, {time_s:.2f} s after the first: setpoint.yaw_rate_radps was 0.25, is {is_s!r}\n"
    assert capsys.readouterr().out == said


def _mode(line: dict[str, Any]) -> None:
    line["output"]["mode"]["name"] = "LANDED"


def _notes(line: dict[str, Any]) -> None:
    line["output"]["notes"] = ["a", "b", "c"]


def _zero(line: dict[str, Any]) -> None:
    line["output"]["selection"]["number"] = 0.0


def _fields(line: dict[str, Any]) -> None:
    line["output"]["wishes"] = None


@pytest.mark.parametrize(
    ("spoil", "field", "recorded"),
    [
        (_mode, "mode.name", '"LANDED"'),
        (_notes, "notes", '["a","b","c"]'),
        (_zero, "selection.number", "0.0"),  # equal, but not the same
        (_fields, "'s fields", "wishes"),
    ],
)
def test_whatever_differs_is_found(
    copy: Path, spoil: Callable[[dict[str, Any]], None], field: str, recorded: str
) -> None:
    changed(copy, 0, spoil)
    found = replay(copy).difference
    assert found is not None
    assert found.step == 1
    assert found.field == field
    assert found.recorded.endswith(recorded)


def test_what_the_controller_is_given_matters_to_the_last_value(copy: Path, flown: tuple[Path, list[Step]]) -> None:
    def shift(line: dict[str, Any]) -> None:
        line["inputs"]["track"]["box"]["x"] += 1e-9

    number = next(k for k, step in enumerate(flown[1]) if step.control.target is not None)
    changed(copy, number, shift)
    found = replay(copy).difference
    assert found is not None
    assert (found.step, found.field.partition(".")[0]) == (number + 1, "expected")


def test_another_configuration_decides_otherwise(copy: Path) -> None:
    config = SCENARIO.config(PLACE)
    other = replace(config, follow=replace(config.follow, mode="spotlight"))
    (copy / CONFIG).write_text(text_of(other))
    found = replay(copy).difference
    assert found is not None
    assert found.field == "setpoint.velocity_ned_mps[0]"
    assert found.replayed == "0.0"


def test_the_end_by_our_own_will_is_compared_too(copy: Path) -> None:
    def unasked(line: dict[str, Any]) -> None:
        assert 253 in line["messages"]
        line["messages"] = []

    changed(copy, -1, unasked)
    found = replay(copy).difference
    assert found is not None
    assert (found.field, found.recorded, found.replayed) == ("request at the end", "False", "True")


def test_after_steps_that_are_missing_nothing_is_claimed(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (copy / CONTROL).read_bytes().splitlines(keepends=True)
    (copy / CONTROL).write_bytes(b"".join([*lines[:5], line_of({"missing": 3}), *lines[8:]]))
    assert cli.main(["replay", str(copy)]) == 1
    said = "5 steps, all equal; the next 3 were not recorded: what follows is unknown\n"
    assert capsys.readouterr().out == said


def test_a_record_of_another_version_says_so(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = json.loads((copy / ABOUT).read_text())
    (copy / ABOUT).write_text(json.dumps(about | {"mscf-companion": "0.0.1"}))
    assert cli.main(["replay", str(copy)]) == 0
    assert capsys.readouterr().out.startswith("recorded by mscf-companion 0.0.1, replayed by ")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (ABOUT, None),
        (ABOUT, b"{}"),
        (CONFIG, None),
        (CONFIG, b"[folow]"),
        (CONFIG, b"\xff"),
        (CONTROL, None),
        (CONTROL, b"{}\n"),
    ],
)
def test_a_record_that_cannot_be_read_is_one_line_and_status_2(
    copy: Path, name: str, content: bytes | None, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / name).unlink()
    if content is not None:
        (copy / name).write_bytes(content)
    assert cli.main(["replay", str(copy)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mscf-companion: ")
    assert name in said
    assert len(said.splitlines()) == 1


def test_a_follower_that_never_engaged_asks_for_nothing_at_the_end(tmp_path: Path) -> None:
    config = SCENARIO.config(PLACE)
    follower = Follower(config)
    record = FlightRecord(tmp_path, config, 0.0, 0)
    for k in range(3):
        record.add(follower.step(float(k), b"", None))
    record.add_farewell(3.0, follower.farewell(3.0))
    record.close()
    result = replay(tmp_path)
    assert (result.steps, result.difference, result.missing) == (3, None, 0)


def test_a_record_that_breaks_off_is_said_to(
    copy: Path, flown: tuple[Path, list[Step]], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (copy / CONTROL).read_bytes().splitlines(keepends=True)
    (copy / CONTROL).write_bytes(b"".join(lines[:-1]))
    assert cli.main(["replay", str(copy)]) == 0
    assert capsys.readouterr().out.startswith(f"{len(flown[1])} steps, all equal; the record breaks off there: ")


def test_a_damaged_line_is_named_with_how_much_before_it_is_equal(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def spoil(line: dict[str, Any]) -> None:
        line["inputs"]["now_s"] = "soon"

    changed(copy, 5, spoil)
    assert cli.main(["replay", str(copy)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "control.jsonl, line 6 is damaged" in line
    assert line.endswith("the 5 steps before are equal")


def test_the_folder_above_a_record_is_answered_with_the_record(
    copy: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path_factory.mktemp("run")
    shutil.copytree(copy, run / "flights" / "a")
    assert cli.main(["replay", str(run)]) == 2
    assert capsys.readouterr().err.endswith(f"give a record below it: {run / 'flights' / 'a'}\n")


def test_a_record_without_a_step_is_nothing_to_replay(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (copy / CONTROL).write_bytes(b"")
    assert cli.main(["replay", str(copy)]) == 2
    assert "there is nothing to replay" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------ what raises
BREAKS_S = OUR_CLOCK_S + 9.0


@pytest.fixture
def breaks(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Of the controller, which has a mistake in it from a time on, until that is undone."""
    guide = Controller._guide

    def broken(controller: Controller, now_s: float) -> Any:
        if now_s >= BREAKS_S:
            raise ValueError(f"math domain error at {now_s - OUR_CLOCK_S:.2f}")
        return guide(controller, now_s)

    monkeypatch.setattr(Controller, "_guide", broken)
    return monkeypatch


@pytest.fixture
def failed(tmp_path: Path) -> tuple[Path, int]:
    """The record of a flight whose controller raised while it followed, and how many steps it has; needs `breaks`."""
    config = SCENARIO.config(PLACE)
    record = FlightRecord(tmp_path, config, OUR_CLOCK_S, 0)
    loop = Loop(
        PLACE, AUTOPILOTS["ardupilot"], config, TrueEyes(PLACE), wait_s=WAIT_S, mode="GUIDED", recorder=record.add
    )
    with pytest.raises(StepError, match="the controller raised ValueError: math domain error") as raised:
        loop.run(12.0, Operator(SCENARIO).act)
    assert loop.mode == "following"
    assert isinstance(raised.value.__cause__, ValueError)
    assert pickle.loads(pickle.dumps(raised.value)).failed == raised.value.failed  # noqa: S301 - our own
    record.add_failed(raised.value.failed)
    last_words = loop.follower.farewell(BREAKS_S)
    assert message_id(last_words[-1]) == STATUSTEXT
    record.add_farewell(BREAKS_S, last_words)
    record.close()
    return tmp_path, len(loop.moments) + 1


@pytest.mark.usefixtures("breaks")
def test_the_step_in_which_the_controller_raised_is_decided_again_to_the_same_exception_and_end(
    failed: tuple[Path, int], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, count = failed
    assert cli.main(["replay", str(folder)]) == 0
    said = f"{count} steps, all equal; in the last one the controller raised ValueError: math domain error at 9.00\n"
    assert capsys.readouterr().out == said


def test_a_controller_that_was_mended_differs_in_the_step_that_failed(
    breaks: pytest.MonkeyPatch, failed: tuple[Path, int]
) -> None:
    breaks.undo()
    folder, count = failed
    assert replay(folder).difference == Difference(
        count, BREAKS_S - OUR_CLOCK_S, "exception", "ValueError: math domain error at 9.00", "none"
    )


def test_a_controller_that_raises_only_now_is_a_difference_and_no_traceback(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Controller, now_s: float) -> Any:
        raise KeyError(now_s)

    monkeypatch.setattr(Controller, "_guide", broken)
    found = replay(copy).difference
    assert found is not None
    assert (found.step, found.field, found.recorded) == (1, "exception", "none")
    assert found.replayed.startswith("KeyError: ")


class Thing:
    """Whose text has its address in it."""


def test_an_exception_that_names_an_object_is_the_same_wherever_that_lay(
    copy: Path, monkeypatch: pytest.MonkeyPatch, flown: tuple[Path, list[Step]]
) -> None:
    things, calls = [Thing() for _ in range(3)], count()
    guide = Controller._guide

    def broken(controller: Controller, now_s: float) -> Any:
        if now_s >= flown[1][5].inputs.now_s:
            raise KeyError(things[next(calls)], "twice", now_s)
        return guide(controller, now_s)

    monkeypatch.setattr(Controller, "_guide", broken)
    found = replay(copy).difference
    assert found is not None
    assert (found.step, found.recorded) == (6, "none")
    assert " at 0x" in found.replayed

    def fail(line: dict[str, Any]) -> None:
        del line["output"]
        line["raised"] = found.replayed

    changed(copy, 5, fail)
    lines = (copy / CONTROL).read_bytes().splitlines(keepends=True)
    (copy / CONTROL).write_bytes(b"".join(lines[:6]))
    result = replay(copy)
    assert (result.steps, result.difference) == (6, None)
    assert result.raised != found.replayed  # as it was raised now
    changed(copy, 5, lambda line: line.update(raised=found.replayed.replace("twice", "once")))
    assert replay(copy).difference is not None


def test_a_step_that_failed_whose_inputs_were_not_recorded_is_not_decided_again(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (copy / CONTROL).read_bytes().splitlines(keepends=True)
    (copy / CONTROL).write_bytes(b"".join([*lines[:5], line_of({"raised": "TypeError: x"}), lines[-1]]))
    assert cli.main(["replay", str(copy)]) == 1
    said = "5 steps, all equal; the next 1 were not recorded: what follows is unknown\n"
    assert capsys.readouterr().out == said
