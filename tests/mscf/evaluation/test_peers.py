from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mover import FIRST, moving_target

from mscf.config import PRESETS, TrackerConfig
from mscf.errors import BoxError, ConfigError
from mscf.evaluation.peers import (
    CsrtTracker,
    Models,
    OpenCvTracker,
    PeerResult,
    PlainTracker,
    has_csrt,
    tracker_factory,
    tracker_names,
)
from mscf.geometry import Box
from mscf.tracker import Tracker

FRAME = np.zeros((96, 128, 3), np.uint8)
CONTRIB = ("csrt", "kcf", "mosse")
LAST = Box(FIRST.x + 33, FIRST.y + 22, FIRST.w, FIRST.h)


def is_here(name: str) -> bool:
    return (
        hasattr(getattr(cv2, "legacy", None), "TrackerMOSSE")
        if name == "mosse"
        else hasattr(cv2, f"Tracker{name.upper()}")
    )


def follow(name: str, **given: Any) -> list[PeerResult]:
    """Results of a tracker on the moving target, which it cannot write to."""
    tracker = tracker_factory(name, **given)()
    frames = moving_target()
    for frame in frames:
        frame.setflags(write=False)
    tracker.init(frames[0], FIRST)
    return [tracker.update(frame) for frame in frames[1:]]


# --- ours ---


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_follows_a_target(name: str) -> None:
    results = follow(name)
    assert all(result.is_found for result in results)
    assert results[-1].box.iou(LAST) > 0.8


def test_a_preset_gives_the_boxes_of_the_tracker_it_is() -> None:
    tracker, frames = Tracker(), moving_target()
    tracker.init(frames[0], FIRST)
    assert [result.box for result in follow("mscf")] == [tracker.update(frame).box for frame in frames[1:]]


def test_a_variant_of_a_preset_is_a_tracker_too() -> None:
    variant = "mscf,search_area_ratio=16,label_rule=fixed"
    tracker, frames = Tracker(TrackerConfig.named(variant)), moving_target()
    tracker.init(frames[0], FIRST)
    boxes = [tracker.update(frame).box for frame in frames[1:]]
    assert [result.box for result in follow(variant)] == boxes
    assert [result.box for result in follow("mscf")] != boxes


def test_a_variant_has_the_color_table_of_all_others() -> None:
    with pytest.raises(ConfigError, match="give the table by --color-table"):
        tracker_factory("mscf,color_table=other.npz")


def test_a_color_table_that_cannot_be_read_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.npz cannot be read"):
        tracker_factory("mscf", color_table=tmp_path / "none.npz")


def test_an_unknown_tracker_is_told_all_names() -> None:
    with pytest.raises(ConfigError, match=r"unknown tracker 'best': choose from mscf, .*, csrt, .* or module:Class"):
        tracker_factory("best")
    assert set(tracker_names()) == {*PRESETS, *CONTRIB, "mil", "nano", "vit"}


# --- OpenCV's ---


@pytest.mark.parametrize("name", [*CONTRIB, "mil"])
def test_a_tracker_of_opencv_gives_the_same_boxes_whatever_ran_before(name: str) -> None:
    if not is_here(name):
        pytest.skip(f"this cv2 has no {name}: it is in opencv-contrib-python-headless")
    before = follow(name)
    cv2.setRNGSeed(7)
    assert follow(name) == before
    if name != "mosse":  # which loses it at once
        assert before[0].is_found
        assert before[2].box.iou(Box(FIRST.x + 9, FIRST.y + 6, FIRST.w, FIRST.h)) > 0.3


@pytest.mark.parametrize("name", CONTRIB)
def test_what_this_cv2_has_not_got_is_one_line_with_the_mend(name: str) -> None:
    if is_here(name):
        pytest.skip(f"this cv2 has {name}")
    with pytest.raises(ConfigError, match=f"{name.upper()} is not in this cv2.*opencv-contrib-python-headless in pla"):
        tracker_factory(name)
    if name == "csrt":
        assert not has_csrt()
        with pytest.raises(ConfigError, match="CSRT is not in this cv2"):
            CsrtTracker()


@pytest.mark.parametrize(("name", "model"), [("nano", "nano_backbone"), ("vit", "vit")])
def test_a_missing_or_broken_model_is_named_before_anything_runs(name: str, model: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"no model {model}: bring"):
        tracker_factory(name)
    broken = tmp_path / "broken.onnx"
    with pytest.raises(ConfigError, match=r"broken\.onnx, which is not a file"):
        tracker_factory(name, Models(broken, broken, broken))
    broken.write_bytes(b"no model")
    with pytest.raises(ConfigError, match=f"{name}: OpenCV cannot read its model: .*"):
        tracker_factory(name, Models(broken, broken, broken))


def test_nano_follows_a_target_where_the_models_are_given(reference_dir: Path) -> None:
    models = [reference_dir / "nanotrack" / f"nanotrack_{part}_sim.onnx" for part in ("backbone", "head")]
    if not all(path.is_file() for path in models):
        pytest.skip("the reference data has no models of NanoTrack")
    results = follow("nano", models=Models(*models))
    assert results[-1].box.iou(LAST) > 0.7
    assert follow("nano", models=Models(*models)) == results


class Scripted:
    """OpenCV's interface."""

    def __init__(self, *answers: Any) -> None:
        self.answers = list(answers)
        self.given: tuple[int, ...] = ()

    def init(self, frame: Any, box: Any) -> None:
        self.given = box

    def update(self, frame: Any) -> Any:
        return self.answers.pop(0)


def test_a_loss_keeps_the_last_box() -> None:
    tracker = OpenCvTracker(Scripted((False, (0, 0, 0, 0)), (True, (5, 6, 7, 8)), (False, (0, 0, 0, 0))))
    tracker.init(FRAME, Box(10.4, 20, 30, 40))
    assert [tracker.update(FRAME) for _ in range(3)] == [
        PeerResult(Box(10.4, 20, 30, 40), is_found=False),
        PeerResult(Box(5, 6, 7, 8), is_found=True),
        PeerResult(Box(5, 6, 7, 8), is_found=False),
    ]


@pytest.mark.parametrize(
    ("box", "given"),
    [
        (Box(10.4, 20.6, 30.4, 40), (10, 21, 30, 40)),
        (Box(-5, -3, 20, 20), (0, 0, 15, 17)),
        (Box(120, 90, 20, 20), (120, 90, 8, 6)),
        (Box(-9, -9, 300, 300), (0, 0, 128, 96)),
    ],
)
def test_opencv_is_given_whole_pixels_inside_the_frame(box: Box, given: tuple[int, ...]) -> None:
    scripted = Scripted()
    OpenCvTracker(scripted).init(FRAME, box)
    assert scripted.given == given


@pytest.mark.parametrize("box", [Box(40, 30, 1, 40), Box(40, 30, 4, 4), Box(127, 95, 20, 20), Box(200, 200, 20, 20)])
def test_a_box_that_opencvs_mil_would_never_return_from_is_refused(box: Box) -> None:
    with pytest.raises(BoxError, match="too few pixels in the frame of 128 x 96"):
        tracker_factory("mil")().init(FRAME, box)


# --- one's own ---


class Answer:
    def __init__(self, box: Any, **flags: bool) -> None:
        self.box = box
        self.__dict__.update(flags)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (Answer(Box(1, 2, 3, 4)), PeerResult(Box(1, 2, 3, 4), is_found=True)),
        (Answer((1, 2, 3, 4)), PeerResult(Box(1, 2, 3, 4), is_found=True)),
        (Answer(np.array([1, 2, 3, 4])), PeerResult(Box(1, 2, 3, 4), is_found=True)),
        (Answer(Box(1, 2, 3, 4), is_found=False), PeerResult(FIRST, is_found=False)),
        ((True, Box(1, 2, 3, 4)), PeerResult(Box(1, 2, 3, 4), is_found=True)),
        ((True, [1, 2, 3, 4]), PeerResult(Box(1, 2, 3, 4), is_found=True)),
        ((False, None), PeerResult(FIRST, is_found=False)),
    ],
)
def test_ones_own_tracker_may_answer_in_either_way(answer: Any, expected: PeerResult) -> None:
    tracker = PlainTracker(Scripted(answer))
    tracker.init(FRAME, FIRST)
    found = tracker.update(FRAME)
    assert found == expected
    assert type(found.box.x) is float or found.box is FIRST


@pytest.mark.parametrize("answer", [None, 7, (True,), (True, 1, 2, 3, 4)])
def test_an_answer_of_another_kind_is_an_error(answer: Any) -> None:
    tracker = PlainTracker(Scripted(answer))
    tracker.init(FRAME, FIRST)
    with pytest.raises(TypeError, match=r"expected something with \.box, or \(found, box\)"):
        tracker.update(FRAME)


@pytest.mark.parametrize(
    "box", [(1, 2, 3), None, (float("nan"), 2, 3, 4), (1, 2, float("inf"), 4), (1, 2, 0, 4), Box(1, 2, 3, -4), "here"]
)
def test_a_box_that_is_none_is_an_error_and_the_last_one_is_kept(box: Any) -> None:
    tracker = PlainTracker(Scripted((True, (1, 2, 3, 4)), (True, box), (False, None)))
    tracker.init(FRAME, FIRST)
    tracker.update(FRAME)
    with pytest.raises(BoxError, match="update gave the box"):
        tracker.update(FRAME)
    assert tracker.update(FRAME).box == Box(1, 2, 3, 4)


def test_ones_own_class_is_found_by_module_and_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_broken.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert follow("mscf:Tracker") == follow("mscf")
    for name, expected in (
        ("no_such_module:Tracker", r"'no_such_module' cannot be imported: ModuleNotFoundError.*PYTHONPATH"),
        ("own_broken:Tracker", "'own_broken' cannot be imported: ZeroDivisionError: division by zero"),
        ("mscf:Nothing", r"mscf has no class 'Nothing' with init\(frame, box\) and update\(frame\)"),
        ("mscf:Box", "mscf has no class 'Box' with init"),
        (":Tracker", "cannot be imported"),
    ):
        with pytest.raises(ConfigError, match=expected):
            tracker_factory(name)
