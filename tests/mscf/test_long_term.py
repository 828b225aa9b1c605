"""What long-term tracking promises: no measurement of a target that is gone, and the right one back."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from mscf import (
    Box,
    BoxError,
    ConfigError,
    Expected,
    FrameError,
    LongTermPolicy,
    LongTermResult,
    LongTermTracker,
    TrackerNotInitialisedError,
    TrackResult,
    TrackStatus,
)
from mscf.arrays import Image

if TYPE_CHECKING:
    from collections.abc import Callable

BOX = Box(140, 100, 40, 30)
FRAME_S = 0.1
TRACKING, UNSURE, LOST, CONFIRMING = TrackStatus


def textured(rng: np.random.Generator, rows: int, cols: int) -> Image:
    coarse = rng.integers(0, 256, (max(rows // 6, 2), max(cols // 6, 2), 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.uint8)


class Scene:
    """A target over a still ground, and another thing of its size."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.ground = textured(rng, 240, 400) // 3
        self.target, self.stranger = textured(rng, 30, 40), textured(rng, 30, 40)

    def empty(self) -> Image:
        return np.ascontiguousarray(self.ground[:, :320])

    def with_target(self, x: int = 140, y: int = 100) -> Image:
        return self._with(self.target, x, y)

    def with_stranger(self, x: int, y: int) -> Image:
        return self._with(self.stranger, x, y)

    def _with(self, thing: Image, x: int, y: int) -> Image:
        picture = self.ground.copy()
        picture[y : y + 30, x : x + 40] = thing
        return np.ascontiguousarray(picture[:, :320])


@pytest.fixture
def scene(rng: np.random.Generator) -> Scene:
    return Scene(rng)


class Run:
    """A tracker that has followed the still target for a while, and its clock."""

    def __init__(self, scene: Scene, policy: LongTermPolicy | None = None, frame_s: float = FRAME_S) -> None:
        self.tracker = LongTermTracker(policy=LongTermPolicy() if policy is None else policy)
        self.tracker.init(scene.with_target(), BOX)
        self.time_s, self.frame_s = 0.0, frame_s
        self.see(scene.with_target(), 8)

    def see(self, frame: Image, count: int = 1, expected: Expected | None = None) -> list[LongTermResult]:
        results = []
        for _ in range(count):
            self.time_s += self.frame_s
            results.append(self.tracker.update(frame, self.time_s, expected))
        return results


def statuses(results: list[LongTermResult]) -> list[TrackStatus]:
    return [result.status for result in results]


def test_a_target_that_is_seen_is_measured(scene: Scene) -> None:
    run = Run(scene)
    for step in range(1, 10):
        (result,) = run.see(scene.with_target(140 + 4 * step, 100 - 3 * step))
        assert result.status is TRACKING
        assert result.is_measured
        assert result.box.iou(Box(140 + 4 * step, 100 - 3 * step, 40, 30)) > 0.6


@pytest.mark.parametrize("frame_s", [1 / 4, 1 / 8, 1 / 32])
def test_a_target_that_is_gone_is_lost_after_the_same_time_at_any_frame_rate(scene: Scene, frame_s: float) -> None:
    run = Run(scene, LongTermPolicy(lost_after_s=0.5), frame_s)
    gone = run.see(scene.empty(), round(0.75 / frame_s))
    first_lost = statuses(gone).index(LOST)
    assert set(statuses(gone[:first_lost])) == {UNSURE}
    assert set(statuses(gone[first_lost:])) == {LOST}
    assert (first_lost + 1) * frame_s == 0.5
    assert not any(result.is_measured for result in gone)


def test_a_target_that_comes_out_larger_is_found_by_who_knows_how_much(scene: Scene) -> None:
    place = Box(212, 150, 56, 42)
    grown = cv2.resize(scene.target, (56, 42), interpolation=cv2.INTER_AREA)
    picture = scene.empty()
    picture[150:192, 212:268] = grown
    found = []
    for growth in (1.4, 0.7):
        run = Run(scene)
        run.see(scene.empty(), 10)
        results = run.see(picture, 12, Expected(place.center_xy, growth))
        found.append(results[-1])
    knows, errs = found
    assert knows.status is TRACKING
    assert knows.box.iou(place) > 0.6
    assert errs.status is LOST


def test_a_lost_target_stays_where_it_was_trusted_last(scene: Scene) -> None:
    run = Run(scene)
    (before,) = run.see(scene.with_target())
    for result in run.see(scene.empty(), 20)[5:]:
        assert result.status is LOST
        assert (result.box, result.scale) == (before.box, before.scale)


def test_nothing_is_learned_while_the_target_is_not_measured(scene: Scene) -> None:
    run = Run(scene)
    before = run.tracker._tracker.snapshot().state
    seen = []
    for frame in [scene.empty()] * 8 + [scene.with_target()] * 6:
        seen += run.see(frame)
        after = run.tracker._tracker.snapshot().state
        has_learned = after.filter_f is not before.filter_f, after.scale_filter is not before.scale_filter
        assert any(has_learned) <= any(result.is_measured for result in seen)
    assert any(has_learned)
    assert set(statuses(seen)) == set(TrackStatus)


@pytest.mark.parametrize("count", [2, 4, 7])
def test_a_target_that_comes_back_is_measured_after_consistent_frames_only(scene: Scene, count: int) -> None:
    run = Run(scene, LongTermPolicy(confirm_frames=count))
    run.see(scene.empty(), 10)
    back = run.see(scene.with_target(), count + 2)
    first = statuses(back).index(TRACKING)
    assert statuses(back)[first - count + 1 : first] == [CONFIRMING] * (count - 1)
    assert set(statuses(back)[: first - count + 1]) <= {LOST}
    assert set(statuses(back)[first:]) == {TRACKING}
    assert back[-1].box.iou(BOX) > 0.8


@pytest.mark.parametrize(("x", "y"), [(10, 12), (262, 190), (190, 20)])
def test_a_target_that_comes_back_elsewhere_is_found(scene: Scene, x: int, y: int) -> None:
    run = Run(scene)
    run.see(scene.empty(), 10)
    back = run.see(scene.with_target(x, y), 12)
    assert back[-1].status is TRACKING
    assert all(result.box.iou(Box(x, y, 40, 30)) > 0.5 for result in back if result.is_measured)


def test_something_else_is_not_taken_for_the_target(scene: Scene) -> None:
    run = Run(scene)
    run.see(scene.empty(), 10)
    for x, y in [(140, 100), (150, 104), (30, 40), (250, 180)]:
        assert TRACKING not in statuses(run.see(scene.with_stranger(x, y), 5))


def test_a_candidate_that_vanishes_again_is_lost_again(scene: Scene) -> None:
    run = Run(scene)
    run.see(scene.empty(), 10)
    assert statuses(run.see(scene.with_target(), 2))[-1] is CONFIRMING
    assert statuses(run.see(scene.empty(), 3)) == [LOST] * 3


def test_a_candidate_that_jumps_about_is_not_confirmed(scene: Scene) -> None:
    run = Run(scene, LongTermPolicy(confirm_frames=6))
    run.see(scene.empty(), 10)
    for _ in range(8):
        for x in (140, 205):
            (result,) = run.see(scene.with_target(x, 100))
            assert not result.is_measured


def test_a_target_that_leaves_the_frame_is_lost_and_taken_back_when_it_returns(scene: Scene) -> None:
    run = Run(scene)
    way = [min(140 + 10 * step, 340) for step in range(27)]
    for x in way:
        (result,) = run.see(scene.with_target(x, 100))
        if result.is_measured:
            assert min(result.box.x + result.box.w, 320) - result.box.x >= 0.5 * result.box.w
    assert result.status is LOST
    back = [run.see(scene.with_target(x, 100))[0] for x in [*way[::-1], *[140] * 8]]
    assert back[-1].status is TRACKING
    assert back[-1].box.iou(BOX) > 0.6


def test_a_gap_in_time_is_no_loss_while_the_target_is_seen(scene: Scene) -> None:
    run = Run(scene, frame_s=5.0)
    assert statuses(run.see(scene.with_target(), 3)) == [TRACKING] * 3
    assert statuses(run.see(scene.empty())) == [LOST]  # and nobody waits for a target that was not seen for so long


def test_a_gray_target_is_lost_and_found(scene: Scene) -> None:
    for attribute in ("ground", "target"):
        gray = cv2.cvtColor(getattr(scene, attribute), cv2.COLOR_BGR2GRAY)
        setattr(scene, attribute, np.repeat(gray[..., None], 3, axis=2))
    run = Run(scene)
    assert run.see(scene.empty(), 10)[-1].status is LOST
    assert run.see(scene.with_target(200, 60), 12)[-1].status is TRACKING


def test_a_lost_target_is_looked_for_where_it_is_expected(scene: Scene) -> None:
    run = Run(scene)
    run.see(scene.empty(), 10, Expected((30.0, 30.0)))
    memory = run.tracker._memory
    assert memory is not None
    run.tracker._memory = replace(memory, searched=2, looks=replace(memory.looks, picture=scene.stranger))
    assert run.see(scene.with_target(230, 180), 1, Expected((250.0, 195.0)))[0].status is CONFIRMING


def test_equal_runs_give_equal_results(scene: Scene) -> None:
    frames = [*[scene.empty()] * 7, *[scene.with_target(60, 60)] * 5]
    one, other = Run(scene), Run(scene)
    assert [one.see(frame) for frame in frames] == [other.see(frame) for frame in frames]


def test_a_constant_picture_ends_as_a_loss(scene: Scene) -> None:
    assert Run(scene).see(np.full_like(scene.empty(), 128), 8)[-1].status is LOST


# --- the gates, one by one ---


@pytest.mark.parametrize(
    ("change", "passes"),
    [
        ({}, True),
        ({"confidence": 0.39}, False),
        ({"is_held": True}, False),
        ({"is_smallest": True}, False),
        ({"box": Box(-21, 100, 40, 30)}, False),  # more than half of it outside
    ],
)
def test_a_box_has_to_be_all_this_to_be_a_measurement(scene: Scene, change: dict[str, Any], *, passes: bool) -> None:
    run = Run(scene)
    good = TrackResult(BOX, peak=0.5, threat=0.1, scale=1.0, confidence=0.4)
    assert run.tracker._is_measurement(scene.with_target(), replace(good, **change)) is passes


@pytest.mark.parametrize(
    ("change", "passes"),
    [
        ({}, True),
        ({"confidence": 0.49}, False),
        ({"is_held": True}, False),
        ({"scale": 2.1}, False),
        ({"scale": 1.9}, True),
        ({"scale": 0.48}, False),
        ({"scale": 0.52}, True),
        ({"box": Box(-21, 100, 40, 30)}, False),
        ({"box": Box(200, 30, 40, 30)}, False),  # looks like the ground
    ],
)
def test_a_candidate_has_to_pass_each_gate(scene: Scene, change: dict[str, Any], *, passes: bool) -> None:
    run = Run(scene)
    (seen,) = run.see(scene.with_target())
    memory = run.tracker._memory
    assert memory is not None
    good = TrackResult(BOX, peak=seen.peak, threat=seen.threat, scale=1.0, confidence=0.9)
    memory = replace(memory, scale=1.0)
    assert run.tracker._may_be_target(scene.with_target(), replace(good, **change), memory) is passes


@pytest.mark.parametrize(
    ("box", "measured"), [(Box(-19, 100, 40, 30), True), (Box(-21, 100, 40, 30), False), (Box(300, 225, 40, 30), False)]
)
def test_a_box_mostly_outside_the_frame_is_no_measurement(scene: Scene, box: Box, *, measured: bool) -> None:
    found = TrackResult(box, peak=0.1, threat=0.1, scale=1.0, confidence=0.9)
    assert LongTermTracker()._is_measurement(scene.empty(), found) is measured


# --- what is refused ---


def test_update_before_init_says_what_to_do(scene: Scene) -> None:
    with pytest.raises(TrackerNotInitialisedError, match=r"call init\(frame, box\) first"):
        LongTermTracker().update(scene.empty(), 0.0)


@pytest.mark.parametrize("visible", [True, False])
def test_what_is_refused_leaves_the_tracker_as_it_was(scene: Scene, *, visible: bool) -> None:
    run, untouched = Run(scene), Run(scene)
    frame = scene.with_target() if visible else scene.empty()
    for each in (run, untouched):
        each.see(frame, 8)
    now_s = run.time_s + FRAME_S
    refused: list[tuple[Callable[[], object], type[Exception], str]] = [
        (lambda: run.tracker.update(frame[:-1], now_s), FrameError, "the one given to init had"),
        (lambda: run.tracker.update(None, now_s), FrameError, "got None"),  # type: ignore[arg-type]
        (lambda: run.tracker.update(frame, math.nan), FrameError, "must be finite"),
        (lambda: run.tracker.update(frame, 0.05), FrameError, r"not before 1\.6 s, got 0\.05"),
        (lambda: run.tracker.update(frame, now_s, Expected((math.nan, 0.0))), BoxError, "expected must be finite"),
        (lambda: run.tracker.update(frame, now_s, Expected((9.0, 9.0), 0.0)), BoxError, "its growth above 0"),
        (lambda: run.tracker.init(frame, Box(0, 0, 1, 1)), BoxError, "too small"),
    ]
    for call, error, text in refused:
        with pytest.raises(error, match=text):
            call()
    for _ in range(3):
        assert run.see(scene.with_target()) == untouched.see(scene.with_target())


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("unsure_below", -0.1),
        ("trusted_from", 0.3),  # below unsure_below
        ("trusted_from", 1.1),
        ("min_similarity", 1.5),
        ("lost_after_s", math.nan),
        ("lost_after_s", -1.0),
        ("size_ratio", 0.5),
        ("confirm_frames", 1),
    ],
)
def test_a_policy_out_of_range_is_refused_by_name(field: str, bad: float) -> None:
    values: dict[str, Any] = {field: bad}
    with pytest.raises(ConfigError, match=rf"{field} must be from .* got {bad!r}"):
        LongTermPolicy(**values)
