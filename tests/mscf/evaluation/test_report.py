"""Reports, from records made by hand: what the figures are, and that every file shows them."""

import csv
import io
import json
import math
import re
import sys
from collections.abc import Sequence as Rows
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from mscf.errors import ConfigError, OutputError, SourceError
from mscf.evaluation.datasets import Sequence
from mscf.evaluation.metrics import errors_of, score
from mscf.evaluation.record import Record, Run
from mscf.evaluation.report import print_table, write_report
from mscf.evaluation.report.curves import draw_plots, ranked
from mscf.evaluation.report.page import evaluation_page
from mscf.evaluation.report.palette import COLORS, DASHES, MARKERS, Stroke
from mscf.evaluation.report.strips import FRAMES, STRIPS, draw_strips, most_telling, spread_frames, view_of
from mscf.evaluation.report.summary import places, summarize
from mscf.evaluation.report.table import CSV_HEAD, markdown, overall, results_json, sequences_csv
from mscf.evaluation.statistics import sequence_values
from mscf.geometry import Box
from mscf.html_page import html_page

TRUE = Box(40, 30, 20, 10)
ORDER = ("ours", "theirs", "pack:Their_Own")


def run(shift_px: float, *, first: int = 0, frames: int = 4, ms: float = 10.0, lost: int = 0, fault: str = "") -> Run:
    """A run beside the true box, which stays where it is; the last `lost` frames are said to be lost."""
    boxes = (TRUE,) + (Box(TRUE.x + shift_px, TRUE.y, TRUE.w, TRUE.h),) * (frames - 1)
    is_lost = (False,) * (frames - lost) + (True,) * lost
    return Run(first, boxes, is_lost, (ms,) * (frames - 1), errors_of(boxes, (TRUE,) * frames), fault)


def blind_run(frames: int = 4) -> Run:
    """A run over frames without truth."""
    boxes = (TRUE,) * frames
    return Run(0, boxes, (False,) * frames, (10.0,) * (frames - 1), errors_of(boxes, (None,) * frames))


def record(sequence: str, tracker: str, runs: Rows[Run], *attributes: str) -> Record:
    return Record(sequence, tracker, frozenset(attributes), tuple(runs))


def records(shifts_px: Rows[float] = (0, 5, 25), sequences: Rows[str] = ("bird", "car", "boat")) -> list[Record]:
    """One run a tracker of `ORDER` and sequence; farther off in later sequences, and for later trackers."""
    return [
        record(name, tracker, [run(shift * (1 + 0.2 * index))], "OCC", *(["FM"] if index else []))
        for index, name in enumerate(sequences)
        for tracker, shift in zip(ORDER, shifts_px, strict=True)
    ]


@pytest.fixture
def sequences(tmp_path: Path) -> tuple[Sequence, ...]:
    """Four black frames each, 160 x 120, for `records`."""
    folder = tmp_path / "data"
    folder.mkdir()
    paths = tuple(folder / f"{number}.png" for number in range(1, 5))
    for path in paths:
        cv2.imwrite(str(path), np.zeros((120, 160, 3), np.uint8))
    return tuple(Sequence(name, paths, (TRUE,) * 4) for name in ("bird", "car", "boat"))


# --- the figures ---


def test_means_are_over_the_runs_of_a_sequence_then_over_sequences() -> None:
    # precision of one run: 1 where it stays, 1/4 where it jumps away after the first frame
    bird = record("bird", "ours", [run(0), run(0), run(100)])
    car = record("car", "ours", [run(100)])
    row = summarize([bird, car], ["ours"]).rows[0]
    assert row.means["precision"].mean == pytest.approx(((1 + 1 + 0.25) / 3 + 0.25) / 2)
    assert row.means["precision"].count == 2
    assert (row.runs, row.updates) == (4, 12)


def test_figures_of_a_sequence_are_those_that_comparisons_use_though_a_run_saw_no_truth() -> None:
    own = [record("bird", "ours", [run(3), blind_run(), run(9)]), record("car", "ours", [blind_run()])]
    values = sequence_values(own, lambda one: score(one.errors).auc)
    cells = summarize(own, ["ours"]).cells
    assert cells["bird"]["ours"].score.auc == pytest.approx(values["bird"], abs=1e-12)
    assert np.isnan(cells["car"]["ours"].score.auc)


@pytest.mark.parametrize("extra", [[], [record("dark", tracker, [blind_run()]) for tracker in ORDER]])
def test_the_legends_figure_is_the_area_under_the_curve_that_is_drawn(extra: list[Record]) -> None:
    for row in summarize(records() + extra, ORDER).rows:
        assert row.success_curve.mean() == pytest.approx(row.means["auc"].mean)
        assert row.precision_curve[20] == pytest.approx(row.means["precision"].mean)


def test_a_sequence_that_one_tracker_lacks_counts_for_none_and_is_named() -> None:
    whole = records()
    summary = summarize([one for one in whole if (one.sequence, one.tracker) != ("car", "theirs")], ORDER)
    assert summary.counted == ("bird", "boat")
    rest = summarize([one for one in whole if one.sequence != "car"], ORDER)
    assert [row.means for row in summary.rows] == [row.means for row in rest.rows]
    text = markdown(summary, "T", [])
    assert "Not counted, as not every tracker has run them from the same starts: car." in text
    assert re.search(r"^\| car +\| [\d.]+ / .* \| - +\|", text, re.MULTILINE)


def test_a_sequence_that_trackers_ran_from_other_starts_counts_for_none() -> None:
    own = [record("bird", "ours", [run(0), run(0, first=2)]), record("bird", "theirs", [run(0)])]
    own += [record("car", tracker, [run(0)]) for tracker in ("ours", "theirs")]
    assert summarize(own, ["ours", "theirs"]).counted == ("car",)


def test_trackers_come_in_the_order_asked_for_without_those_not_asked_for_or_not_run() -> None:
    order = ["theirs", "none", "ours", "ours"]
    assert summarize(records(), order).trackers == ("theirs", "ours")
    out = io.StringIO()
    print_table(records(), order, out)
    assert "Without any result: none." in out.getvalue()


def test_updates_a_second_are_a_thousand_over_the_mean_of_all_updates() -> None:
    # 3 updates of 10 ms and 9 of 30 ms: 25 ms, where the mean of the sequences' means would be 20 ms
    own = [record("bird", "ours", [run(0, ms=10)]), record("car", "ours", [run(0, ms=30, frames=10)])]
    assert summarize(own, ["ours"]).rows[0].updates_per_s == pytest.approx(40)


def test_what_was_lost_and_what_was_raised_is_counted() -> None:
    own = [record("bird", "ours", [run(0, lost=2), run(0, lost=1, fault="E: x")]), record("car", "ours", [run(0)])]
    row = summarize(own, ["ours"]).rows[0]
    assert (row.lost, row.updates, row.runs) == (3, 9, 3)
    assert row.faults == {"E: x": 1}


def test_an_attribute_is_judged_on_the_sequences_that_have_it() -> None:
    summary = summarize(records(), ORDER)
    assert list(summary.attributes) == ["FM", "OCC"]
    assert summary.having["FM"] == ("boat", "car")
    some = summarize([one for one in records() if one.sequence != "bird"], ORDER)
    assert [row.means for row in summary.attributes["FM"]] == [row.means for row in some.rows]
    assert [row.means for row in summary.attributes["OCC"]] == [row.means for row in summary.rows]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0.1, 0.4, 0.3, 0.2], (0, 1, 2, 3)),
        ([0.4, 0.4, 0.3, 0.2], (1, 1, 3, 0)),
        ([0.4, 0.3, 0.3, 0.3, 0.1], (1, 2, 2, 2, 0)),
        ([0.4, float("nan"), 0.3], (1, 0, 2)),
        ([0.4], (0,)),
        ([float("nan"), 0.4], (0, 0)),
        ([], ()),
    ],
)
def test_the_best_three_share_a_place_where_they_are_equal(values: list[float], expected: tuple[int, ...]) -> None:
    assert places(values) == expected


# --- tables ---


def test_the_overall_table_has_mean_interval_and_place_of_each_tracker_in_the_order_given() -> None:
    summary = summarize(records(), ORDER)
    _, _, *lines = overall(summary)
    assert [line.split("|")[1].strip() for line in lines] == list(ORDER)
    for line, row, mark in zip(lines, summary.rows, "¹²³", strict=True):
        auc = row.means["auc"]
        assert f"{auc.mean:.3f} [{auc.low:.3f}, {auc.high:.3f}] {mark}" in line


def test_every_row_of_a_markdown_table_has_as_many_cells_as_its_head() -> None:
    own = [Record(f"a|{one.sequence}", one.tracker, one.attributes, one.runs) for one in records()]
    own.append(record("a|x", "ours", [run(0, fault="E: a|b\nc")]))
    text = markdown(summarize(own, ORDER), "T", [("b|c", "two\nlines")])
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(tables) == 4  # overall, by attribute, by sequence, skipped
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1
        assert len({len(line) for line in table.splitlines()}) == 1  # legible as text


def test_the_terminal_shows_the_overall_table() -> None:
    out = io.StringIO()
    print_table(records(), ORDER, out)
    assert out.getvalue().splitlines()[:5] == overall(summarize(records(), ORDER))
    assert "3 sequences, 9 runs of 3 trackers." in out.getvalue()


def test_the_csv_reads_back_to_the_last_bit_and_is_empty_where_nothing_is_known() -> None:
    own = [record("bird", "ours", [run(3), run(7)], "OCC", "FM"), record("car", "ours", [blind_run()])]
    rows = list(csv.DictReader(io.StringIO(sequences_csv(summarize(own, ["ours"])))))
    assert tuple(rows[0]) == CSV_HEAD
    assert float(rows[0]["auc"]) == np.mean([score(one.errors).auc for one in own[0].runs])
    assert (rows[0]["attributes"], rows[0]["runs"], rows[0]["update_ms"]) == ("FM OCC", "2", "10.0")
    assert rows[1]["auc"] == ""


def test_the_json_is_strict_and_says_null_where_nothing_is_known() -> None:
    own = [record("dark", "ours", [blind_run()])]
    text = results_json(summarize(own, ["ours"]), {"command": "mscf eval"}, [("x", "why")])
    content = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert content["evaluation"] == {"command": "mscf eval"}
    assert content["trackers"][0]["auc"] == {"mean": None, "low": None, "high": None, "count": 0}
    assert content["skipped"] == [{"sequence": "x", "why": "why"}]


# --- plots ---


def luminance(color: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.1)."""
    parts = np.array(list(bytes.fromhex(color[1:]))) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("color", COLORS)
def test_every_colour_stands_out_on_the_light_and_on_the_dark_page(color: str) -> None:
    grounds = re.findall(r"--page: (#\w+)", html_page("", ()))
    assert len(grounds) == 2
    for ground in grounds:
        full = ground if len(ground) == 7 else "#" + "".join(2 * digit for digit in ground[1:])
        light, dark = sorted([luminance(color), luminance(full)], reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 3  # WCAG 2.1, 1.4.11


def test_lines_differ_in_colour_and_in_gray() -> None:
    assert len({Stroke.of(index).color for index in range(len(COLORS))}) == len(COLORS)
    count = len(DASHES) * len(MARKERS)
    assert len({(Stroke.of(index).dash, Stroke.of(index).marker) for index in range(count)}) == count


def test_legends_are_ranked_and_lines_keep_their_tracker_in_every_plot() -> None:
    summary = summarize(records(shifts_px=(8, 2, 30)), ORDER)
    plots = draw_plots(summary, "tre")
    assert [plot.name for plot in plots] == ["precision", "success", "success FM", "success OCC"]
    assert ranked(summary.rows, "auc") == [1, 0, 2]
    for plot in plots[1:]:
        named = re.findall(r"\[(\d\.\d{3})\] ([^<]+)<", plot.svg)
        assert [name for _, name in named] == ["theirs", "ours", "pack:Their_Own"]
        assert [figure for figure, _ in named] == sorted((figure for figure, _ in named), reverse=True)
        drawn = [color for color in re.findall(r"stroke: (#\w{6})", plot.svg) if color in COLORS]
        best_first = [Stroke.of(index).color for index in (1, 0, 2)]
        assert drawn == best_first[::-1] + best_first  # the curves, the best on top; then the legend
        assert plot.png.startswith(b"\x89PNG")
    assert "Success plot of TRE: FM (2)" in plots[2].svg


def test_the_same_results_give_the_same_plots() -> None:
    assert draw_plots(summarize(records(), ORDER), "") == draw_plots(summarize(records(), ORDER), "")


def test_a_trackers_name_is_no_formula_and_no_secret() -> None:
    plots = draw_plots(summarize([record("bird", "_a$b$", [run(0)])], ["_a$b$"]), "")
    assert "] _a$b$<" in plots[1].svg


# --- strips ---


@pytest.mark.parametrize("count", [1, 2, 3, 6, 82, 2000])
def test_frames_are_spread_to_the_last_without_the_first(count: int) -> None:
    frames = spread_frames(count)
    assert len(frames) == min(count - 1, FRAMES)
    assert (0, *frames)[-1] == count - 1
    assert 0 not in frames
    gaps = np.diff((0, *frames))
    assert np.all(np.abs(gaps - (count - 1) / max(len(frames), 1)) < 1)


def test_the_sequences_shown_are_those_on_which_trackers_differ_most() -> None:
    names = [f"s{index}" for index in range(STRIPS + 2)]
    own = [
        record(name, tracker, [run(shift)])
        for index, name in enumerate(names)
        for tracker, shift in (("ours", 0), ("theirs", 1 + index))
    ]
    own += [record("dark", tracker, [blind_run()]) for tracker in ("ours", "theirs")]
    summary = summarize(own, ["ours", "theirs"])
    assert most_telling(summary, [*names, "dark"]) == tuple(reversed(names))[:STRIPS]
    assert most_telling(summary, ["s1", "other"]) == ("s1",)


def test_a_panel_shows_all_of_the_boxes_that_is_in_the_frame(rng: np.random.Generator) -> None:
    rows, cols = 120, 160
    for _ in range(200):
        xywh = rng.uniform((-80, -80, 1, 1), (200, 160, 90, 90), (int(rng.integers(1, 5)), 4))
        boxes = [Box(*map(float, values)) for values in xywh]
        y, x = view_of(boxes, boxes[0], (rows, cols))
        assert 0 <= y.start < y.stop <= rows
        assert 0 <= x.start < x.stop <= cols
        assert abs((y.stop - y.start) / rows - (x.stop - x.start) / cols) <= 1 / rows + 1 / cols
        for box in boxes:
            for edge, view, size in (
                (box.x, x, cols),
                (box.x + box.w, x, cols),
                (box.y, y, rows),
                (box.y + box.h, y, rows),
            ):
                assert view.start - 1 <= min(max(edge, 0), size) <= view.stop + 1


def test_boxes_are_drawn_where_they_are_in_the_trackers_colours(sequences: tuple[Sequence, ...]) -> None:
    own = records(shifts_px=(0, 25, 50))
    summary = summarize(own, ORDER)
    (strip,) = draw_strips(own, sequences, summary, [("bird", (3,))])
    height = round(strip.picture.shape[1] * 120 / 160)
    panel = strip.picture[:height]
    boxes = [Box(40, 30, 20, 10), Box(65, 30, 20, 10), Box(90, 30, 20, 10)]
    y, x = view_of(boxes, TRUE, (120, 160))
    zoom = panel.shape[1] / (x.stop - x.start)
    for index, box in enumerate(boxes):
        near = np.abs(panel.astype(int) - Stroke.of(index).bgr).max(axis=2) < 12
        rows, cols = np.nonzero(near)
        found = np.array([cols.min(), cols.max(), rows.min(), rows.max()]) / zoom + (x.start, x.start, y.start, y.start)
        assert found == pytest.approx([box.x, box.x + box.w, box.y, box.y + box.h], abs=1)


def test_a_box_far_away_or_of_no_number_breaks_no_strip(sequences: tuple[Sequence, ...]) -> None:
    boxes = (TRUE, Box(1e12, -1e12, 5, 5), Box(float("nan"), 0, 1, 1), Box(-30, 500, 1e9, 0))
    own = [record("bird", "ours", [Run(0, boxes, (False,) * 4, (1.0,) * 3, errors_of(boxes, (TRUE,) * 4))])]
    assert draw_strips(own, sequences, summarize(own, ["ours"]), [])[0].frames == (1, 2, 3)


def test_a_strip_of_what_is_not_there_is_refused(sequences: tuple[Sequence, ...]) -> None:
    own, summary = records(), summarize(records(), ORDER)
    with pytest.raises(ConfigError, match="no sequence 'bus' to show: choose from bird, car, boat"):
        draw_strips(own, sequences, summary, [("bus", (1,))])
    with pytest.raises(ConfigError, match=r"car has no frame 5 to show: give 1\.\.4"):
        draw_strips(own, sequences, summary, [("car", (1, 4))])
    sequences[0].images[2].write_bytes(b"broken")
    with pytest.raises(SourceError, match=r"3\.png"):
        draw_strips(own, sequences, summary, [("bird", (2,))])


def test_a_strip_without_frames_shows_some_spread_over_the_sequence(sequences: tuple[Sequence, ...]) -> None:
    own, summary = records(), summarize(records(), ORDER)
    assert [strip.frames for strip in draw_strips(own, sequences, summary, [("car", ())])] == [(1, 2, 3)]


def test_updates_that_gave_no_answer_take_no_time() -> None:
    own = [record("bird", "ours", [replace(records()[0].runs[0], update_ms=(2.0, math.nan, 4.0))])]
    assert summarize(own, ["ours"]).rows[0].updates_per_s == pytest.approx(1000 / 3)


# --- the page and the folder ---


class Reading(HTMLParser):
    """What a browser would load, and what refers to what; fails where tags do not match."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: list[str] = []
        self.texts: list[str] = []
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self._open.append(tag)
        for name, value in attrs:
            if name in {"src", "href", "xlink:href", "poster", "srcset"}:
                self.links.append(value or "")
            elif name == "id":
                self.ids.append(value or "")
            elif value:
                self.links += re.findall(r"url\(([^)]*)\)", value)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def close(self) -> None:
        super().close()
        assert not self._open


def read_page(text: str) -> Reading:
    page = Reading()
    page.feed(text)
    page.close()
    return page


def test_a_report_is_these_files(sequences: tuple[Sequence, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_report(records(), sequences, out, ORDER, [], [("boat", (1, 3))])
    plots = [
        f"plots/{name}.{kind}"
        for name in ("precision", "success", "success_FM", "success_OCC")
        for kind in ("png", "svg")
    ]
    expected = {"index.html", "table.md", "sequences.csv", "results.json", "strips/boat.png", *plots}
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == expected
    assert cv2.imread(str(out / "strips/boat.png")) is not None


def test_the_page_needs_nothing_but_itself(sequences: tuple[Sequence, ...], tmp_path: Path) -> None:
    write_report(records(), sequences, tmp_path, ORDER, [("bus", "no images")])
    page = read_page((tmp_path / "index.html").read_text())
    assert len(page.ids) == len(set(page.ids))
    assert sum(link.startswith("data:image/jpeg") for link in page.links) == 3
    inner = {link.strip("'\"#") for link in page.links if not link.startswith("data:")}
    assert inner
    assert inner <= set(page.ids)
    for text in ("[0.", "bus", "no images", "success rate", *ORDER):
        assert any(text in said for said in page.texts)


def test_the_page_says_what_ran_and_how_to_run_it_again() -> None:
    facts = {"command": "mscf eval x", "versions": {"numpy": "2.0"}, "machine": {"cores": 2}, "trackers": ["a", "b"]}
    page = read_page(evaluation_page(summarize(records(), ORDER), "Title", facts, [], [], []))
    assert {"Title", "mscf eval x", "versions numpy", "2.0", "machine cores", "2", "a, b"} <= set(page.texts)


def test_names_and_faults_are_text_not_markup(sequences: tuple[Sequence, ...], tmp_path: Path) -> None:
    bad = '<b a="1">&amp;'
    own = [record("bird", bad, [run(0, fault=bad)], bad)]
    (tmp_path / "evaluation.json").write_text(json.dumps({"command": bad, bad: bad, "dataset": bad}))
    write_report(own, sequences, tmp_path, (bad,), [(bad, bad)])
    text = (tmp_path / "index.html").read_text()
    assert "<b a=" not in text
    assert read_page(text).texts.count(bad) >= 6


def test_what_the_run_wrote_down_is_in_the_json_and_what_is_damaged_is_named(
    sequences: tuple[Sequence, ...], tmp_path: Path
) -> None:
    facts = {"command": "mscf eval here", "protocol": "tre", "dataset": "some/UAV123"}
    (tmp_path / "evaluation.json").write_text(json.dumps(facts))
    write_report(records(), sequences, tmp_path, ORDER, [])
    assert json.loads((tmp_path / "results.json").read_text())["evaluation"] == facts
    assert (tmp_path / "table.md").read_text().startswith("# Trackers compared on UAV123, TRE\n")
    for damage in ("{", "[]"):
        (tmp_path / "evaluation.json").write_text(damage)
        with pytest.raises(OutputError, match=r"evaluation\.json"):
            write_report(records(), sequences, tmp_path, ORDER, [])


def test_a_second_report_leaves_nothing_of_the_first(sequences: tuple[Sequence, ...], tmp_path: Path) -> None:
    write_report(records(), sequences, tmp_path / "a", ORDER, [], [("boat", (1,))])
    plain = [Record(one.sequence, one.tracker, frozenset(), one.runs) for one in records()]
    for folder in ("a", "b"):
        write_report(plain, sequences, tmp_path / folder, ORDER, [], [("car", (1,))])
    first, second = (
        {path.relative_to(tmp_path / folder): path.read_bytes() for path in (tmp_path / folder).rglob("*.*")}
        for folder in ("a", "b")
    )
    assert first == second
    assert Path("strips/boat.png") not in first


def test_without_matplotlib_all_but_the_plots_is_there_and_it_says_how_to_get_them(
    sequences: tuple[Sequence, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("matplotlib", "matplotlib.backend_bases"):
        monkeypatch.setitem(sys.modules, name, None)
    write_report(records(), sequences, tmp_path, ORDER, [])
    assert not list(tmp_path.rglob("*.svg"))
    assert {path.name for path in tmp_path.glob("*.*")} == {"index.html", "table.md", "sequences.csv", "results.json"}
    assert "Plots are missing: a plot needs Matplotlib: pip install matplotlib" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize("own", [[], [record("a", "ours", [run(0)]), record("b", "theirs", [run(0)])]])
def test_where_nothing_can_be_compared_the_report_is_written_all_the_same(
    own: list[Record], sequences: tuple[Sequence, ...], tmp_path: Path
) -> None:
    write_report(own, sequences, tmp_path, ORDER, [("bus", "no images")])
    page = read_page((tmp_path / "index.html").read_text())
    assert any(said.startswith("0 sequences") for said in page.texts)


def test_a_folder_that_cannot_be_written_is_named(sequences: tuple[Sequence, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"file.* cannot be"):
        write_report(records(), sequences, tmp_path / "file", ORDER, [])
