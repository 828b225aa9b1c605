from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from mover import FIRST, FRAMES, moving_target

from mscf.errors import SourceError
from mscf.geometry import Box
from mscf.recording import VideoFile
from mscf.source import ImageSource, VideoSource, open_source


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


def test_each_image_of_a_glob_has_its_own_line_of_the_truth(sequence_dir: Path) -> None:
    source = open_source(str(sequence_dir / "img" / "00000[5-9].png"))
    assert source.truth[0] == Box(FIRST.x + 12, FIRST.y + 8, FIRST.w, FIRST.h)
    assert len(source.truth) == 5
    assert open_source(str(sequence_dir / "img" / "000005.png")).truth == source.truth[:1]


def test_images_are_taken_by_number(tmp_path: Path) -> None:
    for number in (1, 2, 10, 9):
        cv2.imwrite(str(tmp_path / f"frame{number}.png"), np.full((9, 9, 3), number, np.uint8))
    assert [int(frame[0, 0, 0]) for frame in open_source(str(tmp_path))] == [1, 2, 9, 10]
    assert [int(frame[0, 0, 0]) for frame in open_source(str(tmp_path / "*.png"))] == [1, 2, 9, 10]


def test_a_name_that_is_too_long_is_refused() -> None:
    with pytest.raises(SourceError, match="cannot be read: File name too long"):
        open_source("x" * 300)


def test_the_length_of_a_matroska_file_is_not_believed(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height = 128, 96
        for frame in moving_target():
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="bgr24")))
        container.mux(stream.encode(None))
    source = open_source(str(tmp_path / "a.mkv"))
    assert source.frame_count is None
    assert len(list(source)) == FRAMES


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


@pytest.mark.parametrize(("text", "device"), [("987", "/dev/video987"), ("/dev/video988", "/dev/video988")])
def test_a_number_or_device_is_a_camera_and_named_where_it_is_not_there(text: str, device: str) -> None:
    with pytest.raises(SourceError, match=f"camera {device} cannot be opened"):
        open_source(text)


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
