"""What both commands share: one-line usage errors, exit statuses, and parsers of arguments."""

import argparse
from typing import NoReturn

from mscf.geometry import Box

EXIT_USAGE = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line; `--help` has the rest."""

    def error(self, message: str) -> NoReturn:
        """End with status 2 and the line."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message} (see {self.prog} --help)\n")


def box(text: str) -> Box:
    """X,Y,W,H as a box."""
    try:
        x, y, w, h = (float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a box: give four numbers as X,Y,W,H, e.g. 618,329,53,46"
        ) from None
    return Box(x, y, w, h)
