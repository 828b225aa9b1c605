"""The report of a run: what was claimed and what was measured, as files for people and for programs.

`write_run` puts a page, the plots, a verdict and the trace into one folder, beside the film if one was made there
before; `write_index` leads to the pages of several runs.
"""

import csv
import io
import json
import math
import os
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from companion.flight_record import ABOUT, CONFIG, CONTROL, TLOG, versions
from mscf import Box
from mscf.html_page import escaped, html_page
from mscf.whole_file import write_whole
from sim.figure import check_plottable, mode_hex, mode_spans, plot_png
from sim.scenarios import Act, Verdict
from sim.trace import Moment, Trace

FILM = "flight.mp4"
POSTER = "poster.jpg"
PLOTS = "plots.png"
VERDICT = "verdict.json"
TRACE = "trace.csv"
PAGE = "index.html"
LOG = "application.log"
RECORDS = "flights"  # folder of the flight records of an application in real time

Kind = Literal["virtual time", "real time", "external", "recorded"]
Fact = str | float | None


@dataclass(frozen=True, slots=True)
class Run:
    """A flight that is over, and all that is told of it.

    kind : virtual time, real time with the application as a process of its own, that with an external autopilot, or
        a recorded flight, of which nobody knows the truth: it has no checks and no verdict.
    command : the command line that flies it again; that of a recorded flight makes the report again.
    seed : None for a recorded flight.
    acts : when and what; what they do is left out, so that a run can be handed from process to process.
    facts : further figures by name, as those of timing; names carry units.
    last_words : what the operator was told after the last moment, and when, in s.
    """

    scenario: str
    description: str
    autopilot: str
    kind: Kind
    command: str
    seed: int | None
    trace: Trace
    verdicts: tuple[Verdict, ...]
    acts: tuple[Act, ...] = ()
    facts: Mapping[str, Fact] = field(default_factory=dict)
    last_words: tuple[tuple[float, str], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "acts", tuple(replace(act, do=_is_over) for act in self.acts))

    @property
    def is_passed(self) -> bool:
        """Whether every check has passed; a run without one proves nothing."""
        return bool(self.verdicts) and all(verdict.is_passed for verdict in self.verdicts)

    @property
    def has_truth(self) -> bool:
        """Whether what only a simulator knows is known."""
        return self.kind != "recorded"

    @property
    def duration_s(self) -> float:
        """Time of the last moment."""
        return self.trace.moments[-1].time_s if self.trace.moments else 0.0

    @property
    def folder_name(self) -> str:
        """Where `write_index` looks for the run's page."""
        return folder_name(self.scenario, self.autopilot, self.kind)


def _is_over(_loop: object) -> None:
    """What an act does after its run."""


def folder_name(scenario: str, autopilot: str, kind: Kind) -> str:
    """Name of the folder of a run's report."""
    words = [scenario, autopilot, *([kind] if kind != "virtual time" else [])]
    return re.sub(r"[^a-z0-9_]+", "-", "-".join(words).lower()).strip("-")


def prepare_folder(folder: Path) -> None:
    """Make a folder ready for a run, and fail now rather than after it.

    What an earlier report left there is removed: a run that breaks off must not be taken for that one.

    Raises
    ------
    OutputError
        If no file can be written there, or Matplotlib is not installed.
    """
    check_plottable()
    write_whole(folder / PAGE, b"")
    for name in (PAGE, FILM, POSTER, PLOTS, VERDICT, TRACE, ABOUT, CONFIG, CONTROL, TLOG, LOG):
        (folder / name).unlink(missing_ok=True)
    shutil.rmtree(folder / RECORDS, ignore_errors=True)


def write_run(run: Run, folder: Path) -> None:
    """Write the report into a folder that `prepare_folder` has made ready.

    The film is shown if it is there, `FILM`, and finished. Each file is complete or absent; the page comes last.

    Raises
    ------
    OutputError
        If a file cannot be written, or Matplotlib is not installed.
    """
    write_whole(folder / VERDICT, verdict_json(run).encode())
    write_page(run, folder)


def write_page(run: Run, folder: Path) -> None:
    """Write plots, trace and page into a folder in which the film is already, if there is one.

    Raises
    ------
    OutputError
        If a file cannot be written, or Matplotlib is not installed.
    """
    title = f"{run.scenario}, {run.autopilot}"
    write_whole(folder / PLOTS, plot_png(title, run.trace, run.acts, has_truth=run.has_truth))
    # what was recorded may hold half a character, which no file does
    write_whole(folder / TRACE, trace_csv(run.trace, has_truth=run.has_truth).encode("utf-8", "replace"))
    if (folder / FILM).is_file():
        poster = _poster(folder / FILM)
        if poster is not None:
            write_whole(folder / POSTER, poster)
    write_whole(folder / PAGE, run_page(run, _files(folder)).encode("utf-8", "replace"))


def _files(folder: Path) -> list[str]:
    """What lies in a run's folder, the records of its application too."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name[0] != "."]
    names = {path.relative_to(folder).as_posix() for path in paths}
    return sorted(name for name in names - {PAGE} if "/" not in name or name.startswith(RECORDS + "/"))


def write_index(runs: Sequence[Run], folder: Path) -> None:
    """Write a page that leads to the runs' own, each in the folder `run.folder_name` beside it.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_whole(folder / PAGE, index_page(runs).encode())


# ------------------------------------------------------------------------------------------------ for programs
def verdict_json(run: Run) -> str:
    """The checks and the circumstances; what is not known or not finite is null."""
    checks = [
        {
            "name": verdict.name,
            "passed": verdict.is_passed,
            "figure": _finite(verdict.value),
            "at_least": _finite(verdict.least),
            "at_most": _finite(verdict.most),
            "unit": verdict.unit,
            "measured": verdict.measured,
            "wanted": verdict.wanted,
        }
        for verdict in run.verdicts
    ]
    content = {
        "scenario": run.scenario,
        "description": run.description,
        "autopilot": run.autopilot,
        "kind": run.kind,
        "passed": run.is_passed,
        "checks": checks,
        "seed": run.seed,
        "command": run.command,
        "duration_s": run.duration_s,
        "facts": {name: _finite(value) for name, value in run.facts.items()},
        "environment": environment(),
    }
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def environment() -> dict[str, str | int | None]:
    """Versions and the kind of machine; nothing that names this one."""
    return {**versions(), "cores": os.cpu_count()}


def trace_csv(trace: Trace, *, has_truth: bool = True) -> str:
    """One row a moment, units in the header; what is not known is empty, and what can never be is left out."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    names = list(_row(trace.moments[0])) if trace.moments else ["time_s"]
    names = [name for name in names if has_truth or name not in _TRUE]
    writer.writerow(names)
    for moment in trace.moments:
        row = _row(moment)
        writer.writerow("" if _finite(row[name]) is None else row[name] for name in names)
    return file.getvalue()


def _row(moment: Moment) -> dict[str, Any]:
    pose, unknown = moment.pose, (None, None, None)
    row: dict[str, Any] = {
        "time_s": round(moment.time_s, 6),
        "mode": moment.mode,
        "flight_mode": moment.flight_mode,
        "is_armed": int(moment.is_armed),
        **_axes("vehicle", "m", pose.pos_ned_m),
        "roll_rad": pose.roll_rad,
        "pitch_rad": pose.pitch_rad,
        "yaw_rad": pose.yaw_rad,
        **_axes("velocity", "mps", moment.velocity_ned_mps),
        **_axes("target", "m", moment.target_ned_m),
        **_box("box", moment.box),
        **_box("true_box", moment.truth),
        "iou": moment.iou,
        "visible_share": moment.visible_share,
        "status": moment.status,
        "confidence": moment.confidence,
        "threat": moment.threat,
        "frame_age_s": moment.frame_age_s,
        **_axes("setpoint", "mps", moment.setpoint_ned_mps or unknown),
        "setpoint_yaw_rate_radps": moment.yaw_rate_radps,
        "range_m": moment.range_m,
        "true_range_m": moment.true_range_m,
        "bearing_error_rad": moment.bearing_error_rad,
        "notes": " | ".join(moment.notes),
        "texts": " | ".join(moment.texts),
    }
    return {name: float(f"{value:.7g}") if isinstance(value, float) else value for name, value in row.items()}


def _axes(name: str, unit: str, values: Sequence[float | None]) -> dict[str, float | None]:
    return {f"{name}_{axis}_{unit}": value for axis, value in zip(("north", "east", "down"), values, strict=True)}


def _box(name: str, box: Box | None) -> dict[str, float | None]:
    values = (None,) * 4 if box is None else (box.x, box.y, box.w, box.h)
    return {f"{name}_{side}_px": value for side, value in zip("xywh", values, strict=True)}


# columns that a simulator alone can fill
_TRUE = {
    *_axes("target", "m", (None,) * 3),
    *_box("true_box", None),
    "iou",
    "visible_share",
    "true_range_m",
    "bearing_error_rad",
}


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


# ------------------------------------------------------------------------------------------------ for people
_STYLE = """
:root { --good: #17803d; --bad: #c62828 }
@media (prefers-color-scheme: dark) { :root { --good: #4cc773; --bad: #ff6b62 } }
body { max-width: 70rem }
h1 { margin: 0 }
header { display: flex; flex-wrap: wrap; gap: .6rem 1.2rem; align-items: center; justify-content: space-between }
.verdict { padding: .3rem 1rem; border-radius: .4rem; font-size: 1.5rem; font-weight: 700; letter-spacing: .06em;
  color: var(--page); background: var(--bad) }
.verdict.good { background: var(--good) }
.good { color: var(--good) } .bad { color: var(--bad) } .verdict.good, .verdict.bad { color: var(--page) }
video, img { display: block; width: 100%; height: auto; border-radius: .4rem }
img { min-width: 44rem; background: #fff }
.bar { display: flex; height: .8rem; margin-top: .6rem; overflow: hidden; border-radius: .4rem }
.key { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; margin: .4rem 0 0; padding: 0; list-style: none;
  font-size: .9rem }
.key i { display: inline-block; width: .8em; height: .8em; margin-right: .4em; border-radius: .2em }
table { width: 100% }
.broad { min-width: 56rem }
th, td { padding: .4rem .8rem .4rem 0 }
td.figure, th.figure { font-variant-numeric: tabular-nums }
td.mark { width: 1.6rem; font-weight: 700 }
"""


def run_page(run: Run, files: Sequence[str]) -> str:
    """The page of a run, which shows what of `files` is a film, a poster or plots and lists them all."""
    passed = sum(verdict.is_passed for verdict in run.verdicts)
    is_passed = run.is_passed if run.has_truth else None
    said = _passed(passed, len(run.verdicts)) if run.has_truth else ""
    parts = [
        _header(run.scenario, f"{run.autopilot} · {run.kind} · {run.duration_s:.0f} s", is_passed=is_passed),
        f"<p>{escaped(_sentence(run.description))} {_KINDS[run.kind]} {said}</p>",
    ]
    if FILM in files:
        poster = f' poster="{POSTER}"' if POSTER in files else ""
        parts.append(f'<video controls muted playsinline preload="metadata" src="{FILM}"{poster}></video>')
    else:
        parts.append('<p class="soft">No film was made of this run.</p>')
    parts.append(_modes(run.trace))
    if run.has_truth:
        parts += ["<h2>Checks</h2>", _checks(run.verdicts)]
    if PLOTS in files:
        parts += [
            "<h2>Plots</h2>",
            f'<div class="wide"><a href="{PLOTS}"><img src="{PLOTS}" alt="The run over time"></a></div>',
        ]
    parts += ["<h2>What the operator was told</h2>", _log(run)]
    known = {**run.facts, **environment()} if run.has_truth else run.facts  # a record brings its own circumstances
    facts = {"command": f"<code>{escaped(run.command)}</code>"}
    if run.seed is not None:
        facts["seed"] = str(run.seed)
    facts |= {name.replace("_", " "): escaped(_fact(value)) for name, value in known.items()}
    parts += [
        "<h2>Circumstances</h2>",
        _table((f"<td>{escaped(name)}</td><td>{fact}</td>" for name, fact in facts.items())),
    ]
    links = (f'<a href="{escaped(name)}">{escaped(name)}</a>' for name in files)
    parts += ["<h2>Files</h2>", f"<p>{' · '.join(links)}</p>"]
    verdict = _word(run.is_passed) if run.has_truth else run.kind
    return html_page(f"{run.scenario}, {run.autopilot}: {verdict}", parts, _STYLE)


def index_page(runs: Sequence[Run]) -> str:
    """The page that leads to those of the runs."""
    passed = sum(run.is_passed for run in runs)
    rows = []
    for run in runs:
        failed = [f"{verdict.name}: {verdict.measured}" for verdict in run.verdicts if not verdict.is_passed]
        complaints = [f'<br><span class="bad">{escaped(text)}</span>' for text in failed]
        figures = "".join(f'<td class="figure">{value}</td>' for value in key_figures(run.trace).values())
        rows.append(
            f'<td class="mark {_class(run.is_passed)}">{_mark(run.is_passed)}</td>'
            f'<td><a href="{escaped(run.folder_name)}/{PAGE}">{_title(run.scenario)}</a><br>'
            f'<span class="soft">{escaped(run.description)}</span>'
            f"{''.join(complaints)}</td>"
            f"<td>{escaped(run.autopilot)}</td><td>{escaped(run.kind)}</td>"
            f'<td class="figure">{len(run.verdicts) - len(failed)} of {len(run.verdicts)}</td>{figures}'
        )
    head = ("", "scenario", "autopilot", "run", "checks", *key_figures(Trace(())))
    parts = [
        _header("Flights", f"{passed} of {len(runs)} passed", is_passed=bool(runs) and passed == len(runs)),
        "<p>What has to come of each flight is written down before it. Behind each name: film, plots, checks.</p>",
        _table(rows, head, is_broad=True),
    ]
    return html_page(f"Flights: {passed} of {len(runs)} passed", parts, _STYLE)


def key_figures(trace: Trace) -> dict[str, str]:
    """What tells most of a run in the fewest figures."""
    following = [abs(m.bearing_error_rad) for m in trace.moments if m.mode == "following"]
    following = [error_rad for error_rad in following if math.isfinite(error_rad)]
    ranges = [m.true_range_m for m in trace.moments if math.isfinite(m.true_range_m)]
    share = trace.share("following", 0.0)
    bearing = f"{math.degrees(float(np.percentile(following, 95))):.1f}°" if following else "-"
    return {
        "following": f"{100 * share:.0f} %",
        "bearing error, 95 %": bearing,
        "nearest": f"{min(ranges):.1f} m" if ranges else "-",
    }


_KINDS: dict[Kind, str] = {
    "virtual time": "Flown in virtual time: the same command gives the same flight.",
    "real time": "Flown in real time, with the application as a process of its own.",
    "external": "Flown in real time by an autopilot that is not the simulator's own, with the application as a process "
    "of its own; where the vehicle is, is what the autopilot reports.",
    "recorded": "Where the vehicle was and the range are what the autopilot reported and the application estimated; "
    "nobody measured the truth.",
}


def _modes(trace: Trace) -> str:
    """A bar with the modes over time, and how long each lasted."""
    spans = [(mode, end_s - start_s) for mode, start_s, end_s in mode_spans(trace)]
    total_s = sum(length_s for _, length_s in spans)
    if total_s <= 0:
        return ""
    bar = "".join(
        f'<span title="{escaped(mode)}" style="width:{100 * length_s / total_s:.3f}%;'
        f'background:{mode_hex(mode)}"></span>'
        for mode, length_s in spans
    )
    key = "".join(
        f'<li><i style="background:{mode_hex(mode)}"></i>{escaped(mode or "unknown")} '
        f"{sum(length_s for other, length_s in spans if other == mode):.1f} s</li>"
        for mode in dict.fromkeys(mode for mode, _ in spans)
    )
    return f'<div class="bar">{bar}</div><ul class="key">{key}</ul>'


def _checks(verdicts: Sequence[Verdict]) -> str:
    rows = (
        f'<td class="mark {_class(verdict.is_passed)}">{_mark(verdict.is_passed)}</td><td>{escaped(verdict.name)}</td>'
        f'<td class="figure {_class(verdict.is_passed)}">{escaped(verdict.measured)}</td>'
        f'<td class="figure">{escaped(verdict.wanted)}</td>'
        for verdict in verdicts
    )
    return _table(rows, ("", "check", "measured", "wanted"))


def _log(run: Run) -> str:
    """What was said and what happened, in the order of time."""
    lines = [(moment.time_s, escaped(text)) for moment in run.trace.moments for text in moment.texts]
    lines += [(time_s, escaped(text)) for time_s, text in run.last_words]
    lines += [(act.time_s, f'<span class="soft">({escaped(act.name)})</span>') for act in run.acts]
    lines.sort(key=lambda line: line[0])
    if not lines:
        return '<p class="soft">Nothing.</p>'
    return _table(f'<td class="figure">{time_s:.1f}&nbsp;s</td><td>{text}</td>' for time_s, text in lines)


def _table(rows: Iterable[str], head: Sequence[str] = (), *, is_broad: bool = False) -> str:
    kind = ' class="broad"' if is_broad else ""
    top = f"<thead><tr>{''.join(f'<th>{escaped(name)}</th>' for name in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="wide"><table{kind}>{top}<tbody>{body}</tbody></table></div>'


def _header(name: str, about: str, *, is_passed: bool | None) -> str:
    """The top of a page; None: nothing was checked, nothing is said."""
    title = f'<div><h1>{_title(name)}</h1><div class="soft">{escaped(about)}</div></div>'
    if is_passed is None:
        return f"<header>{title}</header>"
    return f'<header>{title}<div class="verdict {_class(is_passed)}">{_word(is_passed)}</div></header>'


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}".rstrip(".") + "."


def _passed(count: int, total: int) -> str:
    judge = "The checks look at where things are, not at what the application believes."
    return f"{count} of {total} checks passed. {judge}" if total else "Nothing was checked, so nothing is proven."


def _title(name: str) -> str:
    return escaped(name.replace("_", " ").capitalize())


def _fact(value: Fact) -> str:
    if value is None or _finite(value) is None:
        return "not known"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _word(is_passed: bool) -> str:  # noqa: FBT001 - it is the subject
    return "PASSED" if is_passed else "FAILED"


def _class(is_passed: bool) -> str:  # noqa: FBT001
    return "good" if is_passed else "bad"


def _mark(is_passed: bool) -> str:  # noqa: FBT001
    return "✓" if is_passed else "✗"


# ------------------------------------------------------------------------------------------------ files


def _poster(film: Path) -> bytes | None:
    """A picture from the middle of a film, as JPEG; None if none can be read."""
    video = cv2.VideoCapture(str(film))
    try:
        video.set(cv2.CAP_PROP_POS_FRAMES, video.get(cv2.CAP_PROP_FRAME_COUNT) // 2)
        is_read, picture = video.read()
    finally:
        video.release()
    if not is_read:
        return None
    is_made, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return data.tobytes() if is_made else None
