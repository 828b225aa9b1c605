"""Everything that is written from records: tables, plots, pictures and a page."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2

from mscf.arrays import Image
from mscf.errors import OutputError
from mscf.evaluation import datasets
from mscf.evaluation.campaign import EVALUATION
from mscf.evaluation.record import Record
from mscf.evaluation.report.curves import Plot, draw_plots
from mscf.evaluation.report.page import evaluation_page
from mscf.evaluation.report.strips import check_strips, draw_strips
from mscf.evaluation.report.summary import summarize
from mscf.evaluation.report.table import markdown, print_table, results_json, sequences_csv
from mscf.figure import check_plottable
from mscf.whole_file import write_whole

__all__ = ["check_strips", "print_table", "write_report"]

PAGE = "index.html"
TABLE = "table.md"
SEQUENCES = "sequences.csv"
RESULTS = "results.json"
PLOTS = "plots"
STRIPS = "strips"


def write_report(
    records: Sequence[Record],
    sequences: Sequence[datasets.Sequence],
    folder: Path,
    order: tuple[str, ...],
    skipped: Sequence[tuple[str, str]],
    strips: Sequence[tuple[str, tuple[int, ...]]] = (),
) -> tuple[Path, str]:
    """Write the report of an evaluation into its folder: tables, plots, pictures, and last the page.

    Each file is complete or absent. What an earlier report left there is replaced or removed. Without Matplotlib there
    are no plots, and the page says how to get them.

    Parameters
    ----------
    records : of any trackers; those in `order` are shown, in this order.
    sequences : whose pictures may be shown.
    skipped : sequences that were not run, and why.
    strips : sequences and 0-based frames to show; without any, a few that tell the trackers apart.

    Returns
    -------
    The page, and what is missing in it and why; empty where nothing is.

    Raises
    ------
    OutputError
        If a file cannot be written, or the folder's evaluation.json cannot be read.
    ConfigError
        If there is no such sequence or frame in `sequences` as `strips` says.
    SourceError
        If an image that is to be shown cannot be decoded.
    """
    circumstances = _circumstances(folder / EVALUATION)
    summary = summarize(records, order)
    protocol, dataset = (str(circumstances.get(name) or "") for name in ("protocol", "dataset"))
    on = f" on {Path(dataset).name}" if dataset else ""
    title = f"Trackers compared{on}" + (f", {protocol.upper()}" if protocol else "")
    write_whole(folder / TABLE, markdown(summary, title, skipped).encode())
    write_whole(folder / SEQUENCES, sequences_csv(summary).encode())
    write_whole(folder / RESULTS, results_json(summary, circumstances, skipped).encode())

    plots: tuple[Plot, ...] = ()
    notice = ""
    try:
        check_plottable(folder / "plot.svg")
    except OutputError as error:
        notice = f"Plots are missing: {error}. Then write the report again."
    else:
        plots = draw_plots(summary, protocol)
    files = {f"{_file_name(plot.name)}.png": plot.png for plot in plots}
    files |= {f"{_file_name(plot.name)}.svg": plot.svg.encode() for plot in plots}
    _replace(folder / PLOTS, files)
    drawn = draw_strips(records, sequences, summary, strips)
    _replace(folder / STRIPS, {f"{_file_name(strip.sequence)}.png": _png(strip.picture) for strip in drawn})

    page = evaluation_page(summary, title, circumstances, skipped, plots, drawn, notice)
    write_whole(folder / PAGE, page.encode())
    return folder / PAGE, notice


def _circumstances(path: Path) -> Mapping[str, Any]:
    """What a run wrote down of itself; nothing where there is no such file."""
    try:
        value = json.loads(path.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise OutputError(f"{path} cannot be read: {error}; remove it, or run again") from error
    if not isinstance(value, dict):
        raise OutputError(f"{path} is not of an evaluation: remove it, or run again")
    return value


def _file_name(name: str) -> str:
    """Name of a plot or a sequence as a file's."""
    return quote(name.replace(" ", "_"), safe="+", errors="surrogateescape")


def _png(picture: Image) -> bytes:
    is_made, data = cv2.imencode(".png", picture)
    assert is_made  # of any uint8 picture
    return data.tobytes()


def _replace(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the pictures of a report, and remove those of an earlier one, which would be taken for its own."""
    for path in [*folder.glob("*.png"), *folder.glob("*.svg")]:
        if path.name not in files:
            _remove(path)
    for name, data in files.items():
        write_whole(folder / name, data)


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path} cannot be removed: {error.strerror or error}") from error
