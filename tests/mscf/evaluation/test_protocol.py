from itertools import pairwise
from pathlib import Path

import pytest

from mscf.errors import ConfigError
from mscf.evaluation.datasets import Sequence
from mscf.evaluation.protocol import starts
from mscf.geometry import Box


def sequence_of(truth: list[Box | None]) -> Sequence:
    return Sequence("made", tuple(Path(f"{i}.png") for i in range(len(truth))), tuple(truth))


def moving(frames: int) -> list[Box | None]:
    return [Box(i, 0, 20, 10) for i in range(frames)]


def indices(truth: list[Box | None], count: int = 20) -> list[int]:
    return [start.index for start in starts(sequence_of(truth), "tre", count)]


@pytest.mark.parametrize("absent", [0, 3])
def test_one_pass_starts_at_the_first_true_box(absent: int) -> None:
    truth = [None] * absent + moving(10)
    assert [(s.index, s.box) for s in starts(sequence_of(truth), "ope")] == [(absent, Box(0, 0, 20, 10))]


@pytest.mark.parametrize("protocol", ["ope", "tre", "sre"])
def test_a_sequence_without_truth_has_no_start(protocol: str) -> None:
    assert starts(sequence_of([None] * 50), protocol) == ()


def test_an_unknown_protocol_is_refused() -> None:
    with pytest.raises(ConfigError, match="unknown protocol 'vot': choose from ope, tre, sre"):
        starts(sequence_of(moving(10)), "vot")


# --- temporal ---


@pytest.mark.parametrize("frames", [39, 67, 237, 3000])
def test_by_default_there_are_twenty_starts_from_the_first_frame_to_the_last_with_twenty_left(frames: int) -> None:
    found = indices(moving(frames))
    assert len(found) == 20
    assert (found[0], found[-1]) == (0, frames - min(20, frames // 2))
    steps = [b - a for a, b in pairwise(found)]
    assert max(steps[:-1]) - min(steps[:-1]) <= 1


def test_starts_are_those_of_otb() -> None:
    # 1-based, by its code: floor(1 : 81 / 4 : 81) and 81, of the 81 frames of 100 with twenty left
    assert [index + 1 for index in indices(moving(100), 5)] == [1, 21, 41, 61, 81]
    assert [index + 1 for index in indices(moving(96), 5)] == [1, 20, 39, 58, 77]


def test_every_start_has_the_true_box_of_its_frame() -> None:
    truth = moving(100)
    assert all(start.box == truth[start.index] for start in starts(sequence_of(truth), "tre"))


@pytest.mark.parametrize(
    "bad", [None, Box(0, 0, 3, 20), Box(0, 0, 20, 3), Box(-5, 0, 20, 20), Box(0, -5, 20, 20)], ids=str
)
def test_starts_are_spread_over_frames_with_a_usable_box(bad: Box | None) -> None:
    truth = [*moving(30), *[bad] * 40, *moving(49)]
    found = indices(truth, 5)
    assert found == [0, 15, 70, 85, 99]  # of sixty usable ones: 0, 15, 30, 45, 59
    truth[0] = bad
    assert indices(truth, 1) == [1]


@pytest.mark.parametrize("frames", [2, 3, 12, 25])
def test_no_frame_starts_two_runs_and_every_run_has_an_update(frames: int) -> None:
    found = indices(moving(frames))
    assert found == sorted(set(found))
    assert found[0] == 0
    assert found[-1] == frames - max(frames // 2, 2)


def test_few_usable_frames_are_all_used() -> None:
    truth: list[Box | None] = [None] * 100
    truth[7], truth[40], truth[95] = Box(1, 1, 9, 9), Box(2, 2, 9, 9), Box(3, 3, 9, 9)
    assert indices(truth) == [7, 40]


@pytest.mark.parametrize("count", [1, 2, 7])
def test_the_number_of_starts_can_be_chosen(count: int) -> None:
    assert len(indices(moving(100), count)) == count


# --- spatial ---


def test_spatial_starts_are_four_shifts_four_moved_corners_and_four_scales() -> None:
    found = [start.box for start in starts(sequence_of([Box(100, 200, 40, 20), None, None]), "sre")]
    expected = [
        Box(96, 200, 40, 20),
        Box(104, 200, 40, 20),
        Box(100, 198, 40, 20),
        Box(100, 202, 40, 20),
        Box(96, 198, 44, 22),
        Box(100, 198, 44, 22),
        Box(96, 200, 44, 22),
        Box(100, 200, 44, 22),
        Box(104, 202, 32, 16),
        Box(102, 201, 36, 18),
        Box(98, 199, 44, 22),
        Box(96, 198, 48, 24),
    ]
    assert len(found) == 12
    for box, by_hand in zip(found, expected, strict=True):
        assert (box.x, box.y, box.w, box.h) == pytest.approx((by_hand.x, by_hand.y, by_hand.w, by_hand.h))


def test_spatial_starts_are_all_in_the_first_frame_with_a_box() -> None:
    assert {start.index for start in starts(sequence_of([None, *moving(5)]), "sre")} == {1}
