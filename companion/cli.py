"""Command `mscf-companion`."""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version

EXIT_USAGE = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    This release carries the tracker only: the command says so rather than pretend to fly.
    """
    parser = argparse.ArgumentParser(
        prog="mscf-companion",
        description="The application on the vehicle. This release has the tracker only (command mscf): "
        "nothing here connects to an autopilot or moves a vehicle yet.",
    )
    parser.add_argument("--version", action="version", version=f"mscf-companion {version('mscf-companion')}")
    parser.parse_args(argv)
    print("mscf-companion: this release cannot run on a vehicle yet: see the tracker with `mscf demo`", file=sys.stderr)
    return EXIT_USAGE
