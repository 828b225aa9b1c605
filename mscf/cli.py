"""Command `mscf`: demo, eval, bench."""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import cv2
from threadpoolctl import threadpool_limits

from mscf.bench import BenchOptions, run_bench
from mscf.command_line import EXIT_BROKEN_PIPE, EXIT_INTERRUPTED, EXIT_USAGE, Parser, box
from mscf.config import PRESETS
from mscf.demo import DemoOptions, ProgressStyle, run_demo
from mscf.errors import MscfError
from mscf.evaluation.campaign import EvaluationOptions, evaluate, read_left_out
from mscf.evaluation.compare import compare
from mscf.evaluation.datasets import read_dataset
from mscf.evaluation.peers import Models, tracker_names
from mscf.evaluation.protocol import PROTOCOLS, TRE_STARTS
from mscf.evaluation.report import check_strips, print_table, write_report
from mscf.source import open_source


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 0, 2 for bad input, 130 for Ctrl-C."""
    words = list(sys.argv[1:] if argv is None else argv)
    parser, words = (_compare_parser(), words[2:]) if words[:2] == ["eval", "compare"] else (_parser(), words)
    arguments = parser.parse_args(words)
    threadpool_limits(1, "blas")  # the tracker's matrix products are too small to be worth sharing
    cv2.setNumThreads(1)
    # what these would print of a broken file is said in one line of our own
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        return int(arguments.run(arguments))
    except MscfError as error:
        print(f"mscf: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # whoever read our output has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="mscf", description="MSCF correlation filter tracker: see it, measure it.")
    parser.add_argument("--version", action="version", version=f"mscf {version('mscf-companion')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_demo(commands)
    _add_eval(commands)
    _add_bench(commands)
    return parser


def _add_demo(commands: "argparse._SubParsersAction[Parser]") -> None:
    demo = commands.add_parser(
        "demo",
        help="track a target through a video, images, a camera, or the built-in flight",
        description="Track a target; write a video, boxes and a plot of it. Without SOURCE: the built-in flight.",
    )
    source_help = "video file, folder or glob of images, /dev/videoN or N"
    demo.add_argument("source", nargs="?", metavar="SOURCE", help=source_help)
    demo.add_argument(
        "--box",
        type=box,
        metavar="X,Y,W,H",
        help="target in the first frame, first pixel 0,0 (groundtruth.txt: 1,1); negative: --box=-5,2,30,30",
    )
    demo.add_argument("--preset", choices=PRESETS, default="mscf", help="tracker to run (default: %(default)s)")
    demo.add_argument(
        "--compare", choices=PRESETS, action="append", default=[], help="run this one beside it; may be repeated"
    )
    demo.add_argument("--save", type=Path, metavar="OUT.mp4", help="video with boxes, response map and threat curve")
    demo.add_argument(
        "--boxes", type=Path, metavar="OUT.txt", help="boxes of --preset, x,y,w,h a frame, 1-based as ground truth is"
    )
    demo.add_argument(
        "--plot", type=Path, metavar="OUT.png", help="threat, its change, and errors where truth is known"
    )
    demo.add_argument("--max-frames", type=_count, metavar="N", help="stop after N frames")
    demo.add_argument("--no-progress", action="store_true", help="print the results only")
    demo.set_defaults(run=_demo)


def _demo(arguments: argparse.Namespace) -> int:
    style: ProgressStyle = "bar" if sys.stderr.isatty() else "lines"
    options = DemoOptions(
        presets=tuple(dict.fromkeys([arguments.preset, *arguments.compare])),
        box=arguments.box,
        save=arguments.save,
        boxes=arguments.boxes,
        plot=arguments.plot,
        max_frames=arguments.max_frames,
        progress="none" if arguments.no_progress else style,
    )
    is_complete = run_demo(open_source(arguments.source), options, sys.stdout, sys.stderr)
    return 0 if is_complete else EXIT_INTERRUPTED


def _add_eval(commands: "argparse._SubParsersAction[Parser]") -> None:
    evaluate = commands.add_parser(
        "eval",
        help="trackers compared on sequences with ground truth; `eval compare A B`: two results",
        description="Run trackers over a data set; write tables, plots and a page of it. "
        "`mscf eval compare A B`: whether the difference of two results, folders OUT/runs/TRACKER, is real.",
    )
    evaluate.add_argument(
        "dataset", type=Path, metavar="DATASET", help="UAV123, UAV123@10fps, DTB70, UAVDT, OTB100, VOT or NAME/img/"
    )
    evaluate.add_argument(
        "--tracker",
        nargs="+",
        action="extend",
        metavar="NAME",
        help=f"{', '.join(tracker_names())}; PRESET,FIELD=VALUE,... for a variant of ours; or module:Class "
        "(default: mscf reference)",
    )
    evaluate.add_argument(
        "--protocol",
        choices=PROTOCOLS,
        default="ope",
        help="ope: one run; tre: from frames spread over the sequence; sre: from 12 boxes around the first one "
        "(default: %(default)s)",
    )
    evaluate.add_argument(
        "--starts", type=_count, default=TRE_STARTS, metavar="N", help="of tre (default: %(default)s)"
    )
    evaluate.add_argument("--sequences", metavar="A,B", help="only these")
    evaluate.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default: %(default)s)")
    evaluate.add_argument("--out", type=Path, default=Path("out/eval"), metavar="DIR", help="default: %(default)s")
    evaluate.add_argument("--resume", action="store_true", help="go on with what DIR holds")
    evaluate.add_argument(
        "--strip",
        type=_strip,
        action="append",
        default=[],
        metavar="NAME[:N,N]",
        help="sequence, and frames of it from 1, to show with all boxes; may be repeated (default: where they differ)",
    )
    evaluate.add_argument("--color-table", type=Path, metavar="NPZ", help="colour names to use in place of our own")
    evaluate.add_argument(
        "--nano", type=Path, nargs=2, metavar=("BACKBONE", "HEAD"), help="ONNX files of OpenCV's tracker nano"
    )
    evaluate.add_argument("--vit", type=Path, metavar="MODEL", help="ONNX file of OpenCV's tracker vit")
    evaluate.set_defaults(run=_eval)


def _eval(arguments: argparse.Namespace) -> int:
    names = tuple(dict.fromkeys(arguments.tracker or ["mscf", "reference"]))
    dataset = read_dataset(arguments.dataset, arguments.sequences.split(",") if arguments.sequences else ())
    check_strips(arguments.strip, dataset.sequences)
    for skipped in dataset.skipped:
        print(f"{skipped.name} is left out: {skipped.why}", file=sys.stderr)
    backbone, head = arguments.nano or (None, None)
    options = EvaluationOptions(
        protocol=arguments.protocol,
        tre_starts=arguments.starts,
        jobs=arguments.jobs,
        is_resumed=arguments.resume,
        models=Models(backbone, head, arguments.vit),
        color_table=arguments.color_table,
    )
    records = evaluate(dataset, names, options, arguments.out, sys.stderr)
    left_out = read_left_out(arguments.out) | {each.name: each.why for each in dataset.skipped}
    page, notice = write_report(
        records, dataset.sequences, arguments.out, names, tuple(left_out.items()), arguments.strip
    )
    print_table(records, names, sys.stdout)
    print(f"\npage      {page}")
    if notice:
        print(f"mscf: {notice}", file=sys.stderr)
    return 0


def _strip(text: str) -> tuple[str, tuple[int, ...]]:
    """Name of a sequence, and 0-based frames."""
    name, _, numbers = text.partition(":")
    return name, tuple(_count(number) - 1 for number in numbers.split(",")) if numbers else ()


def _compare(arguments: argparse.Namespace) -> int:
    compare(arguments.a, arguments.b, sys.stdout)
    return 0


def _compare_parser() -> Parser:
    """Of `eval compare`: `eval` has a data set in that place."""
    parser = Parser(prog="mscf eval compare", description="Whether a difference is real, paired by sequence and start.")
    parser.add_argument("a", type=Path, metavar="A", help="a folder OUT/runs/TRACKER")
    parser.add_argument("b", type=Path, metavar="B", help="another, of the same or another evaluation")
    parser.set_defaults(run=_compare)
    return parser


def _add_bench(commands: "argparse._SubParsersAction[Parser]") -> None:
    bench = commands.add_parser(
        "bench",
        help="milliseconds by stage and kernels, beside OpenCV's CSRT",
        description="Measure an update on one thread, by stage, with each of our kernels, beside OpenCV's CSRT where "
        "this cv2 has it.",
    )
    bench.add_argument(
        "source", nargs="*", metavar="SOURCE", help="as for demo, with ground truth (default: built-in flight)"
    )
    bench.add_argument("--preset", choices=PRESETS, default="mscf", help="tracker to measure (default: %(default)s)")
    bench.add_argument("--max-frames", type=_count, default=150, metavar="N", help="of each (default: %(default)s)")
    bench.add_argument(
        "--nano",
        type=Path,
        nargs=2,
        metavar=("BACKBONE", "HEAD"),
        help="beside OpenCV's tracker nano, by its ONNX files",
    )
    bench.add_argument("--profile", action="store_true", help="also the functions that take the time")
    bench.add_argument("--json", type=Path, metavar="OUT.json", help="write the figures there too")
    bench.set_defaults(run=_bench)


def _bench(arguments: argparse.Namespace) -> int:
    options = BenchOptions(
        arguments.preset,
        arguments.max_frames,
        Models(*(arguments.nano or (None, None))),
        is_profiled=arguments.profile,
        json=arguments.json,
    )
    run_bench([open_source(source) for source in arguments.source or [None]], options, sys.stdout)
    return 0


def _count(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no count: give a whole number from 1")
    return count
