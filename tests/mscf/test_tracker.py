"""The tracker's promises: it follows by construction, keeps finite, and survives what it refuses."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from typing import Any

import cv2
import numpy as np
import pytest

from mscf import PRESETS, Box, BoxError, FrameError, Tracker, TrackerConfig, TrackerNotInitialisedError
from mscf.arrays import Image
from mscf.kernels import Kernels
from mscf.kernels.choice import chosen_kernels
from mscf.tracker import result_of

BOX = Box(140, 100, 40, 30)
# every preset by the kernels that are used here, the default one also by those of NumPy, which take four times as long
EVERY_PRESET = tuple(dict.fromkeys([*((preset, chosen_kernels().name) for preset in PRESETS), ("mscf", "numpy")]))


def textured(rng: np.random.Generator, rows: int, cols: int) -> Image:
    coarse = rng.integers(0, 256, (max(rows // 6, 2), max(cols // 6, 2), 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.uint8)


@pytest.fixture
def frame(rng: np.random.Generator) -> Image:
    return textured(rng, 240, 320)


def placed(target: Image, ground: Image, x: int, y: int) -> Image:
    """A target on a still ground."""
    picture = ground.copy()
    picture[y : y + target.shape[0], x : x + target.shape[1]] = target
    return picture


@pytest.mark.parametrize(("preset", "kernels"), EVERY_PRESET, indirect=["kernels"])
def test_every_preset_follows_a_target_over_a_still_ground(
    kernels: Kernels, rng: np.random.Generator, preset: str
) -> None:
    ground, target = textured(rng, 240, 320) // 3, textured(rng, 30, 40)
    tracker = Tracker(TrackerConfig.preset(preset), kernels)
    tracker.init(placed(target, ground, 140, 100), BOX)
    for step in range(1, 13):
        x, y = 140 + 4 * step, 100 - 3 * step
        result = tracker.update(placed(target, ground, x, y))
        assert np.hypot(result.box.x - x, result.box.y - y) < 4
    assert result.box.iou(Box(188, 64, 40, 30)) > 0.7


@pytest.mark.parametrize("shift", [(0, 0), (7, -5), (-11, 9), (20, 0)])
def test_a_shifted_frame_shifts_the_box(kernels: Kernels, frame: Image, shift: tuple[int, int]) -> None:
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    box = tracker.update(np.roll(frame, shift[::-1], axis=(0, 1))).box
    assert (box.x, box.y) == pytest.approx((BOX.x + shift[0], BOX.y + shift[1]), abs=0.3)


def test_a_target_that_grows_is_reported_larger(kernels: Kernels, frame: Image) -> None:
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    row, col = BOX.to_pos_size()[0]
    for step in range(1, 16):
        factor = 1.02**step
        matrix = np.array([[factor, 0, col * (1 - factor)], [0, factor, row * (1 - factor)]])
        result = tracker.update(np.asarray(cv2.warpAffine(frame, matrix, (320, 240)), np.uint8))
    assert result.scale == pytest.approx(1.02**15, rel=0.06)
    assert result.box.w / BOX.w == pytest.approx(result.scale)


def test_slow_growth_is_followed_without_steps(kernels: Kernels, rng: np.random.Generator) -> None:
    big = textured(rng, 480, 640)

    def worst_error(preset: str) -> float:
        tracker, errors = Tracker(TrackerConfig.preset(preset), kernels), []
        for step in range(61):
            factor = 0.4 * 1.006**step  # a fifth of a step of the scale filter a frame
            matrix = np.array([[factor, 0, 160 - 320 * factor], [0, factor, 120 - 240 * factor]])
            picture = np.asarray(cv2.warpAffine(big, matrix, (320, 240)), np.uint8)
            if step == 0:
                tracker.init(picture, Box(140, 105, 40, 30))
            else:
                errors.append(abs(tracker.update(picture).scale / 1.006**step - 1))
        return max(errors)

    assert worst_error("mscf") < 0.012
    assert worst_error("reference") > 0.015  # half a step


@pytest.mark.parametrize("size", [(9, 9), (10, 10), (40, 31), (33, 30)])
def test_a_box_of_any_size_comes_back_where_it_was(kernels: Kernels, frame: Image, size: tuple[int, int]) -> None:
    box = Box(140, 100, *size)
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, box)
    for _ in range(5):
        found = tracker.update(frame).box
    assert found.center_xy == pytest.approx(box.center_xy, abs=0.25)


def test_equal_runs_give_equal_results(kernels: Kernels, frame: Image) -> None:
    moved = np.roll(frame, 3, axis=1)
    results = []
    for _ in range(2):
        tracker = Tracker(kernels=kernels)
        tracker.init(frame, BOX)
        results.append(tracker.update(moved))
    assert results[0] == results[1]


def test_a_gray_frame_and_its_colour_copy_are_tracked_alike(kernels: Kernels, frame: Image) -> None:
    gray = np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    moved = np.roll(gray, (2, 5), axis=(0, 1))
    one, other = Tracker(kernels=kernels), Tracker(kernels=kernels)
    one.init(gray, BOX)
    other.init(np.repeat(gray[..., None], 3, axis=2), BOX)
    assert one.update(moved) == other.update(np.repeat(moved[..., None], 3, axis=2))


def test_gray_input_drops_the_colour_names(kernels: Kernels, frame: Image) -> None:
    seen: dict[str, Any] = {}
    Tracker(kernels=kernels).init(frame, BOX, probe=seen.__setitem__)
    assert seen["features_train"].shape[0] == 42
    Tracker(kernels=kernels).init(np.ascontiguousarray(frame[..., 1]), BOX, probe=seen.__setitem__)
    assert seen["features_train"].shape[0] == 32


def test_the_probe_sees_every_stage_and_changes_nothing(kernels: Kernels, frame: Image) -> None:
    moved = np.roll(frame, 4, axis=0)
    plain, probed = Tracker(kernels=kernels), Tracker(kernels=kernels)
    seen: dict[str, Any] = {}
    plain.init(frame, BOX)
    probed.init(frame, BOX, probe=seen.__setitem__)
    assert probed.update(moved, probe=seen.__setitem__) == plain.update(moved)
    assert {"patch_detect", "features_detect", "response", "pos_rc", "threat", "confidence"} <= set(seen)
    assert {"scale_features_detect", "scale_response", "label_f", "filter_f", "ideal_label_f"} <= set(seen)
    assert seen["response"].shape == (50, 50)
    assert seen["filter_f"].shape == (42, 50, 26)


def test_a_result_is_frozen_and_stays_when_the_tracker_goes_on(kernels: Kernels, frame: Image) -> None:
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    result = tracker.update(frame)
    copy = Box(result.box.x, result.box.y, result.box.w, result.box.h)
    tracker.update(np.roll(frame, 9, axis=1))
    assert result.box == copy
    with pytest.raises(FrozenInstanceError):
        result.peak = 1.0  # type: ignore[misc]


def test_the_frame_is_not_changed_and_not_kept(kernels: Kernels, frame: Image) -> None:
    before = frame.copy()
    one, other = Tracker(kernels=kernels), Tracker(kernels=kernels)
    one.init(frame, BOX)
    one.update(frame)
    np.testing.assert_array_equal(frame, before)
    kept = frame.copy()
    other.init(kept, BOX)
    other.update(kept)
    kept[:] = 0  # what the caller does with its buffer afterwards is of no account
    assert one.update(frame) == other.update(frame)


# --- occlusion and the training sample ---


def behind_a_wall(rng: np.random.Generator) -> tuple[Image, Image]:
    """A target in the open, and the same place with a featureless wall in front of it."""
    frame = placed(textured(rng, 30, 40), textured(rng, 240, 320) // 3, 140, 100)
    hidden = frame.copy()
    hidden[60:180, 90:230] = 90
    return frame, hidden


def test_a_hidden_target_is_held_where_it_was_seen_and_nothing_is_learned(
    kernels: Kernels, rng: np.random.Generator
) -> None:
    frame, hidden = behind_a_wall(rng)
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    for _ in range(5):
        before = tracker.update(frame)
    learned: list[str] = []
    for _ in range(10):
        result = tracker.update(hidden, probe=lambda name, _: learned.append(name))
        assert result.box == before.box
        assert result.peak < 0.4 * before.peak
        assert result.confidence < 0.5 < before.confidence
    assert not {"filter_f", "scale_features_train"} & set(learned)
    again = tracker.update(frame)
    assert again.box.iou(BOX) > 0.9
    assert again.peak > 0.8 * before.peak


def test_holding_ends_after_its_number_of_frames(kernels: Kernels, rng: np.random.Generator) -> None:
    frame, hidden = behind_a_wall(rng)
    tracker = Tracker(TrackerConfig(hold_frames=4), kernels)
    tracker.init(frame, BOX)
    for _ in range(3):
        tracker.update(frame)
    trained = []
    for _ in range(6):
        seen: dict[str, Any] = {}
        tracker.update(hidden, probe=seen.__setitem__)
        trained.append("filter_f" in seen)
    assert trained == [False] * 4 + [True] * 2


@pytest.mark.parametrize("preset", ["reference", "paper", "bacf"])
def test_what_was_published_never_holds(kernels: Kernels, rng: np.random.Generator, preset: str) -> None:
    frame, hidden = behind_a_wall(rng)
    tracker = Tracker(TrackerConfig.preset(preset, train_interval=1), kernels)
    tracker.init(frame, BOX)
    tracker.update(frame)
    seen: dict[str, Any] = {}
    tracker.update(hidden, probe=seen.__setitem__)
    assert "filter_f" in seen


def test_a_target_that_stays_is_learned_without_cutting_a_second_sample(kernels: Kernels, frame: Image) -> None:
    for config in (TrackerConfig(), TrackerConfig.preset("reference")):
        tracker = Tracker(config, kernels)
        tracker.init(frame, BOX)
        seen: dict[str, Any] = {}
        tracker.update(frame, probe=seen.__setitem__)
        assert "patch_train" not in seen
        assert "filter_f" in seen


@pytest.mark.parametrize(("limit_cells", "cuts"), [(0.0, True), (8.0, False), (0.5, True)])
def test_a_small_displacement_shifts_the_sample_where_the_limit_allows(
    kernels: Kernels, frame: Image, limit_cells: float, *, cuts: bool
) -> None:
    tracker = Tracker(TrackerConfig(shift_limit_cells=limit_cells), kernels)
    tracker.init(frame, BOX)
    seen: dict[str, Any] = {}
    tracker.update(np.roll(frame, 4, axis=1), probe=seen.__setitem__)  # about 1.2 cells
    assert ("patch_train" in seen) is cuts


def test_a_shifted_sample_is_nearly_the_one_cut_anew(kernels: Kernels, frame: Image) -> None:
    models = []
    for limit_cells in (0.0, 8.0):
        tracker = Tracker(TrackerConfig(shift_limit_cells=limit_cells, learning_rate=1.0), kernels)
        tracker.init(frame, BOX)
        seen: dict[str, Any] = {}
        tracker.update(np.roll(frame, (2, 4), axis=(0, 1)), probe=seen.__setitem__)
        models.append(seen["model_f"])
    cosine = np.vdot(models[0], models[1]).real / (np.linalg.norm(models[0]) * np.linalg.norm(models[1]))
    assert cosine > 0.85


# --- what long-term tracking is made of ---


def followed(kernels: Kernels, frame: Image) -> Tracker:
    """A tracker with a history."""
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    for _ in range(6):
        tracker.update(frame)
    return tracker


def test_a_restored_tracker_goes_on_as_if_nothing_had_happened(kernels: Kernels, frame: Image) -> None:
    tracker, untouched = followed(kernels, frame), followed(kernels, frame)
    snapshot = tracker.snapshot()
    for shift in (4, 9, 15):
        tracker.update(np.roll(frame, shift, axis=1))
    tracker.init(np.ascontiguousarray(frame[:200]), Box(20, 20, 50, 50))
    tracker.restore(snapshot)
    moved = np.roll(frame, (3, -5), axis=(0, 1))
    assert tracker.update(moved) == untouched.update(moved)


def test_a_look_finds_the_target_elsewhere_and_changes_nothing(kernels: Kernels, frame: Image) -> None:
    tracker, untouched = followed(kernels, frame), followed(kernels, frame)
    far = np.roll(frame, (60, -90), axis=(0, 1))
    there = tracker.look(far, (BOX.center_xy[0] - 90 + 8, BOX.center_xy[1] + 60 - 6))
    assert there.box.iou(Box(BOX.x - 90, BOX.y + 60, BOX.w, BOX.h)) > 0.85
    assert there.confidence > 0.7
    nothing = tracker.look(far, (250, 30))
    assert nothing.confidence < 0.5
    assert tracker.update(frame) == untouched.update(frame)


def test_a_look_where_the_tracker_is_sees_what_an_update_does(kernels: Kernels, frame: Image) -> None:
    tracker = followed(kernels, frame)
    moved = np.roll(frame, (2, 4), axis=(0, 1))
    row, col = tracker.snapshot().state.pos_rc
    look = tracker.look(moved, (col + 0.5, row + 0.5))
    result = tracker.update(moved)
    assert (look.peak, look.threat) == pytest.approx((result.peak, result.threat), rel=1e-3)
    assert look.box.center_xy == pytest.approx(result.box.center_xy)


@pytest.mark.parametrize("factor", [0.7, 1.5])
def test_a_look_for_another_size_finds_it(kernels: Kernels, frame: Image, factor: float) -> None:
    tracker = followed(kernels, frame)
    row, col = BOX.to_pos_size()[0]
    matrix = np.array([[factor, 0, col * (1 - factor)], [0, factor, row * (1 - factor)]])
    resized = np.asarray(cv2.warpAffine(frame, matrix, (320, 240)), np.uint8)
    fitting, other = tracker.look(resized, BOX.center_xy, factor), tracker.look(resized, BOX.center_xy)
    assert (fitting.scale, other.scale) == pytest.approx((factor, 1), abs=0.002)
    assert fitting.box.w == pytest.approx(factor * BOX.w)
    assert fitting.confidence > other.confidence


def test_tracking_goes_on_from_a_sighting_with_what_was_learned(kernels: Kernels, frame: Image) -> None:
    tracker = followed(kernels, frame)
    far = np.roll(frame, (60, -90), axis=(0, 1))
    sighting = tracker.look(far, (BOX.center_xy[0] - 90, BOX.center_xy[1] + 60))
    before = tracker.snapshot().state
    tracker.resume(sighting)
    assert tracker.snapshot().state.filter_f is before.filter_f
    result = tracker.update(far)
    assert result.box.iou(sighting.box) > 0.9
    assert result.peak == pytest.approx(sighting.peak, rel=0.2)


@pytest.mark.parametrize("learns", [True, False])
def test_a_frame_is_learned_if_what_is_said_of_it_is_good_enough(
    kernels: Kernels, frame: Image, *, learns: bool
) -> None:
    tracker = followed(kernels, frame)
    asked: list[Any] = []
    before = tracker.snapshot().state

    def learn(result: Any) -> bool:
        asked.append(result)
        return learns

    result = tracker.update(np.roll(frame, 5, axis=1), learn=learn)
    result = tracker.update(np.roll(frame, 10, axis=1), learn=learn)
    after = tracker.snapshot().state
    assert asked[-1] == result
    assert result.box.x == pytest.approx(BOX.x + 10, abs=1)  # it is followed in either case
    assert (after.filter_f is not before.filter_f) is learns
    assert (after.scale_filter is not before.scale_filter) is learns


def test_a_hidden_target_is_said_to_be_held_and_nobody_is_asked(kernels: Kernels, rng: np.random.Generator) -> None:
    frame, hidden = behind_a_wall(rng)
    tracker = followed(kernels, frame)
    assert not tracker.update(frame).is_held
    assert tracker.update(hidden, learn=lambda _: pytest.fail("asked")).is_held
    assert not tracker.look(frame, BOX.center_xy).is_held


def test_what_needs_a_target_says_so_before_init(kernels: Kernels, frame: Image) -> None:
    for call in (Tracker(kernels=kernels).snapshot, lambda: Tracker(kernels=kernels).look(frame, (10, 10))):
        with pytest.raises(TrackerNotInitialisedError, match=r"call init\(frame, box\) first"):
            call()


# --- targets and frames at the edge of what makes sense ---


@pytest.mark.parametrize(("preset", "kernels"), EVERY_PRESET, indirect=["kernels"])
@pytest.mark.parametrize(
    ("box", "why"),
    [
        (Box(-20, -15, 40, 30), "partly outside at the top left"),
        (Box(300, 225, 40, 30), "partly outside at the bottom right"),
        (Box(150, 110, 6, 6), "6 px"),
        (Box(150, 110, 4, 4), "the smallest"),
        (Box(-60, -60, 440, 360), "larger than the frame"),
        (Box(10, 100, 300, 4), "very long"),
        (Box(100.25, 80.75, 33.3, 21.9), "fractions of a pixel"),
    ],
)
def test_any_box_that_is_accepted_is_tracked_with_finite_numbers(
    kernels: Kernels, frame: Image, preset: str, box: Box, why: str
) -> None:
    tracker = Tracker(TrackerConfig.preset(preset), kernels)
    tracker.init(frame, box)
    for shift in range(1, 5):
        result = tracker.update(np.roll(frame, (shift, -shift), axis=(0, 1)))
        assert result.box.is_finite, why
        assert np.isfinite([result.peak, result.threat, result.scale, result.confidence]).all(), why
        assert 0 <= result.confidence <= 1
        assert result.box.w > 0
        assert result.box.h > 0


@pytest.mark.parametrize(("preset", "kernels"), EVERY_PRESET, indirect=["kernels"])
@pytest.mark.parametrize(
    "make", [lambda s: np.full(s, 128, np.uint8), lambda s: np.zeros(s, np.uint8), lambda s: np.full(s, 255, np.uint8)]
)
@pytest.mark.parametrize("shape", [(240, 320, 3), (240, 320)])
def test_constant_frames_leave_the_target_nearby(
    kernels: Kernels, preset: str, make: Callable[[tuple[int, ...]], Image], shape: tuple[int, ...]
) -> None:
    tracker = Tracker(TrackerConfig.preset(preset), kernels)
    tracker.init(make(shape), BOX)
    for _ in range(3):
        result = tracker.update(make(shape))
        assert result.box.is_finite
        assert np.isfinite([result.peak, result.threat, result.scale]).all()
        assert np.hypot(*np.subtract(result.box.center_xy, BOX.center_xy)) < 25  # nothing says where, nothing runs away


@pytest.mark.parametrize(("preset", "kernels"), EVERY_PRESET, indirect=["kernels"])
def test_a_target_that_goes_black_and_comes_back_keeps_the_numbers_finite(
    kernels: Kernels, frame: Image, preset: str
) -> None:
    tracker = Tracker(TrackerConfig.preset(preset), kernels)
    tracker.init(frame, BOX)
    for picture in (np.zeros_like(frame), np.full_like(frame, 255), frame, np.zeros_like(frame), frame):
        result = tracker.update(picture)
        assert result.box.is_finite
        assert np.isfinite([result.peak, result.threat, result.scale, result.confidence]).all()


@pytest.mark.parametrize("box", [Box(-150, -100, 700, 500), Box(-10, -10, 340, 260), Box(150, 110, 4, 4)])
def test_a_target_beyond_the_limits_of_scale_keeps_its_size_while_nothing_changes(
    kernels: Kernels, frame: Image, box: Box
) -> None:
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, box)
    for _ in range(4):
        assert tracker.update(frame).box.iou(box) > 0.6


def test_saturated_noise_keeps_the_numbers_finite(kernels: Kernels, rng: np.random.Generator) -> None:
    tracker = Tracker(kernels=kernels)
    extremes = np.array([0, 255], np.uint8)
    tracker.init(rng.choice(extremes, (120, 160, 3)), Box(60, 40, 30, 30))
    for _ in range(20):
        assert tracker.update(rng.choice(extremes, (120, 160, 3))).box.is_finite


def test_a_target_that_leaves_the_frame_keeps_the_numbers_finite(kernels: Kernels, rng: np.random.Generator) -> None:
    ground, target = textured(rng, 240, 320) // 3, textured(rng, 30, 40)
    tracker = Tracker(kernels=kernels)
    tracker.init(placed(target, ground, 260, 100), Box(260, 100, 40, 30))
    wide = np.zeros((240, 420, 3), np.uint8)
    wide[:, :320] = ground
    for step in range(1, 25):
        picture = placed(target, wide, 260 + 4 * step, 100)[:, :320]
        assert tracker.update(np.ascontiguousarray(picture)).box.is_finite


def test_frames_of_odd_and_tiny_size_are_tracked(kernels: Kernels, rng: np.random.Generator) -> None:
    for rows, cols in [(5, 5), (17, 333), (241, 319)]:
        frame = textured(rng, rows, cols)
        tracker = Tracker(kernels=kernels)
        tracker.init(frame, Box(0, 0, 5, 5))
        assert tracker.update(frame).box.is_finite


def test_a_frame_may_be_a_view_with_strides(kernels: Kernels, frame: Image) -> None:
    tracker, other = Tracker(kernels=kernels), Tracker(kernels=kernels)
    view = frame[::2, ::2]
    tracker.init(view, Box(70, 50, 20, 15))
    other.init(np.ascontiguousarray(view), Box(70, 50, 20, 15))
    assert tracker.update(view) == other.update(np.ascontiguousarray(view))


# --- what is refused ---


def test_update_before_init_says_what_to_do(kernels: Kernels, frame: Image) -> None:
    with pytest.raises(TrackerNotInitialisedError, match=r"call init\(frame, box\) first"):
        Tracker(kernels=kernels).update(frame)


BAD_FRAMES = [
    (np.zeros((10, 10, 3), np.float32), "uint8, got float32"),
    ([[1, 2]], "uint8, got list"),
    (None, "got None: did the video or camera open"),
    (np.zeros((10, 10, 4), np.uint8), r"\(10, 10, 4\)"),
    (np.zeros((10,), np.uint8), r"\(10,\)"),
    (np.zeros((0, 10, 3), np.uint8), r"\(0, 10, 3\)"),
]
BAD_BOXES = [
    (Box(10, 10, 0, 20), "too small"),
    (Box(10, 10, 20, -5), "too small"),
    (Box(10, 10, 3.9, 20), "at least 4 px"),
    (Box(float("nan"), 10, 20, 20), "not finite"),
    (Box(10, float("inf"), 20, 20), "not finite"),
    (Box(0, 0, 1e300, 20), "too large: .* at most 4 times"),
    (Box("1", 10, 20, 20), "not finite"),  # type: ignore[arg-type]
    ((10, 10, 20, 20), r"got tuple: make one with Box\(x, y, w, h\)"),
    (Box(320, 10, 20, 20), "outside the frame"),
    (Box(-20, 10, 20, 20), "outside the frame"),
    (Box(10, 240, 20, 20), r"must overlap x 0\.\.320, y 0\.\.240"),
]


@pytest.mark.parametrize(("bad", "text"), BAD_FRAMES)
def test_a_frame_of_the_wrong_kind_is_refused(kernels: Kernels, frame: Image, bad: Any, text: str) -> None:
    with pytest.raises(FrameError, match=text):
        Tracker(kernels=kernels).init(bad, BOX)
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    with pytest.raises(FrameError, match=text):
        tracker.update(bad)


@pytest.mark.parametrize(("box", "text"), BAD_BOXES)
def test_a_box_that_cannot_be_tracked_is_refused(kernels: Kernels, frame: Image, box: Box, text: str) -> None:
    with pytest.raises(BoxError, match=text):
        Tracker(kernels=kernels).init(frame, box)


def test_a_frame_whose_size_changed_is_refused(kernels: Kernels, frame: Image) -> None:
    tracker = Tracker(kernels=kernels)
    tracker.init(frame, BOX)
    for other in (frame[:-1], np.ascontiguousarray(frame[..., 0])):
        with pytest.raises(FrameError, match="the one given to init had"):
            tracker.update(other)


def test_an_exception_leaves_the_tracker_as_it_was(kernels: Kernels, frame: Image) -> None:
    tracker, untouched = Tracker(kernels=kernels), Tracker(kernels=kernels)
    for each in (tracker, untouched):
        each.init(frame, BOX)
    for call in (
        lambda: tracker.update(frame[:-1]),
        lambda: tracker.update(frame.astype(np.float32)),
        lambda: tracker.init(frame, Box(0, 0, 1, 1)),
    ):
        with pytest.raises((FrameError, BoxError)):
            call()
    moved = np.roll(frame, 6, axis=1)
    assert tracker.update(moved) == untouched.update(moved)


def test_a_probe_that_raises_leaves_the_tracker_as_it_was(kernels: Kernels, frame: Image) -> None:
    tracker, untouched = Tracker(kernels=kernels), Tracker(kernels=kernels)
    for each in (tracker, untouched):
        each.init(frame, BOX)

    def explode(name: str, _array: Any) -> None:
        if name == "filter_f":
            raise RuntimeError("late in the update")

    moved = np.roll(frame, 6, axis=1)
    with pytest.raises(RuntimeError):
        tracker.update(moved, probe=explode)
    assert tracker.update(moved) == untouched.update(moved)


def test_init_may_be_called_again_for_another_target(kernels: Kernels, frame: Image) -> None:
    again, fresh = Tracker(kernels=kernels), Tracker(kernels=kernels)
    again.init(frame, BOX)
    again.update(np.roll(frame, 5, axis=0))
    other = Box(40, 60, 25, 35)
    again.init(frame, other)
    fresh.init(frame, other)
    assert again.update(frame) == fresh.update(frame)


def test_a_box_that_cannot_shrink_further_is_said_to_be_the_smallest(kernels: Kernels, frame: Image) -> None:
    plan, state = (snapshot := followed(kernels, frame).snapshot()).plan, snapshot.state
    least = plan.scale.limits[0]
    assert least < plan.first_scale
    for scale, is_smallest in ((least, True), (1.02 * least, False), (plan.first_scale, False)):
        assert result_of(replace(state, scale=scale), 0.5, 0.1, 0.9, plan).is_smallest is is_smallest
    tiny = replace(plan, scale=replace(plan.scale, limits=(plan.first_scale, 9.0)))  # as small as that from the first
    assert not result_of(state, 0.5, 0.1, 0.9, tiny).is_smallest
