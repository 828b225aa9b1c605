import csv
import io
import json
import math
import pickle
import platform
import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from mscf import Box
from mscf.errors import OutputError
from mscf.recording import VideoFile
from sim.report import (
    FILM,
    PAGE,
    PLOTS,
    POSTER,
    TRACE,
    VERDICT,
    Run,
    environment,
    index_page,
    key_figures,
    prepare_folder,
    run_page,
    trace_csv,
    verdict_json,
    write_index,
    write_run,
)
from sim.scenarios import SCENARIOS, Act, Check, Verdict
from sim.trace import Moment, Trace
from sim.world import Pose

NAN = math.nan
NASTY = "<script>alert('\"&')</script>"
MOMENT = Moment(
    time_s=0.0,
    mode="following",
    flight_mode="GUIDED",
    is_armed=True,
    pose=Pose((1.0, 2.0, -14.0), yaw_rad=0.5),
    velocity_ned_mps=(4.0, 0.0, 0.0),
    target_ned_m=(21.0, 2.0, 0.0),
    box=Box(300, 200, 60, 40),
    truth=Box(300, 200, 60, 40),
    visible_share=1.0,
    status="tracking",
    confidence=0.9,
    threat=0.2,
    frame_age_s=0.04,
    setpoint_ned_mps=(4.0, 0.5, 0.0),
    yaw_rate_radps=0.1,
    range_m=20.0,
)
BARE = replace(
    MOMENT,
    time_s=1.0,
    mode="",
    box=None,
    truth=None,
    frame_age_s=None,
    setpoint_ned_mps=None,
    yaw_rate_radps=None,
    range_m=None,
    target_ned_m=(NAN, NAN, NAN),
    texts=("Target lost: holding",),
)
CHECKS = (
    Check("nearest", "m", lambda _: 19.9, least=8),
    Check("bearing error, 95 %", "deg", lambda _: 12.5, most=8),
    Check("share", "", lambda _: 0.5, least=0.25, most=0.75),
    Check("no flight at all", "m", lambda _: NAN, least=1),
)
GOOD, BAD = (
    Verdict(name, is_passed=is_good, value=1.0, least=1.0, most=math.inf, unit="")
    for name, is_good in (("a", True), ("b", False))
)
CASES = [(19.9, 8, None, True), (12.5, None, 8, False), (0.5, 0.25, 0.75, True), (None, 1, None, False)]


def run_of(
    checks: Sequence[Check] = CHECKS[:1], moments: Sequence[Moment] = (MOMENT, BARE), autopilot: str = "ardupilot"
) -> Run:
    trace = Trace(tuple(moments))
    return Run(
        "long_occlusion",
        "a car stops under a viaduct",
        autopilot,
        "virtual time",
        "mscf-companion sim long_occlusion",
        3,
        trace,
        tuple(check.judge(trace) for check in checks),
        (Act(0.5, "unplugged", lambda _: None),),
        {"step_late_p99_ms": 1.25, "overruns": 0, "frames_dropped": None},
    )


class Page(HTMLParser):
    """Tags of a page, its links and its text; every tag that opens must close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.rows = 0
        self.words: list[str] = []
        self.tags: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.rows += tag == "tr"
        self.links += [value or "" for name, value in attrs if name in {"href", "src", "poster"}]
        if tag not in {"meta", "img", "br"}:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


def write_film(folder: Path) -> None:
    with VideoFile(folder / FILM, 20) as video:
        for level in (0, 100, 200):
            video.write(np.full((64, 96, 3), level, np.uint8))


# ------------------------------------------------------------------------------------------------ the verdict
def test_the_verdict_says_what_the_checks_said_in_numbers() -> None:
    run = run_of(CHECKS)
    content = json.loads(verdict_json(run))
    assert content["passed"] is False
    assert len(content["checks"]) == len(CHECKS)
    for entry, check, verdict, (figure, least, most, passed) in zip(
        content["checks"], CHECKS, run.verdicts, CASES, strict=True
    ):
        assert entry["name"] == check.name
        assert entry["passed"] is passed is verdict.is_passed
        assert (entry["figure"], entry["at_least"], entry["at_most"]) == (figure, least, most)
        assert (entry["measured"], entry["wanted"]) == (verdict.measured, verdict.wanted)


def test_the_verdict_is_strict_json_whatever_is_not_known() -> None:
    run = replace(run_of(CHECKS), facts={"a": NAN, "b": None, "c": math.inf, "d": NASTY, "e": 2.5})

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    content = json.loads(verdict_json(run), parse_constant=refuse)
    assert content["facts"] == {"a": None, "b": None, "c": None, "d": NASTY, "e": 2.5}


def test_the_verdict_tells_the_circumstances_and_nothing_that_names_the_machine() -> None:
    content = json.loads(verdict_json(run_of()))
    assert content["command"] == "mscf-companion sim long_occlusion"
    assert (content["seed"], content["duration_s"], content["kind"]) == (3, 1.0, "virtual time")
    assert content["environment"] == environment()
    assert {"python", "numpy", "opencv", "architecture", "cores", "mscf-companion"} <= set(environment())
    assert platform.node() not in {str(value) for value in environment().values()}


@pytest.mark.parametrize(
    ("verdicts", "is_passed"),
    [
        ((), False),
        ((GOOD,), True),
        ((GOOD, BAD), False),
    ],
)
def test_a_run_passes_if_all_its_checks_do_and_it_has_some(verdicts: tuple[Verdict, ...], *, is_passed: bool) -> None:
    run = replace(run_of(), verdicts=verdicts)
    assert run.is_passed is is_passed
    assert json.loads(verdict_json(run))["passed"] is is_passed
    text = Page(run_page(run, [])).text
    assert ("PASSED" in text, "FAILED" in text) == (is_passed, not is_passed)


def test_a_run_of_any_scenario_can_be_handed_to_another_process() -> None:
    for scenario in SCENARIOS.values():
        run = replace(run_of(CHECKS[:3], (MOMENT,)), acts=scenario.acts)  # NaN equals nothing
        assert pickle.loads(pickle.dumps(run)) == run  # noqa: S301 - our own
        assert [(act.time_s, act.name) for act in run.acts] == [(act.time_s, act.name) for act in scenario.acts]


# ------------------------------------------------------------------------------------------------ the trace
def test_the_trace_has_a_row_a_moment_and_empty_cells_for_what_is_not_known() -> None:
    known, bare = csv.DictReader(io.StringIO(trace_csv(run_of().trace)))
    assert float(known["target_north_m"]) == 21.0
    assert float(known["vehicle_down_m"]) == -14.0
    assert float(known["setpoint_east_mps"]) == 0.5
    assert float(known["box_w_px"]) == 60.0
    assert float(known["bearing_error_rad"]) == pytest.approx(-0.5)
    assert float(known["iou"]) == 1.0
    assert bare["texts"] == "Target lost: holding"
    for name in ("box_x_px", "true_box_h_px", "iou", "frame_age_s", "setpoint_north_mps", "range_m", "true_range_m"):
        assert bare[name] == ""
    assert set(known) == set(bare)


def test_the_trace_of_nothing_is_a_header() -> None:
    assert trace_csv(Trace(())).count("\n") == 1


# ------------------------------------------------------------------------------------------------ the page
def test_the_page_shows_every_check_with_what_was_measured_and_wanted() -> None:
    run = run_of(CHECKS)
    text = Page(run_page(run, [])).text
    for verdict in run.verdicts:
        assert verdict.name in text
        assert verdict.wanted in text
        assert verdict.measured in text
    assert "no figure" in text
    assert text.count("✓") == 2
    assert text.count("✗") == 2


def test_what_a_flight_was_too_short_for_is_not_reached_and_failed() -> None:
    run = run_of((Check("late", "m", lambda _: 1.0, least=0, start_s=1.5), *CHECKS[:1]))
    assert not run.is_passed
    text = Page(run_page(run, [])).text
    assert "not reached: begins at 1.5 s" in text
    assert "1 of 2 checks passed" in text
    late = json.loads(verdict_json(run))["checks"][0]
    assert (late["passed"], late["figure"], late["measured"]) == (False, None, "not reached: begins at 1.5 s")
    assert run_of((Check("just", "m", lambda _: 1.0, least=0, start_s=1.0),)).is_passed


def test_no_check_of_any_scenario_claims_or_breaks_on_what_was_not_flown() -> None:
    short = Trace(tuple(replace(MOMENT, time_s=k / 20) for k in range(5)))
    for scenario in SCENARIOS.values():
        for check in scenario.checks:
            verdict = check.judge(short)
            assert (verdict.unreached_s is not None) is (check.start_s > 0), check.name
            assert "nan" not in verdict.measured


def test_the_last_words_stand_in_the_log_at_their_time() -> None:
    run = replace(run_of(), last_words=((0.7, "Follow ended: <told>"),))
    page = run_page(run, [])
    assert "Follow ended: &lt;told&gt;" in page
    assert page.index("unplugged") < page.index("Follow ended") < page.index("Target lost")


def test_half_a_character_of_a_record_makes_a_page(tmp_path: Path) -> None:
    prepare_folder(tmp_path)
    write_run(run_of(moments=(replace(MOMENT, texts=("half \udc80",)), BARE)), tmp_path)
    assert "half ?" in (tmp_path / PAGE).read_text()


def test_the_page_has_the_operators_log_the_acts_and_the_facts() -> None:
    page = run_page(run_of(moments=(replace(MOMENT, texts=("Following",)), BARE)), [])
    text = Page(page).text
    for words in ("Target lost: holding", "unplugged", "step late p99 ms", "1.25", "not known", "A car stops under"):
        assert words in text
    assert page.index("Following<") < page.index("unplugged") < page.index("Target lost: holding")


def test_no_text_becomes_markup() -> None:
    nasty = replace(MOMENT, mode=NASTY, texts=(NASTY,), notes=(NASTY,))
    verdict = replace(BAD, name=NASTY, unit=NASTY)
    run = replace(
        run_of(moments=(nasty, replace(nasty, time_s=1.0))),
        scenario=NASTY,
        description=NASTY,
        autopilot=NASTY,
        command=NASTY,
        verdicts=(verdict,),
        acts=(Act(0.1, NASTY, lambda _: None),),
        facts={NASTY: NASTY},
    )
    for text in (run_page(run, [NASTY]), index_page([run])):
        page = Page(text)
        assert "script" not in page.tags
        assert "<script>alert" in page.text.lower()


def test_the_page_needs_nothing_from_elsewhere_and_every_link_leads_to_a_file(tmp_path: Path) -> None:
    write_film(tmp_path)
    (tmp_path / "application.log").write_text("a line")
    write_run(run_of(), tmp_path)
    text = (tmp_path / PAGE).read_text()
    assert not re.search(r"https?:|//|@import|url\(", text)
    links = Page(text).links
    assert {FILM, POSTER, PLOTS, VERDICT, TRACE, "application.log"} <= set(links)
    for link in links:
        assert (tmp_path / link).is_file()


def test_a_run_without_a_film_says_so(tmp_path: Path) -> None:
    write_run(run_of(), tmp_path)
    page = Page((tmp_path / PAGE).read_text())
    assert "video" not in page.tags
    assert "No film" in page.text


def test_missing_values_and_no_moments_make_a_page() -> None:
    for moments in ((), (BARE,), (BARE, replace(BARE, time_s=2.0))):
        assert "Checks" in Page(run_page(run_of(CHECKS, moments), [])).text


def test_the_same_run_gives_the_same_page() -> None:
    assert run_page(run_of(CHECKS), [PLOTS]) == run_page(run_of(CHECKS), [PLOTS])


# ------------------------------------------------------------------------------------------------ files
def test_a_run_is_written_whole_and_nothing_else_is_left(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "folder"
    prepare_folder(folder)
    assert not list(folder.iterdir())
    write_film(folder)
    write_run(run_of(), folder)
    assert {path.name for path in folder.iterdir()} == {FILM, POSTER, PLOTS, VERDICT, TRACE, PAGE}
    assert json.loads((folder / VERDICT).read_text())["passed"] is True
    assert (folder / TRACE).read_text() == trace_csv(run_of().trace)
    for name, shape in ((POSTER, (64, 96, 3)), (PLOTS, (1320, 1100, 3))):
        picture = cv2.imread(str(folder / name))
        assert picture is not None
        assert picture.shape == shape
    poster = cv2.imread(str(folder / POSTER))
    assert poster is not None
    assert abs(poster.mean() - 100) < 10  # the middle one of the three pictures


def test_a_folder_that_is_made_ready_keeps_nothing_of_the_last_report_but_what_is_not_of_it(tmp_path: Path) -> None:
    write_film(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    write_run(run_of(), tmp_path)
    prepare_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_folder_that_cannot_be_written_is_one_line_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    folder = tmp_path / "taken" / "out"
    for write in (prepare_folder, lambda place: write_run(run_of(), place), lambda place: write_index([], place)):
        with pytest.raises(OutputError, match=r"taken.* cannot be written: .*; give another folder") as raised:
            write(folder)
        assert "\n" not in str(raised.value)


def test_a_file_that_cannot_be_replaced_leaves_no_part_of_itself(tmp_path: Path) -> None:
    (tmp_path / PAGE).mkdir()
    with pytest.raises(OutputError, match=PAGE):
        write_index([run_of()], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [PAGE]


# ------------------------------------------------------------------------------------------------ the index
def test_the_index_has_a_row_a_run_that_leads_to_its_page(tmp_path: Path) -> None:
    runs = [run_of(), run_of(CHECKS, autopilot="px4")]
    for run in runs:
        write_run(run, tmp_path / run.folder_name)
    write_index(runs, tmp_path)
    page = Page((tmp_path / PAGE).read_text())
    assert page.rows == 1 + len(runs)
    assert page.links == [f"long_occlusion-{name}/{PAGE}" for name in ("ardupilot", "px4")]
    for link in page.links:
        assert (tmp_path / link).is_file()
    for words in ("1 of 2 passed", "FAILED", "bearing error, 95 %: 12.5 deg", "no flight at all: no figure", "2 of 4"):
        assert words in page.text


def test_an_index_is_passed_if_all_runs_are() -> None:
    assert "PASSED" in Page(index_page([run_of(), run_of()])).text
    assert "FAILED" in Page(index_page([])).text


def test_runs_that_differ_have_folders_that_do() -> None:
    run = run_of()
    names = [
        other.folder_name
        for other in (
            run,
            replace(run, autopilot="px4"),
            replace(run, kind="real time"),
            replace(run, kind="external"),
            replace(run, scenario="straight"),
        )
    ]
    assert len(set(names)) == len(names)
    assert replace(run, autopilot="../ArduCopter 4.7").folder_name == "long_occlusion-arducopter-4-7"


def test_key_figures_are_of_the_time_in_which_it_follows() -> None:
    away = replace(MOMENT, mode="lost", pose=Pose((11.0, 2.0, -14.0), yaw_rad=3.0))
    figures = key_figures(Trace((MOMENT, MOMENT, MOMENT, away)))
    assert figures == {"following": "75 %", "bearing error, 95 %": f"{math.degrees(0.5):.1f}°", "nearest": "10.0 m"}
    assert key_figures(Trace((BARE,))) == {"following": "0 %", "bearing error, 95 %": "-", "nearest": "-"}
