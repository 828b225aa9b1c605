"""Command `mscf-companion`: run, check, ctl, replay, example; others, such as the simulator's, register themselves."""

import argparse
import json
import logging
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import entry_points, version
from importlib.resources import files
from pathlib import Path

import cv2
from threadpoolctl import threadpool_limits

from companion.app import App
from companion.check import check_camera, check_link, check_record, describe, print_signs
from companion.config import FILE_NAME, Config, read, warnings, without_passwords
from companion.control_socket import ORDER_NAMES, ControlSocket, ask
from companion.errors import CompanionError, ConfigError, UsageError
from companion.link import check_device
from companion.notify import Notifier
from companion.replay import replay
from companion.signing import read_key
from mscf import MscfError
from mscf.command_line import EXIT_BROKEN_PIPE, EXIT_INTERRUPTED, EXIT_USAGE, Parser, box
from mscf.kernels.choice import chosen_kernels, native_fault

EXIT_FAILED = 1
EXIT_CONFIG = 78  # EX_CONFIG of sysexits.h: the unit does not start again after it
DEFAULT_CONFIG = Path("/etc/mscf-companion") / FILE_NAME
DEFAULT_SOCKET = Path("/run/mscf-companion/control.sock")
COMMANDS = "companion.commands"  # entry points: functions that add a command to the parser
EXAMPLES = {"ardupilot": "copter.toml", "px4": "px4.toml"}

logger = logging.getLogger("companion")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status: 2 for bad usage, 78 for a bad configuration."""
    words = sys.argv[1:] if argv is None else argv
    arguments = _parser(words).parse_args(words)
    threadpool_limits(1, "blas")  # the tracker's matrix products are too small to be worth sharing
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return int(arguments.run(arguments))
    except ConfigError as error:
        print(f"mscf-companion: {error}", file=sys.stderr)
        return EXIT_CONFIG
    except (CompanionError, MscfError) as error:
        print(f"mscf-companion: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # whoever read our output has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE


def _parser(words: Sequence[str]) -> Parser:
    parser = Parser(prog="mscf-companion", description="Tracks a target and keeps a multicopter looking at it.")
    parser.add_argument("--version", action="version", version=f"mscf-companion {version('mscf-companion')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run on the vehicle", description="Run until SIGTERM or Ctrl-C.")
    _add_config(run)
    run.add_argument("--log-level", choices=("debug", "info", "warning"), default="info")
    run.set_defaults(run=_run)

    check = commands.add_parser(
        "check",
        help="check a configuration, the record, the camera, the link and the signs",
        description="Check a configuration, and try whether a flight record can be written; exit status 78 where the "
        "configuration is wrong, 1 where record, camera or link fail.",
    )
    _add_config(check)
    check.add_argument("--camera", action="store_true", help="open the camera, measure frame rate and age")
    check.add_argument("--link", action="store_true", help="listen for the autopilot, read parameters, advise")
    check.add_argument("--signs", action="store_true", help="say which way the vehicle would move")
    check.set_defaults(run=_check)

    ctl = commands.add_parser(
        "ctl", help="talk to a running application", description="Give an order to a running application."
    )
    ctl.add_argument("order", choices=ORDER_NAMES)
    ctl.add_argument("box", nargs="?", type=box, metavar="X,Y,W,H", help="for select; without it: the middle")
    ctl.add_argument("--socket", type=Path, default=DEFAULT_SOCKET, help="control.socket (default: %(default)s)")
    ctl.add_argument("--json", action="store_true", help="print the whole answer")
    ctl.set_defaults(run=_ctl)

    again = commands.add_parser(
        "replay",
        help="decide a recorded flight again, and compare",
        description="Run the recorded inputs of a flight through the controller and compare every output to the bit. "
        "Exit status 1 where one differs, or where steps are missing.",
    )
    again.add_argument("folder", type=Path, metavar="DIR", help="the folder of the flight record")
    again.set_defaults(run=_replay)

    example = commands.add_parser(
        "example", help="print a complete commented configuration", description="Print an example configuration."
    )
    example.add_argument("vehicle", choices=EXAMPLES)
    example.set_defaults(run=_example)

    # what others bring is loaded only where it may be asked for: on the vehicle, it cannot keep `run` from starting
    if not words or words[0] not in commands.choices:
        for entry in sorted(entry_points(group=COMMANDS), key=lambda entry: entry.name):
            entry.load()(commands)
    return parser


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-c", "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="default: %(default)s"
    )


def _config(path: Path) -> Config:
    config = read(path)
    try:
        check_device(config.link.device)
    except UsageError as error:  # in a file it is a wrong configuration: starting again does not mend it
        raise ConfigError(f"{path}: link.device: {error}") from error
    try:
        chosen_kernels()
    except MscfError as error:  # likewise
        raise ConfigError(str(error)) from error
    read_key(config.signing, os.environ)  # now rather than after the camera has been looked at
    return config


def _run(arguments: argparse.Namespace) -> int:
    configure_log(arguments.log_level)
    config = _config(arguments.config)
    for line in warnings(config):
        logger.warning("config: %s", line)
    logger.info("mscf-companion %s, %s", version("mscf-companion"), describe(config))
    logger.info("tracker: %s kernels", chosen_kernels().name)
    logger.info("config %s", json.dumps(asdict(without_passwords(config))))
    return App(config, Notifier.from_environment(), _control_socket(config.control.socket)).run()


def _control_socket(path: str) -> ControlSocket | None:
    if not path:
        return None
    try:
        return ControlSocket(Path(path))
    except OSError as error:
        raise ConfigError(
            f"control.socket = {path!r} cannot be used: {error.strerror or error}; "
            "give a path in a folder that is there and yours, or an empty text"
        ) from error


def _check(arguments: argparse.Namespace) -> int:
    config = _config(arguments.config)
    print(f"config    {arguments.config}: {describe(config)}")
    for line in warnings(config):
        print(f"          WARNING: {line}")
    print(f"tracker   {chosen_kernels().name} kernels")
    if native_fault():
        print(f"          WARNING: {native_fault()}; the tracker takes three times as long")
    if arguments.signs:
        print_signs(config, sys.stdout)
    is_right = check_record(config, os.environ, sys.stdout)
    if arguments.camera:
        is_right = check_camera(config, sys.stdout) and is_right
    if arguments.link:
        is_right = check_link(config, sys.stdout) and is_right
    return 0 if is_right else EXIT_FAILED


def _ctl(arguments: argparse.Namespace) -> int:
    request: dict[str, object] = {"do": arguments.order}
    if arguments.box is not None:
        request["box"] = [arguments.box.x, arguments.box.y, arguments.box.w, arguments.box.h]
    answer = ask(arguments.socket, request)
    if arguments.json:
        print(json.dumps(answer, indent=2))
    elif "error" in answer:
        print(f"mscf-companion: {answer['error']}", file=sys.stderr)
    else:
        print(_in_lines(answer))
    return EXIT_USAGE if "error" in answer else 0


def _in_lines(status: dict[str, object]) -> str:
    """A status for the eye: one line a group of figures, what is not known left out."""
    lines = [f"mode       {status['mode']}"]
    for name in ("texts", "notes", "faults"):
        values = status[name]
        if isinstance(values, list):
            lines += [f"{name:10} {value}" for value in values]
    lines.append(
        f"target     {status['target']}, confidence {status['confidence']}, box {status['box']}, "
        f"range {status['range_m']} m"
    )
    lines.append(
        f"camera     {status['frames_per_s']} frames/s, frame age {status['frame_age_ms']} ms, "
        f"dropped {status['frames_dropped']}"
    )
    lines.append(
        f"autopilot  {status['autopilot']}, {status['flight_mode']}, armed {status['is_armed']}, "
        f"height {status['height_m']} m, battery {status['battery_pct']} %"
    )
    dropped = f"dropped {status['record_steps_dropped']} steps, {status['record_frames_dropped']} frames"
    lines.append(f"record     {status['record']}, {dropped}")
    return "\n".join(lines)


def _replay(arguments: argparse.Namespace) -> int:
    result = replay(arguments.folder)
    if result.recorded_by is not None:
        print(f"recorded by mscf-companion {result.recorded_by}, replayed by {version('mscf-companion')}")
    difference = result.difference
    if difference is not None:
        print(
            f"step {difference.step}, {difference.time_s:.2f} s after the first: {difference.field} "
            f"was {difference.recorded}, is {difference.replayed}"
        )
        return EXIT_FAILED
    if result.missing:
        print(f"{result.steps} steps, all equal; the next {result.missing} were not recorded: what follows is unknown")
        return EXIT_FAILED
    raised = f"; in the last one the controller raised {result.raised}" if result.raised else ""
    ending = (
        ""
        if result.is_whole or result.raised
        else "; the record breaks off there: the process was killed, or the disk was full"
    )
    print(f"{result.steps} steps, all equal{raised}{ending}")
    return 0


def _example(arguments: argparse.Namespace) -> int:
    print(files("companion").joinpath("examples", EXAMPLES[arguments.vehicle]).read_text(encoding="utf-8"), end="")
    return 0


class _JournalFormatter(logging.Formatter):
    """`<N>` priorities, which the journal reads from stderr; it stamps the time itself."""

    _PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))

    def format(self, record: logging.LogRecord) -> str:
        """One prefixed line."""
        priority = next(number for level, number in self._PRIORITIES if record.levelno >= level)
        return f"<{priority}>{super().format(record)}"


def configure_log(level: str) -> None:
    """Log to stderr; in the journal's form where systemd started us."""
    handler = logging.StreamHandler()
    if "JOURNAL_STREAM" in os.environ:
        handler.setFormatter(_JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[handler])
