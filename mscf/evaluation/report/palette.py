"""How trackers are told apart in all pictures of a report: by colour, and in gray by dash and marker."""

from dataclasses import dataclass

# legible on white and on the page's dark ground alike; neighbours differ in lightness as well as in hue
COLORS = (
    "#d62f34",
    "#2f86eb",
    "#219a3c",
    "#a04bd8",
    "#cc7a0c",
    "#0b8a8f",
    "#e055ab",
    "#8c5a2b",
    "#7a7f14",
    "#6e62e8",
    "#7f8790",
    "#2f97b8",
)
# on, off, ... in widths of the line; empty: solid
DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (5, 1.6),
    (1.2, 1.2),
    (7, 1.6, 1.2, 1.6),
    (2.6, 1.4),
    (10, 2.2),
    (4, 1.2, 1.2, 1.2, 1.2, 1.2),
)
MARKERS = ("", "o", "s")  # of the first, second, third round of dashes, as Matplotlib calls them


@dataclass(frozen=True, slots=True)
class Stroke:
    """How a tracker's line is drawn."""

    color: str  # #rrggbb
    dash: tuple[float, ...]  # as in DASHES
    marker: str  # as in MARKERS

    @classmethod
    def of(cls, index: int) -> "Stroke":
        """Of the tracker at `index` in the order asked for; not by rank, so that it keeps it in every picture."""
        turn, place = divmod(index, len(DASHES))
        return cls(COLORS[index % len(COLORS)], DASHES[place], MARKERS[turn % len(MARKERS)])

    @property
    def bgr(self) -> tuple[int, int, int]:
        """The colour for OpenCV."""
        red, green, blue = bytes.fromhex(self.color[1:])
        return blue, green, red
