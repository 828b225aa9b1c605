import argparse
import csv
import io
import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.config import parse
from companion.engagement import Reason
from companion.errors import UsageError
from companion.flight_record import ABOUT, CONFIG, CONTROL, TLOG, VIDEO, FlightRecord, line_of
from companion.follower import FailedStep, Follower
from mscf.errors import OutputError
from mscf.recording import LiveVideoFile
from sim.eyes import TrueEyes
from sim.flight_report import add_command, run_of, write_report
from sim.loop import OUR_CLOCK_S
from sim.report import FILM, PAGE, PLOTS, POSTER, TRACE, VERDICT
from sim.scenarios import SCENARIOS, fly
from sim.stages import stage
from sim.trace import Trace

SCENARIO = replace(SCENARIOS["straight"], duration_s=9.0)
COMMAND = "mscf-companion report flight"


def recorded(folder: Path, autopilot: str) -> Trace:
    """Record a flight; what really happened."""
    record = FlightRecord(folder, SCENARIO.config(stage(SCENARIO.stage, 7)), OUR_CLOCK_S, 1_767_225_600_000_000)
    trace, _ = fly(SCENARIO, autopilot, TrueEyes, recorder=record.add)
    record.add_farewell(OUR_CLOCK_S + 9.0, ())
    record.close()
    return trace


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trace]:
    """The record of a flight with a film, and what really happened."""
    folder = tmp_path_factory.mktemp("flight")
    trace = recorded(folder, "ardupilot")
    with LiveVideoFile(folder / VIDEO, 10) as video:
        for k in range(5):
            video.write(np.full((48, 64, 3), 50 * k, np.uint8), k / 10)
    return folder, trace


class Page(HTMLParser):
    """Links and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.text = ""
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links += [value or "" for name, value in attrs if name in {"href", "src", "poster"}]

    def handle_data(self, data: str) -> None:
        self.text += data + " "


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_moment_is_what_the_application_knew(tmp_path: Path, autopilot: str) -> None:
    truth = recorded(tmp_path, autopilot)
    run = run_of(tmp_path, COMMAND)
    assert run.autopilot == autopilot
    assert len(run.trace.moments) == len(truth.moments)
    for moment, true in zip(run.trace.moments, truth.moments, strict=True):
        assert moment.time_s == pytest.approx(true.time_s)
        for name in ("mode", "box", "status", "setpoint_ned_mps", "yaw_rate_radps", "range_m", "notes"):
            assert getattr(moment, name) == getattr(true, name), name
        has_frame = true.frame_age_s is not None
        assert moment.confidence == true.confidence if has_frame else math.isnan(moment.confidence)
        assert set(true.texts) <= set(moment.texts)
    late = [pair for pair in zip(run.trace.moments, truth.moments, strict=True) if pair[1].time_s > 2]
    for moment, true in late:
        assert moment.is_armed
        assert moment.pose.pos_ned_m == pytest.approx(true.pose.pos_ned_m, abs=1.0)
        assert moment.pose.yaw_rad == pytest.approx(true.pose.yaw_rad, abs=0.05)
        assert moment.velocity_ned_mps == pytest.approx(true.velocity_ned_mps, abs=0.5)
    assert any(moment.mode == "following" for moment, _ in late)


def test_what_only_a_simulator_knows_is_not_claimed(flown: tuple[Path, Trace]) -> None:
    run = run_of(flown[0], COMMAND)
    assert not run.verdicts
    for moment in run.trace.moments:
        assert (moment.truth, moment.iou) == (None, None)
        unknown = (moment.visible_share, moment.true_range_m, moment.bearing_error_rad)
        assert all(math.isnan(value) for value in unknown)


def test_the_page_is_neutral_and_every_link_leads_to_a_file(flown: tuple[Path, Trace], tmp_path: Path) -> None:
    write_report(flown[0], tmp_path, COMMAND)
    assert {path.name for path in tmp_path.iterdir()} == {PAGE, PLOTS, TRACE, FILM, POSTER}
    text = (tmp_path / PAGE).read_text()
    page = Page(text)
    for word in ("PASSED", "FAILED", "Checks", "proven", "seed", "true"):
        assert word not in page.text
    assert 'class="verdict' not in text
    for words in ("recorded", "application ended", "Following", "2026-01-01", COMMAND, "pymavlink", "steps missing"):
        assert words in page.text
    assert "video" in page.tags
    assert not re.search(r"https?:|//|@import|url\(", text)
    for link in page.links:
        assert (tmp_path / link).is_file()


def test_no_film_of_another_flight_is_shown(flown: tuple[Path, Trace], tmp_path: Path) -> None:
    for path in flown[0].iterdir():
        if path.name != VIDEO:
            (tmp_path / path.name).write_bytes(path.read_bytes())
    write_report(flown[0], tmp_path / "out", COMMAND)
    write_report(tmp_path, tmp_path / "out", COMMAND)
    assert "No film was made" in Page((tmp_path / "out" / PAGE).read_text()).text


def test_beside_the_record_the_page_lists_its_files(flown: tuple[Path, Trace]) -> None:
    folder = flown[0]
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    write_report(folder, folder, COMMAND)
    assert {ABOUT, CONFIG, CONTROL, TLOG, VIDEO} <= set(Page((folder / PAGE).read_text()).links)
    for name in (ABOUT, CONFIG, CONTROL, TLOG, VIDEO):
        assert (folder / name).read_bytes() == before[name]


def test_the_trace_has_no_columns_that_nobody_can_fill(flown: tuple[Path, Trace], tmp_path: Path) -> None:
    write_report(flown[0], tmp_path, COMMAND)
    rows = list(csv.DictReader(io.StringIO((tmp_path / TRACE).read_text())))
    assert len(rows) == len(flown[1].moments)
    names = set(rows[0])
    assert {"time_s", "vehicle_north_m", "box_w_px", "range_m", "setpoint_north_mps", "texts"} <= names
    assert not any("true" in name or "target" in name or name in {"iou", "visible_share"} for name in names)


def test_a_flight_of_which_nothing_was_heard_or_seen_makes_a_page(tmp_path: Path) -> None:
    config = parse("[camera]\nfocal_px = 900\n")
    follower, record = Follower(config), FlightRecord(tmp_path, config, 0.0, 0)
    record.add(follower.step(0.0, b"", None))
    record.add_gap(4)
    record.add(follower.step(0.3, b"", None))
    record.close()
    with (tmp_path / CONTROL).open("ab") as file:
        file.write(b'{"inputs":{"is":"Contr')  # killed
    write_report(tmp_path, tmp_path, COMMAND)
    page = Page((tmp_path / PAGE).read_text())
    for words in ("no autopilot heard", "4 steps not recorded", "No film was made"):
        assert words in page.text


def test_no_text_of_a_record_becomes_markup(flown: tuple[Path, Trace], tmp_path: Path) -> None:
    for path in flown[0].iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    nasty = "<script>alert(1)</script>"
    about = json.loads((tmp_path / ABOUT).read_text())
    (tmp_path / ABOUT).write_text(json.dumps(about | {"start_utc": nasty, "python": nasty}))
    step = json.loads((tmp_path / CONTROL).read_text().splitlines()[0])
    with (tmp_path / CONTROL).open("a") as file:
        file.write(json.dumps(step | {"texts": [nasty]}) + "\n")
    write_report(tmp_path, tmp_path, nasty)
    assert "script" not in Page((tmp_path / PAGE).read_text()).tags


# ------------------------------------------------------------------------------------------------ the command
@pytest.fixture
def command() -> Callable[..., int]:
    def run(*words: str) -> int:
        parser = argparse.ArgumentParser()
        add_command(parser.add_subparsers())
        arguments: Any = parser.parse_args(["report", *words])
        return int(arguments.run(arguments))

    return run


def test_the_command_says_where_the_page_is(
    command: Callable[..., int], flown: tuple[Path, Trace], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(str(flown[0]), "--out", str(tmp_path / "deep" / "out")) == 0
    assert capsys.readouterr().out == f"page      {tmp_path / 'deep' / 'out' / PAGE}\n"
    assert (tmp_path / "deep" / "out" / PAGE).is_file()
    assert command(str(flown[0])) == 0
    assert capsys.readouterr().out == f"page      {flown[0] / PAGE}\n"


def test_what_is_no_flight_is_said_in_one_line(command: Callable[..., int], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is no flight record"):
        command(str(tmp_path))
    FlightRecord(tmp_path, parse("[camera]\nfocal_px = 900\n"), 0.0, 0).close()
    with pytest.raises(UsageError, match="holds no step of a flight"):
        command(str(tmp_path))


def test_the_report_of_a_run_in_the_simulator_is_not_replaced(
    command: Callable[..., int], flown: tuple[Path, Trace], tmp_path: Path
) -> None:
    (tmp_path / VERDICT).write_text("{}")
    with pytest.raises(UsageError, match="holds the report of a run in the simulator: give another folder"):
        command(str(flown[0]), "--out", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == [VERDICT]


def test_a_place_that_cannot_be_written_is_named(
    command: Callable[..., int], flown: tuple[Path, Trace], tmp_path: Path
) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OutputError, match=r"taken.* cannot be written"):
        command(str(flown[0]), "--out", str(tmp_path / "taken"))


@pytest.mark.parametrize("name", [ABOUT, FILM])
def test_another_flight_and_a_film_of_somebody_are_not_written_over(
    flown: tuple[Path, Trace], tmp_path: Path, name: str
) -> None:
    (tmp_path / name).write_bytes(b"mine")
    with pytest.raises(UsageError, match="give another folder with --out"):
        write_report(flown[0], tmp_path, COMMAND)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [(name, b"mine")]


def test_a_record_without_an_end_is_said_to_break_off(flown: tuple[Path, Trace], tmp_path: Path) -> None:
    assert [act.name for act in run_of(flown[0], COMMAND).acts] == ["application ended"]
    for name in (ABOUT, CONFIG, TLOG):
        (tmp_path / name).write_bytes((flown[0] / name).read_bytes())
    lines = (flown[0] / CONTROL).read_bytes().splitlines(keepends=True)
    (tmp_path / CONTROL).write_bytes(b"".join(lines[:-1]))
    assert [act.name for act in run_of(tmp_path, COMMAND).acts] == ["the record breaks off"]


# ------------------------------------------------------------------------------------------------ what is damaged
def _output_of_nobody(line: dict[str, Any]) -> None:
    line["output"] = {"is": "Plan", "steps": []}


def _unknown_mode(line: dict[str, Any]) -> None:
    line["output"]["mode"]["name"] = "$\\frac"


def _list_for_a_mode(line: dict[str, Any]) -> None:
    line["output"]["mode"] = []


def _word_for_a_range(line: dict[str, Any]) -> None:
    line["output"]["target"] = {"fix": {"range_m": "far"}}


def _list_for_a_setpoint(line: dict[str, Any]) -> None:
    line["output"]["setpoint"] = [1, 2]


def _short_velocity(line: dict[str, Any]) -> None:
    line["output"]["setpoint"] = {"velocity_ned_mps": [1.0, 2.0], "yaw_rate_radps": 0.0}


def _monstrous_rate(line: dict[str, Any]) -> None:
    line["output"]["setpoint"] = {"velocity_ned_mps": [1.0, 2.0, 3.0], "yaw_rate_radps": 10**400}


def _number_for_notes(line: dict[str, Any]) -> None:
    line["output"]["notes"] = 3


def _no_time(line: dict[str, Any]) -> None:
    line["inputs"]["now_s"] = {"is": "float", "name": "nan"}


@pytest.mark.parametrize(
    "spoil",
    [
        _output_of_nobody,
        _unknown_mode,
        _list_for_a_mode,
        _word_for_a_range,
        _list_for_a_setpoint,
        _short_velocity,
        _monstrous_rate,
        _number_for_notes,
        _no_time,
        None,  # a line that is cut in the middle
    ],
)
def test_a_damaged_line_is_left_out_and_said_on_the_page_and_the_rest_is_shown(
    flown: tuple[Path, Trace], tmp_path: Path, spoil: Callable[[dict[str, Any]], None] | None
) -> None:
    for name in (ABOUT, CONFIG):
        (tmp_path / name).write_bytes((flown[0] / name).read_bytes())
    lines = (flown[0] / CONTROL).read_bytes().splitlines(keepends=True)
    if spoil is None:
        lines[50] = lines[50][:100] + b"\n"
    else:
        content = json.loads(lines[50])
        spoil(content)
        lines[50] = line_of(content)
    (tmp_path / CONTROL).write_bytes(b"".join(lines))
    run = run_of(tmp_path, COMMAND)
    times_s = [moment.time_s for moment in run.trace.moments]
    assert times_s == [moment.time_s for k, moment in enumerate(run_of(flown[0], COMMAND).trace.moments) if k != 50]
    assert "line 51 is damaged, or of another version" in str(run.facts["damage"])
    assert [act.name for act in run.acts] == ["the record is damaged: see below", "application ended"]
    assert 49 / 20 - 1e-6 < run.acts[0].time_s < 50 / 20 + 1e-6  # that of the line, where it can be read


def test_a_damaged_record_makes_a_page_and_one_line_and_one_without_a_good_step_only_the_line(
    command: Callable[..., int], flown: tuple[Path, Trace], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (ABOUT, CONFIG):
        (tmp_path / name).write_bytes((flown[0] / name).read_bytes())
    lines = (flown[0] / CONTROL).read_bytes().splitlines(keepends=True)
    (tmp_path / CONTROL).write_bytes(b"".join([*lines[:20], b"{}\n", b"[]\n", *lines[22:]]))
    assert command(str(tmp_path)) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "lines left out: 2, the first: " in line
    assert "line 21 is damaged" in line
    page = Page((tmp_path / PAGE).read_text())
    assert "the record is damaged" in page.text
    assert "line 21 is damaged" in page.text
    (tmp_path / CONTROL).write_bytes(b"{}\n")
    with pytest.raises(UsageError, match=r"line 1 is damaged") as raised:
        command(str(tmp_path))
    assert "\n" not in str(raised.value)


# ------------------------------------------------------------------------------------------------ how it ended
def test_the_last_words_are_among_the_texts_at_their_time(tmp_path: Path) -> None:
    record = FlightRecord(tmp_path, SCENARIO.config(stage(SCENARIO.stage, 7)), OUR_CLOCK_S, 0)
    fly(SCENARIO, "ardupilot", TrueEyes, recorder=record.add, farewell=record.add_farewell)
    record.close()
    run = run_of(tmp_path, COMMAND)
    ((time_s, text),) = run.last_words
    assert time_s == pytest.approx(SCENARIO.duration_s)
    assert text == f"Follow ended: {Reason.SHUTDOWN.value}"
    write_report(tmp_path, tmp_path, COMMAND)
    assert text in Page((tmp_path / PAGE).read_text()).text


def test_what_the_controller_raised_is_said(tmp_path: Path) -> None:
    config = parse("[camera]\nfocal_px = 900\n")
    record, step = FlightRecord(tmp_path, config, 0.0, 0), Follower(config).step(0.0, b"", None)
    record.add(step)
    record.add_failed(FailedStep(replace(step.inputs, now_s=0.05), (), "ValueError: <a mistake>"))
    record.add_farewell(0.06, ())
    record.close()
    acts = [(act.time_s, act.name) for act in run_of(tmp_path, COMMAND).acts]
    assert acts == [(0.05, "the controller raised ValueError: <a mistake>"), (0.06, "application ended")]


def test_the_folder_above_a_record_is_answered_with_the_record(
    command: Callable[..., int], flown: tuple[Path, Trace], tmp_path: Path
) -> None:
    shutil.copytree(flown[0], tmp_path / "flights" / "one")
    with pytest.raises(UsageError, match=f"give a record below it: {tmp_path / 'flights' / 'one'}$"):
        command(str(tmp_path))
