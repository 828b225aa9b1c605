from pathlib import Path

import cv2
import numpy as np
import pytest
from mover import FIRST, FRAMES, moving_target

from mscf.errors import SourceError
from mscf.recording import VideoFile
from mscf.source import CameraSource, ImageSource, VideoSource, open_source


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "mover.mp4"
    with VideoFile(path, 25) as file:
        for frame in moving_target():
            file.write(frame)
    return path


@pytest.mark.parametrize("below", ["", "img"])
def test_a_folder_of_images_is_read_in_order_with_its_truth(sequence_dir: Path, below: str) -> None:
    source = open_source(str(sequence_dir / below))
    assert source.name == "mover"
    assert source.frame_count == FRAMES
    assert source.truth[0] == FIRST
    for frame, expected in zip(source, moving_target(), strict=True):
        np.testing.assert_array_equal(frame, expected)


def test_a_glob_takes_the_images_it_matches(sequence_dir: Path) -> None:
    source = open_source(str(sequence_dir / "img" / "00000[1-4].png"))
    assert source.frame_count == 4
    assert source.truth[0] == FIRST


def test_one_image_is_a_source_of_one_frame(sequence_dir: Path) -> None:
    assert len(list(open_source(str(sequence_dir / "img" / "000003.png")))) == 1


def test_a_video_file_knows_its_rate_and_length(video: Path) -> None:
    source = open_source(str(video))
    assert isinstance(source, VideoSource)
    assert source.frames_per_s == pytest.approx(25)
    assert source.frame_count == FRAMES
    frames = list(source)
    assert len(frames) == FRAMES
    assert frames[0].shape == (96, 128, 3)


def test_a_video_that_was_cut_short_says_where(video: Path) -> None:
    source = VideoSource(video, 25.0, FRAMES + 30)
    frames = iter(source)
    for _ in range(FRAMES):
        next(frames)
    with pytest.raises(SourceError, match=f"frame {FRAMES + 1} of {FRAMES + 30} cannot be decoded"):
        next(frames)


@pytest.mark.parametrize(
    ("text", "device"), [("0", "/dev/video0"), ("12", "/dev/video12"), ("/dev/video3", "/dev/video3")]
)
def test_a_number_or_device_is_a_camera(text: str, device: str) -> None:
    source = open_source(text)
    assert isinstance(source, CameraSource)
    assert source.name == device
    assert source.frame_count is None


def test_a_camera_that_is_not_there_is_named() -> None:
    with pytest.raises(SourceError, match="camera /dev/video987 cannot be opened"):
        next(iter(open_source("/dev/video987")))


def test_without_a_source_the_built_in_flight_is_shown() -> None:
    source = open_source(None)
    assert source.name == "synthetic flight"
    assert source.frame_count == len(source.truth)
    assert next(iter(source)).shape == (720, 1280, 3)


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"missing\.mp4 does not exist"):
        open_source(str(tmp_path / "missing.mp4"))


def test_a_folder_without_images_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="holds no images"):
        open_source(str(tmp_path))


def test_a_pattern_without_a_match_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no image matches .*\*\.png"):
        open_source(str(tmp_path / "*.png"))


@pytest.mark.parametrize("content", [b"", b"this is no video"])
def test_a_file_that_is_no_video_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "notes.mp4"
    path.write_bytes(content)
    with pytest.raises(SourceError, match=r"notes\.mp4 is not a video that can be decoded"):
        open_source(str(path))


@pytest.mark.parametrize("content", [b"", b"no image"])
def test_a_broken_image_names_itself(sequence_dir: Path, content: bytes) -> None:
    (sequence_dir / "img" / "000004.png").write_bytes(content)
    frames = iter(open_source(str(sequence_dir)))
    for _ in range(3):
        next(frames)
    with pytest.raises(SourceError, match=r"000004\.png is not an image"):
        next(frames)


def test_gray_images_come_as_colour(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((20, 30), 9, np.uint8))
    assert next(iter(ImageSource("x", (tmp_path / "a.png",)))).shape == (20, 30, 3)
