"""Preset `reference` on whole sequences: the integer boxes that the published implementation reports."""

from pathlib import Path

import numpy as np
import pytest

from mscf import Tracker, TrackerConfig
from mscf.evaluation.datasets import read_sequence
from mscf.geometry import round_half_away
from mscf.kernels import Kernels


# frames to compare (None: all), and how many of them may differ, by 1 px
@pytest.mark.parametrize(
    ("name", "frames", "allowed"),
    [
        ("wakeboard7", None, 0),
        ("truck4_1", None, 0),
        ("S0310", None, 0),
        ("MountainBike6", None, 1),
        ("Gull2", 60, 0),
    ],
)
def test_reports_the_published_boxes(
    kernels: Kernels, reference_dir: Path, sequences_dir: Path, name: str, frames: int | None, allowed: int
) -> None:
    theirs = np.loadtxt(reference_dir / "boxes" / f"{name}.txt", delimiter=",")[:frames]
    sequence = read_sequence(sequences_dir / name)
    box = sequence.truth[0]
    assert box is not None
    table = reference_dir / "color_names_reference.npz"
    tracker = Tracker(TrackerConfig.preset("reference", color_table=table), kernels)
    tracker.init(sequence.read(0), box)
    boxes = [box] + [tracker.update(sequence.read(index)).box for index in range(1, len(theirs))]
    ours = np.array([[round_half_away(value) for value in box.to_one_based()] for box in boxes])
    differing = np.abs(ours - theirs).max(axis=1)
    assert np.count_nonzero(differing) <= allowed
    assert differing.max() <= 1
