import numpy as np
import pytest

from mscf.evaluation.occlusion import HIDDEN_FRAMES, hidden_span, without_target
from mscf.geometry import Box


@pytest.mark.parametrize("frames", [40, 67, 237])
def test_spans_are_spread_over_the_sequence_and_leave_its_ends_alone(frames: int) -> None:
    spans = [hidden_span(frames, run, 9) for run in range(9)]
    assert {len(span) for span in spans} == {min(HIDDEN_FRAMES, frames // 4)}
    assert spans[0].start == 5
    assert spans[-1].stop == frames - 5
    assert [span.start for span in spans] == sorted(span.start for span in spans)


def test_a_short_sequence_has_a_quarter_of_it_hidden() -> None:
    assert [len(hidden_span(12, run, 9)) for run in range(9)] == [3] * 9
    assert hidden_span(12, 0, 1).stop <= 12


@pytest.mark.parametrize("box", [Box(10, 10, 8, 6), Box(30, 2, 8, 6), Box(-3, 20, 8, 6), Box(54, 40, 12, 9)])
def test_nothing_of_the_target_is_left(box: Box) -> None:
    ground = np.zeros((48, 64, 3), np.uint8)
    frame = ground.copy()
    frame[max(int(box.y), 0) : int(box.y + box.h), max(int(box.x), 0) : int(box.x + box.w)] = 200
    before = frame.copy()
    np.testing.assert_array_equal(without_target(frame, box), ground)
    np.testing.assert_array_equal(frame, before)


def test_a_target_with_no_room_beside_it_is_covered_with_the_mean() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    covered = without_target(frame, Box(4, 4, 56, 40))
    assert np.ptp(covered.reshape(-1, 3), axis=0).tolist() == [0, 0, 0]
