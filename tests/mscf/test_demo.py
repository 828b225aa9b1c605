"""`mscf demo`, run in this process: what it writes, says and refuses."""

import re
from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from mover import FRAMES

from mscf import cli
from mscf.arrays import Image
from mscf.images import read_truth
from mscf.source import ImageSource


def frames_in(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def test_it_writes_video_boxes_and_plot(sequence_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video, boxes, plot = tmp_path / "a.mp4", tmp_path / "a.txt", tmp_path / "a.png"
    arguments = ["demo", str(sequence_dir), "--compare", "bacf", "--save", str(video), "--boxes", str(boxes)]
    assert cli.main([*arguments, "--plot", str(plot)]) == 0
    assert frames_in(video) == FRAMES
    assert plot.read_bytes().startswith(b"\x89PNG")
    truth, found = read_truth(sequence_dir / "groundtruth.txt"), read_truth(boxes)
    for box, true in zip(found, truth, strict=True):
        assert box is not None
        assert true is not None
        assert box.iou(true) > 0.6
    said = capsys.readouterr().out
    median = r"[\d.]+ ms an update \(median, (native|numpy) kernels\)"
    assert re.search(rf"mscf: 12 frames, {median}, precision at 20 px 1\.000, AUC 0\.\d+", said)
    assert "bacf: 12 frames" in said
    assert f"wrote {video}" in said


def test_a_box_on_the_command_line_is_zero_based(sequence_dir: Path, tmp_path: Path) -> None:
    (sequence_dir / "groundtruth.txt").unlink()
    boxes = tmp_path / "a.txt"
    assert cli.main(["demo", str(sequence_dir), "--box", "40,30,24,18", "--boxes", str(boxes), "--no-progress"]) == 0
    assert boxes.read_text().splitlines()[0] == "41.00,31.00,24.00,18.00"


def test_max_frames_stops_early(sequence_dir: Path, tmp_path: Path) -> None:
    boxes = tmp_path / "a.txt"
    assert cli.main(["demo", str(sequence_dir), "--boxes", str(boxes), "--max-frames", "4"]) == 0
    assert len(boxes.read_text().splitlines()) == 4


def test_without_a_box_it_says_how_to_give_one(sequence_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (sequence_dir / "groundtruth.txt").unlink()
    assert cli.main(["demo", str(sequence_dir)]) == 2
    assert "--box X,Y,W,H" in capsys.readouterr().err


def test_a_broken_image_in_the_middle_keeps_what_was_tracked(
    sequence_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (sequence_dir / "img" / "000008.png").write_bytes(b"broken")
    video, boxes, plot = tmp_path / "a.mp4", tmp_path / "a.txt", tmp_path / "a.png"
    arguments = ["demo", str(sequence_dir), "--save", str(video), "--boxes", str(boxes), "--plot", str(plot)]
    assert cli.main(arguments) == 2
    assert len(boxes.read_text().splitlines()) == 7
    assert frames_in(video) == 7
    assert plot.exists()
    error = capsys.readouterr().err.strip()
    assert error.splitlines()[-1].startswith("mscf: ")
    assert "000008.png is not an image" in error


def test_a_frame_of_another_size_names_itself(sequence_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(sequence_dir / "img" / "000005.png"), np.zeros((50, 50, 3), np.uint8))
    assert cli.main(["demo", str(sequence_dir)]) == 2
    assert "mover, frame 5: the frame has the shape (50, 50, 3)" in capsys.readouterr().err


def test_ctrl_c_leaves_playable_files_and_status_130(
    sequence_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = ImageSource.__iter__

    def interrupted(self: ImageSource) -> Iterator[Image]:
        for index, frame in enumerate(images(self)):
            if index == 6:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(ImageSource, "__iter__", interrupted)
    video, boxes, plot = tmp_path / "a.mp4", tmp_path / "a.txt", tmp_path / "a.png"
    arguments = ["demo", str(sequence_dir), "--save", str(video), "--boxes", str(boxes), "--plot", str(plot)]
    assert cli.main(arguments) == 130
    assert frames_in(video) == 6
    assert len(boxes.read_text().splitlines()) == 6
    assert plot.exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["demo", "no/such/file.mp4"], "no/such/file.mp4 does not exist"),
        (["demo", "no/such/*.jpg"], "no image matches"),
        (["demo", "{sequence}", "--box", "1,2,3"], "give four numbers as X,Y,W,H"),
        (["demo", "{sequence}", "--box", "a,b,c,d"], "give four numbers as X,Y,W,H"),
        (["demo", "{sequence}", "--box", "10,10,2,2"], "at least 4 px"),
        (["demo", "{sequence}", "--box", "nan,10,20,20"], "not finite"),
        (["demo", "{sequence}", "--box", "500,10,20,20"], "outside the frame"),
        (["demo", "{sequence}", "--save", "no/such/a.mp4"], "no/such/a.mp4 cannot be written"),
        (["demo", "{sequence}", "--save", "a.gif"], "a.gif is not named .mp4"),
        (["demo", "{sequence}", "--plot", "no/such/a.png"], "no/such/a.png cannot be written"),
        (["demo", "{sequence}", "--boxes", "no/such/a.txt"], "no/such/a.txt cannot be written"),
        (["demo", "{sequence}", "--plot", "a.xyz"], "a.xyz cannot be plotted to"),
        (["demo", "{sequence}", "--box", "0,0,9999,9999"], "too large"),
        (["demo", "{sequence}", "--max-frames", "0"], "give a whole number from 1"),
        (["demo", "{sequence}", "--preset", "best"], "invalid choice: 'best'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    sequence_dir: Path, arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    filled = [a.format(sequence=sequence_dir, dataset=sequence_dir.parent) for a in arguments]
    try:
        status = cli.main(filled)
    except SystemExit as exit_:  # argparse leaves by itself
        status = int(str(exit_.code))
    said = capsys.readouterr().err
    assert status == 2
    assert text in said
    assert "Traceback" not in said
    assert len(said.splitlines()) == 1
    assert said.startswith("mscf")


@pytest.mark.parametrize("option", ["--boxes", "--plot"])
def test_what_is_read_is_never_written(sequence_dir: Path, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    truth = sequence_dir / "groundtruth.txt"
    before = truth.read_text()
    assert cli.main(["demo", str(sequence_dir), option, str(truth)]) == 2
    assert "is read by this run" in capsys.readouterr().err
    assert truth.read_text() == before


def test_two_outputs_need_two_places(sequence_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["demo", str(sequence_dir), "--boxes", "a.png", "--plot", "a.png"]) == 2
    assert "a.png is given for two outputs" in capsys.readouterr().err


def test_max_frames_does_not_read_the_next_frame(sequence_dir: Path) -> None:
    (sequence_dir / "img" / "000005.png").write_bytes(b"broken")
    assert cli.main(["demo", str(sequence_dir), "--max-frames", "4"]) == 0


def test_a_bad_output_stops_before_the_first_frame(sequence_dir: Path, tmp_path: Path) -> None:
    boxes = tmp_path / "a.txt"
    assert cli.main(["demo", str(sequence_dir), "--boxes", str(boxes), "--plot", "no/such/a.png"]) == 2
    assert not boxes.exists()
