"""Make `color_names.npz`: the eleven basic colour names of every cell of a 32x32x32 RGB grid.

A development script, not imported by the package. It knows three things and nothing else: the colours people
gave names to in the XKCD survey (CC0, in matplotlib), which basic name each of those names belongs to
(English, `HUE_WORDS` below), and how a camera sees a surface (in shade, in gloss and haze, and at low chroma
as grey). `README.md` beside this file has the provenance and the numbers.

`python mscf/data/make_color_names.py` writes the file, `--check` compares it with a new computation.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.colors import XKCD_COLORS, to_rgb

Array = npt.NDArray[np.float64]

TABLE_PATH = Path(__file__).with_name("color_names.npz")

NAMES = ("black", "blue", "brown", "grey", "green", "orange", "pink", "purple", "red", "white", "yellow")
ACHROMATIC = ("black", "grey", "white")
HUES = tuple(name for name in NAMES if name not in ACHROMATIC)

# What the colour words of the survey are in basic hues; a word under two hues is half of each. Words for
# black, grey and white are left out, as are the pale or greyish ones between (cream, beige, taupe, slate): they
# say little about hue, and those three names come from the grey axis below. So are the survey's coarse words.
HUE_WORDS = {
    "blue": """
        bluish burple blurple azul azure navy cerulean cobalt sapphire denim sky cornflower ultramarine
        marine ocean cyan robin blueberry teal turquoise aqua aquamarine sea petrol topaz periwinkle
        perrywinkle indigo twilight""",
    "brown": """
        tan fawn camel caramel chocolate coffee mocha cocoa chestnut hazel cinnamon umber siena sienna sepia
        leather earth dirt mud clay bronze mushroom puce russet sandstone khaki drab adobe terracotta
        terracota cotta copper rust auburn mahogany maroon sand wheat buff mustard ochre ocher ocre""",
    "green": """
        sage moss forest grass leaf fern pine spruce evergreen wintergreen shamrock emerald jade lime mint
        spearmint viridian seafoam seaweed algae avocado asparagus pea pear kiwi celery celadon pistachio
        swamp lichen camo tea apple olive teal turquoise aqua aquamarine sea petrol topaz khaki drab
        chartreuse""",
    "orange": """
        orangish tangerine pumpkin mango apricot squash cheese amber saffron marigold butterscotch adobe
        terracotta terracota cotta copper rust salmon coral peach melon grapefruit""",
    "pink": """
        rose rosa carnation bubblegum blush cerise magenta fuchsia mauve orchid salmon coral peach melon
        grapefruit watermelon strawberry raspberry lipstick rouge""",
    "purple": """
        violet urple burple blurple purplish purply lavender lavendar lilac liliac plum eggplant aubergine
        grape amethyst wisteria heather heliotrope mulberry velvet bruise iris magenta fuchsia mauve orchid
        periwinkle perrywinkle indigo twilight berry""",
    "red": """
        reddish reddy crimson scarlet ruby cherry blood carmine cranberry claret burgundy bordeaux wine
        merlot tomato vermillion brick watermelon strawberry raspberry lipstick rouge auburn mahogany maroon
        berry""",
    "yellow": """
        gold golden goldenrod lemon canary dandelion sunflower butter custard straw maize manilla banana
        sand wheat buff mustard ochre ocher ocre amber saffron marigold butterscotch chartreuse""",
}

_HUES_OF_WORD = {
    word: [hue for hue in HUES if word == hue or word in HUE_WORDS[hue].split()]
    for word in (*HUES, *" ".join(HUE_WORDS.values()).split())
}
_ACHROMATIC_WORD = "|".join((*ACHROMATIC, "gray"))
_HUE_WORD = "|".join(sorted(_HUES_OF_WORD, key=lambda word: (-len(word), word)))
# One or two hue words without a space: "darkgreen", "greyblue", "bluegreen", "pinkish", "orangey".
_COLOUR_TOKEN = re.compile(f"(?:light|dark|{_ACHROMATIC_WORD})?({_HUE_WORD})?({_HUE_WORD})(?:ish|ey|y)?")

# The scalars of the method, chosen with the alignment to the published table in view (see README.md).
SHADES = (
    1.0,
    0.7,
    0.49,
    0.343,
)  # a named surface is seen at these fractions of its RGB value: the shaded side
TINTS = (0.0, 0.25, 0.5)  # and mixed with this share of white: gloss and haze
KERNEL_WIDTH = 15.0  # standard deviation of a name in CIELAB, in units of delta E
CLASS_BALANCE = 0.5  # 0: every survey name counts the same, 1: every basic name does
SHARPNESS = 2.0  # exponent on the hue probabilities
BLACK_BELOW, WHITE_ABOVE = 25.0, 76.0  # borders of grey in lightness L*
LIGHTNESS_SOFTNESS = 16.0  # width of those borders (logistic), in L*
GREY_BELOW_CHROMA = 20.0  # chroma C* at which the achromatic share has halved
CHROMA_SOFTNESS = 5.0  # width of that border (logistic), in C*
ACHROMATIC_SHARE = 0.8  # on the grey axis; the rest goes to hues: grey pixels are seldom only grey

TABLE_STEP = 1 / 2048  # the table is rounded to this; float16 holds its multiples up to 1 exactly

_CELLS = 32
_CHUNK = 1024


def cielab(rgb: Array) -> Array:
    """CIELAB (D65) of sRGB colours.

    Parameters
    ----------
    rgb : (N, 3), 0..255.

    Returns
    -------
    ndarray of shape (N, 3), float64: L* in 0..100, a*, b*.

    References
    ----------
    IEC 61966-2-1 (sRGB) and CIE 15 (CIELAB).
    """
    value = rgb / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    xyz_from_rgb = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    xyz = linear @ xyz_from_rgb.T / xyz_from_rgb.sum(axis=1)  # (N, 3), relative to white
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    lab = np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)
    return np.asarray(lab, dtype=np.float64)


def cell_centres() -> Array:
    """Centre colours of the grid's cells, (32768, 3) RGB, row R>>3 + 32*(G>>3) + 1024*(B>>3)."""
    row = np.arange(_CELLS**3)
    cell = np.stack([row % _CELLS, row // _CELLS % _CELLS, row // _CELLS**2], axis=1)
    return np.asarray(cell * 8 + 3.5, dtype=np.float64)  # a cell holds the integers 8k .. 8k+7


def hue_label(name: str) -> Array | None:
    """Share of each basic hue in a colour name: the mean over the hue words in it.

    Parameters
    ----------
    name : of the survey, for example "dark greenish blue" or "yellow/green".

    Returns
    -------
    ndarray of shape (8,), float64, sum 1, in the order of `HUES`; None where the name has no hue word or is
    a kind of black, grey or white ("bluish grey").
    """
    if re.search(f"(?:{_ACHROMATIC_WORD})$", name):
        return None
    shares = []
    for token in re.findall("[a-z]+", name):
        parts = _COLOUR_TOKEN.fullmatch(token)
        for word in parts.groups() if parts else ():
            if word is not None:
                hues = _HUES_OF_WORD[word]
                shares.append([hues.count(hue) / len(hues) for hue in HUES])
    return np.array(shares).mean(axis=0) if shares else None


def observed(rgb: Array) -> Array:
    """Colours in which a camera sees surfaces of the colours `rgb` (N, 3), (TINTS x SHADES, N, 3)."""
    return np.stack([((1 - tint) * rgb + tint * 255) * shade for tint in TINTS for shade in SHADES])


def hue_probabilities(lab: Array) -> Array:
    """Probability of each basic hue, given that the colour is not black, grey or white.

    Kernel regression in CIELAB on the survey's names, each seen in every shade and tint, then sharpened.

    Parameters
    ----------
    lab : (N, 3), CIELAB.

    Returns
    -------
    ndarray of shape (N, 8), float64, rows sum to 1, in the order of `HUES`.
    """
    labelled = [(color, hue_label(name.removeprefix("xkcd:"))) for name, color in XKCD_COLORS.items()]
    labelled = [(color, label) for color, label in labelled if label is not None]
    rgb = np.round(255 * np.array([to_rgb(color) for color, _ in labelled]))  # (names, 3)
    labels = np.array([label for _, label in labelled])  # (names, 8)
    weights = labels / labels.sum(axis=0) ** CLASS_BALANCE
    sightings = [cielab(seen) for seen in observed(rgb)]

    probability = np.empty((len(lab), len(HUES)))
    for start in range(0, len(lab), _CHUNK):
        x = lab[start : start + _CHUNK]
        distance2 = np.stack(
            [(x**2).sum(axis=1)[:, None] + (y**2).sum(axis=1) - 2 * x @ y.T for y in sightings]
        )  # (sightings, chunk, names)
        distance2 = distance2 - distance2.min(axis=(0, 2))[:, None]  # the nearest counts 1: no underflow far away
        kernel = np.exp(-distance2 / (2 * KERNEL_WIDTH**2)).sum(axis=0)  # (chunk, names)
        probability[start : start + _CHUNK] = kernel @ weights
    probability = (probability / probability.sum(axis=1, keepdims=True)) ** SHARPNESS
    return np.asarray(probability / probability.sum(axis=1, keepdims=True), dtype=np.float64)


def achromatic_probabilities(lab: Array) -> Array:
    """Probability of black, grey and white: by lightness among themselves, together by chroma.

    Parameters
    ----------
    lab : (N, 3), CIELAB.

    Returns
    -------
    ndarray of shape (N, 3), float64; the row sums are at most `ACHROMATIC_SHARE`.
    """
    lightness, chroma = lab[:, 0], np.hypot(lab[:, 1], lab[:, 2])
    black = 1 / (1 + np.exp((lightness - BLACK_BELOW) / LIGHTNESS_SOFTNESS))
    white = 1 / (1 + np.exp((WHITE_ABOVE - lightness) / LIGHTNESS_SOFTNESS))
    share = ACHROMATIC_SHARE / (1 + np.exp((chroma - GREY_BELOW_CHROMA) / CHROMA_SOFTNESS))
    # black + white < 1 at every lightness, because BLACK_BELOW < WHITE_ABOVE.
    return np.stack([black, 1 - black - white, white], axis=1) * share[:, None]


def name_probabilities(rgb: Array) -> Array:
    """Probability of each of `NAMES` for the colours `rgb` (N, 3), 0..255: (N, 11), rows sum to 1."""
    lab = cielab(rgb)
    grey_axis = achromatic_probabilities(lab)
    hues = hue_probabilities(lab) * (1 - grey_axis.sum(axis=1, keepdims=True))
    columns = dict(zip(ACHROMATIC, grey_axis.T, strict=True)) | dict(zip(HUES, hues.T, strict=True))
    return np.stack([columns[name] for name in NAMES], axis=1)


def sum_zero_basis() -> Array:
    """Orthonormal basis of the vectors of sum zero, (11, 10): the Helmert matrix without its constant row."""
    size = len(NAMES)
    basis = np.zeros((size, size - 1))
    for k in range(1, size):
        basis[:k, k - 1] = 1 / np.sqrt(k * (k + 1))
        basis[k, k - 1] = -k / np.sqrt(k * (k + 1))
    return basis


def make_table() -> npt.NDArray[np.float16]:
    """The table of the package: (32768, 10) float16, row = basis^T p of the cell's centre colour."""
    table = name_probabilities(cell_centres()) @ sum_zero_basis()
    # Column-major: neighbouring cells of one channel lie side by side, which compresses better.
    return np.asfortranarray(np.round(table / TABLE_STEP) * TABLE_STEP, dtype=np.float16)


def main() -> int:
    """Write the table, or with `--check` compare it with the file; 1 on a difference."""
    parser = argparse.ArgumentParser(description="Make mscf/data/color_names.npz.")
    parser.add_argument("--check", action="store_true", help="compare with the file instead of writing it")
    parser.add_argument("--output", type=Path, default=TABLE_PATH, help="file to write or to compare with")
    arguments = parser.parse_args()
    path: Path = arguments.output
    table, basis = make_table(), sum_zero_basis()
    if not arguments.check:
        # numpy stamps the members with 1980-01-01, not with the time of day: the same bytes on every run.
        np.savez_compressed(path, table=table, basis=basis)
        print(f"{path}: {path.stat().st_size} bytes")
        return 0
    with np.load(path) as stored:
        is_same = np.array_equal(stored["table"], table) and np.allclose(stored["basis"], basis)
    print(f"{path}: {'same as' if is_same else 'DIFFERS from'} a new computation")
    return 0 if is_same else 1


if __name__ == "__main__":
    sys.exit(main())
