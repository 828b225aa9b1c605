"""The page of an evaluation: one file with everything in it, for a browser or a letter."""

import base64
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2

from mscf.evaluation.report.curves import INK, PAPER, Plot
from mscf.evaluation.report.palette import Stroke
from mscf.evaluation.report.strips import Strip
from mscf.evaluation.report.summary import METRICS, Summary, places
from mscf.evaluation.report.table import MARKS, counted, rate_text, remarks, share_text, spread_text
from mscf.evaluation.statistics import Interval
from mscf.html_page import escaped, html_page

JPEG_QUALITY = 88

_STYLE = """
:root { --first: #c3352b; --second: #16782f; --third: #1b62c0 }
@media (prefers-color-scheme: dark) { :root { --first: #ff7a6e; --second: #5fcf80; --third: #7db8ff } }
p { max-width: 52rem }
.small { font-size: .82rem }
.notice { padding: .5rem .8rem; border-left: .25rem solid var(--first); background: var(--card) }
th, td { padding: .35rem 1.1rem .35rem 0; white-space: nowrap }
td { font-variant-numeric: tabular-nums }
td.text { white-space: normal; min-width: 12rem; overflow-wrap: anywhere }
th:first-child, td:first-child { position: sticky; left: 0; background: var(--page) }
td .soft { display: block; font-size: .78rem }
.place1, .place2, .place3 { font-weight: 700 }
.place1 { color: var(--first) } .place2 { color: var(--second) } .place3 { color: var(--third) }
.line { display: inline-block; width: 2.2rem; height: .7rem; margin-right: .5rem; vertical-align: baseline }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: 1rem }
.plots.many { margin-top: 1.4rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 20rem), 1fr)) }
.plots svg { display: block; width: 100%; height: auto }
figure { margin: 0 0 1.2rem }
figure img { display: block; width: 100%; min-width: 56rem; height: auto; border-radius: .3rem }
figcaption { margin-top: .3rem }
pre { padding: .6rem .8rem; border-radius: .3rem; background: var(--card); font-size: .9em; overflow-wrap: anywhere;
  white-space: pre-wrap }
@media (max-width: 40rem) { .line { display: block }
  td:first-child { min-width: 7.4rem; max-width: 38vw; white-space: normal; overflow-wrap: anywhere } }
"""


def evaluation_page(
    summary: Summary,
    title: str,
    circumstances: Mapping[str, Any],
    skipped: Sequence[tuple[str, str]],
    plots: Sequence[Plot],
    strips: Sequence[Strip],
    notice: str = "",
) -> str:
    """The page, whole: style, plots and pictures are inside it.

    Parameters
    ----------
    circumstances : of the run, as it wrote them down: protocol, versions, machine, command; may be empty.
    plots : as `draw_plots` gives them; may be empty.
    notice : what the reader should know first; may be empty.
    """
    parts = [f"<h1>{escaped(title)}</h1>", f"<p>{escaped(' '.join(remarks(summary)))}</p>"]
    if notice:
        parts.append(f'<p class="notice">{escaped(notice)}</p>')
    if skipped:
        parts.append(f'<p class="notice">{counted(len(skipped), "sequence")} skipped: <a href="#skipped">why</a>.</p>')
    parts += ["<h2>Overall</h2>", _overall(summary), _how_to_read()]
    if plots:
        parts += ["<h2>Precision and success</h2>", _figures(plots[:2])]
    if summary.attributes:
        parts += ["<h2>AUC by attribute</h2>", _by_attribute(summary)]
        if plots[2:]:
            parts.append(_figures(plots[2:], kind="plots many"))
    parts += ["<h2>By sequence</h2>", _by_sequence(summary)]
    if strips:
        parts += ["<h2>Pictures</h2>", *map(_strip, strips)]
    parts += ["<h2>Lost and raised</h2>", _lost(summary)]
    if skipped:
        rows = (f'<td>{escaped(name)}</td><td class="text">{escaped(why)}</td>' for name, why in skipped)
        parts += ['<h2 id="skipped">Skipped</h2>', _table(("sequence", "why"), rows)]
    parts += ["<h2>How to get it again</h2>", _circumstances(circumstances)]
    return html_page(title, parts, _STYLE)


def _how_to_read() -> str:
    marks = ", ".join(
        f'<span class="place{place}">{MARKS[place]}</span> {word}'
        for place, word in enumerate(("best", "second", "third"), start=1)
    )
    return (
        f'<p class="soft small">{marks}. Means over the runs of a sequence, then over sequences; in brackets the '
        "bootstrap 95 % interval over sequences. Whether two trackers really differ is told by "
        "<code>mscf eval compare</code>, pair by pair: these intervals may overlap even so. Precision: share of frames "
        "with a centre error of at most 20 px. AUC: area under the success plot. OP@0.5: share of frames with an "
        "overlap over 0.5. Norm. precision: area under the precision plot with the error in sizes of the target, up to "
        "0.5. Frames without truth do not count. Updates/s: of the update alone, without decoding the image. Lost: "
        "updates after which the tracker said so or had raised, and its last box was kept.</p>"
    )


def _overall(summary: Summary) -> str:
    columns = []
    for name in METRICS:
        means = [row.means[name] for row in summary.rows]
        columns.append([_interval(mean, place) for mean, place in zip(means, _places(means), strict=True)])
    speeds = places([row.updates_per_s for row in summary.rows])
    columns.append([_marked(rate_text(row), place) for row, place in zip(summary.rows, speeds, strict=True)])
    columns.append([share_text(row.lost, row.updates) for row in summary.rows])
    names = [_tracker(index, name) for index, name in enumerate(summary.trackers)]
    rows = ("".join(f"<td>{cell}</td>" for cell in cells) for cells in zip(names, *columns, strict=True))
    return _table(("tracker", *METRICS.values(), "updates/s", "lost"), rows)


def _by_attribute(summary: Summary) -> str:
    lines = []
    for name, rows in summary.attributes.items():
        means = [row.means["auc"] for row in rows]
        cells = [_interval(mean, place) for mean, place in zip(means, _places(means), strict=True)]
        count = f'<span class="soft">{len(summary.having[name])} of {len(summary.counted)}</span>'
        lines.append("".join(f"<td>{cell}</td>" for cell in (f"{escaped(name)}{count}", *cells)))
    return _table(("attribute", *summary.trackers), lines)


def _by_sequence(summary: Summary) -> str:
    lines = []
    for sequence, row in summary.cells.items():
        scores = [row[name].score if name in row else None for name in summary.trackers]
        ranks = places([math.nan if score is None else score.auc for score in scores])
        cells = [
            "-"
            if score is None or math.isnan(score.auc)
            else f'{_marked(f"{score.auc:.3f}", rank)}<span class="soft">{score.precision:.3f}</span>'
            for score, rank in zip(scores, ranks, strict=True)
        ]
        note = "" if sequence in summary.counted else '<span class="soft">not counted</span>'
        lines.append("".join(f"<td>{cell}</td>" for cell in (f"{escaped(sequence)}{note}", *cells)))
    about = '<p class="soft small">AUC, and below it the precision; means over the runs.</p>'
    return about + _table(("sequence", *summary.trackers), lines)


def _lost(summary: Summary) -> str:
    rows = []
    for index, row in enumerate(summary.rows):
        faults = "<br>".join(f"{escaped(fault)} (in {runs})" for fault, runs in row.faults.items()) or "-"
        updates = f"{row.lost} of {row.updates}"
        runs = f"{sum(row.faults.values())} of {row.runs}"
        rows.append(
            f'<td>{_tracker(index, row.tracker)}</td><td>{updates}</td><td>{runs}</td><td class="text">{faults}</td>'
        )
    return _table(("tracker", "updates lost", "runs that raised", "what was raised first"), rows)


def _strip(strip: Strip) -> str:
    is_made, data = cv2.imencode(".jpg", strip.picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert is_made  # of any uint8 picture
    numbers = ", ".join(str(frame + 1) for frame in strip.frames)
    about = f"{escaped(strip.sequence)}, frames {numbers}"
    picture = f'<img src="data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}" alt="{about}">'
    caption = f'<figcaption class="soft small">{about}; of each the part where the boxes are, first run.</figcaption>'
    return f'<figure><div class="wide">{picture}</div>{caption}</figure>'


def _figures(plots: Sequence[Plot], kind: str = "plots") -> str:
    return f'<div class="{kind}">{"".join(map(_inline, plots))}</div>'


def _inline(plot: Plot) -> str:
    """SVG as part of the page: with the page's colours, and names that do not clash with those of other plots."""
    svg = plot.svg[plot.svg.index("<svg") :]
    mark = "".join(f"{byte:02x}" for byte in plot.name.encode()) + "-"
    svg = re.sub(r'\bid="', f'id="p{mark}', svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\1p{mark}", svg)
    svg = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", svg, count=1)
    svg = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", svg, count=1)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor").replace(PAPER, "var(--page)")
    return svg.replace("<svg", f'<svg role="img" aria-label="{escaped(plot.title)}"', 1)


def _circumstances(circumstances: Mapping[str, Any]) -> str:
    if not circumstances:
        return '<p class="soft">The run left no word of its command, versions and machine.</p>'
    command = circumstances.get("command")
    parts = [f"<pre>{escaped(str(command))}</pre>"] if command else []
    facts = [(name, value) for name, value in _flat(circumstances) if name != "command"]
    rows = (
        f'<td>{escaped(name.replace("_", " "))}</td><td class="text">{escaped(value)}</td>' for name, value in facts
    )
    return "".join(parts) + (_table((), rows) if facts else "")


def _flat(value: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    """Names and values of what is nested, as "versions numpy"."""
    for name, part in value.items():
        if isinstance(part, Mapping):
            yield from _flat(part, f"{prefix}{name} ")
        elif part is not None and part != []:
            words = ", ".join(map(str, part)) if isinstance(part, list) else str(part)
            yield f"{prefix}{name}", words


def _tracker(index: int, name: str) -> str:
    """A tracker's name behind its line in the plots."""
    stroke = Stroke.of(index)
    dash = f' stroke-dasharray="{" ".join(f"{2.5 * part:g}" for part in stroke.dash)}"' if stroke.dash else ""
    line = f'<line x1="0" y1="5" x2="36" y2="5" stroke="{stroke.color}" stroke-width="3"{dash}/>'
    dot = {
        "": "",
        "o": f'<circle cx="18" cy="5" r="4.5" fill="{stroke.color}"/>',
        "s": f'<rect x="14" y="1" width="8" height="8" fill="{stroke.color}"/>',
    }[stroke.marker]
    return f'<svg class="line" viewBox="0 0 36 10" aria-hidden="true">{line}{dot}</svg>{escaped(name)}'


def _interval(interval: Interval, place: int) -> str:
    if math.isnan(interval.mean):
        return "-"
    spread = spread_text(interval)
    return _marked(f"{interval.mean:.3f}", place) + (f'<span class="soft">{spread}</span>' if spread else "")


def _marked(text: str, place: int) -> str:
    return f'<span class="place{place}">{text} {MARKS[place]}</span>' if place else text


def _places(means: Sequence[Interval]) -> tuple[int, ...]:
    return places([mean.mean for mean in means])


def _table(head: Sequence[str], rows: Iterable[str]) -> str:
    top = f"<thead><tr>{''.join(f'<th>{escaped(name)}</th>' for name in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="wide"><table>{top}<tbody>{body}</tbody></table></div>'
