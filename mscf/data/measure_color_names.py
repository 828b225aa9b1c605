"""Measure how far `color_names.npz` agrees with another colour-name table: their centred-kernel alignment.

A development script, not imported by the package. The other table is only read, to be compared with; nothing
of it enters ours. `README.md` beside this file has the commands and the numbers.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TABLE_PATH = Path(__file__).with_name("color_names.npz")
FRAME_STEP = 20


def alignment(table: Array, other: Array, weight: Array) -> float:
    """Centred-kernel alignment (linear kernel) of two tables over weighted rows.

    Parameters
    ----------
    table, other : (N, C) and (N, D).
    weight : (N,), not negative, not all zero.

    Returns
    -------
    float in 0..1: 1 where the tables differ by a rotation, a scale and an offset only. With weighted, centred
    X and Y it is |X^T Y|_F^2 / (|X^T X|_F |Y^T Y|_F), the same as of the N x N kernels.

    References
    ----------
    Cortes, Mohri, Rostamizadeh, "Algorithms for Learning Kernels Based on Centered Alignment", JMLR 2012.
    """
    share = weight / weight.sum()
    x = (table - share @ table) * np.sqrt(share)[:, None]
    y = (other - share @ other) * np.sqrt(share)[:, None]
    return float(np.sum((x.T @ y) ** 2) / np.sqrt(np.sum((x.T @ x) ** 2) * np.sum((y.T @ y) ** 2)))


def cell_frequency(sequence: Path) -> Array:
    """Share of each of the 32768 cells in the pixels of every 20th frame of `sequence`/img, (32768,)."""
    count: Array = np.zeros(32**3)
    for path in sorted((sequence / "img").glob("*.jpg"))[::FRAME_STEP]:
        frame = cv2.imread(str(path))
        if frame is None:
            raise ValueError(f"{path} is not a readable image")
        blue, green, red = np.moveaxis(frame.astype(np.intp) >> 3, 2, 0)
        count = count + np.bincount((red + 32 * green + 1024 * blue).ravel(), minlength=32**3)
    return np.asarray(count / count.sum(), dtype=np.float64)


def main() -> int:
    """Print the alignment over all cells and, with frames, over the pixels of real sequences."""
    parser = argparse.ArgumentParser(description="Compare mscf/data/color_names.npz with another table.")
    parser.add_argument("other", type=Path, help="npz with the key `table`, (32768, 10)")
    parser.add_argument("--sequences", type=Path, help="directory of sequences, each with img/*.jpg")
    parser.add_argument("--table", type=Path, default=TABLE_PATH, help="the table to measure")
    arguments = parser.parse_args()
    with np.load(arguments.table) as own, np.load(arguments.other) as reference:
        table, other = own["table"].astype(np.float64), reference["table"].astype(np.float64)

    print(f"all cells alike   {alignment(table, other, np.ones(len(table))):.4f}")
    if arguments.sequences:
        sequences = sorted(path.parent for path in arguments.sequences.glob("*/img"))
        frequency = {sequence.name: cell_frequency(sequence) for sequence in sequences}
        mean = np.mean(list(frequency.values()), axis=0)
        print(f"pixels of frames  {alignment(table, other, mean):.4f}")
        own_norm, other_norm = mean @ (table**2).sum(axis=1), mean @ (other**2).sum(axis=1)
        print(f"mean |row|^2      {own_norm:.4f}, other {other_norm:.4f}")
        for name, weight in frequency.items():
            print(f"  {name:15} {alignment(table, other, weight):.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
