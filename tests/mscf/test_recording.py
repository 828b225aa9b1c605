import signal
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from mover import moving_target

from mscf.errors import OutputError
from mscf.geometry import Box
from mscf.recording import BoxFile, LiveVideoFile, VideoFile, check_writable


def decoded(path: Path) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]


def test_a_video_is_h264_that_a_browser_plays_and_shows_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with VideoFile(path, 30) as file:
        for frame in moving_target():
            file.write(frame)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert float(stream.average_rate) == 30
    # the index stands before the pictures, so that playing starts before all is loaded
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")
    for shown, written in zip(decoded(path), moving_target(), strict=True):
        assert np.abs(shown.astype(int) - written).mean() < 12


def test_odd_sizes_lose_a_row_and_a_column(tmp_path: Path) -> None:
    with VideoFile(tmp_path / "odd.mp4", 30) as file:
        file.write(np.zeros((61, 91, 3), np.uint8))
    with LiveVideoFile(tmp_path / "live.mp4", 30) as live:
        live.write(np.zeros((61, 91, 3), np.uint8), 0.0)
    for name in ("odd.mp4", "live.mp4"):
        assert decoded(tmp_path / name)[0].shape == (60, 90, 3)


def times_s(path: Path) -> list[float]:
    with av.open(str(path)) as container:
        return [float(frame.time) for frame in container.decode(video=0)]


def test_frames_of_a_live_video_keep_their_times_and_what_they_show(tmp_path: Path) -> None:
    path, frames = tmp_path / "a.mp4", moving_target()
    times = [100 + s for s in (0.0, 0.1, 0.2, 0.3, 1.75, 1.8, 2.5, 30.0, 30.001, 31.0, 32.0, 40.0)]
    with LiveVideoFile(path, 10) as file:
        for frame, time_s in zip(frames, times, strict=True):
            file.write(frame, time_s)
    assert times_s(path) == pytest.approx([time_s - 100 for time_s in times], abs=1e-3)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
    for shown, written in zip(decoded(path), frames, strict=True):
        assert np.abs(shown.astype(int) - written).mean() < 16


def test_a_frame_that_is_not_later_than_the_last_is_left_out(tmp_path: Path) -> None:
    with LiveVideoFile(tmp_path / "a.mp4", 10) as file:
        for time_s in (5.0, 5.1, 5.1, 4.0, 5.2):
            file.write(moving_target()[0], time_s)
    assert times_s(tmp_path / "a.mp4") == pytest.approx([0.0, 0.1, 0.2])


def test_a_frame_of_another_size_is_scaled(tmp_path: Path) -> None:
    with LiveVideoFile(tmp_path / "a.mp4", 10) as file:
        for k, size_hw in enumerate(((96, 128), (48, 64), (200, 100))):
            file.write(np.full((*size_hw, 3), 90, np.uint8), k / 10)
    pictures = decoded(tmp_path / "a.mp4")
    assert [picture.shape for picture in pictures] == [(96, 128, 3)] * 3
    assert all(abs(picture.mean() - 90) < 4 for picture in pictures)


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from mscf.recording import LiveVideoFile
file = LiveVideoFile(Path(sys.argv[1]), 10)
for k in range(37):
    file.write(np.full((48, 64, 3), 5 * k, np.uint8), k / 10)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_kills_the_process_takes_the_last_second_of_a_live_video_only(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    pictures = decoded(path)
    assert 37 - 10 <= len(pictures) < 37
    for k, picture in enumerate(pictures):
        assert abs(picture.mean() - 5 * k) < 6


def test_an_exception_leaves_a_playable_file(tmp_path: Path) -> None:
    def record() -> None:
        with VideoFile(tmp_path / "a.mp4", 30) as file:
            for frame in moving_target()[:5]:
                file.write(frame)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert len(decoded(tmp_path / "a.mp4")) == 5


def test_only_mp4_is_written(tmp_path: Path) -> None:
    for kind in (VideoFile, LiveVideoFile):
        with pytest.raises(OutputError, match=r"a\.avi is not named \.mp4"):
            kind(tmp_path / "a.avi", 30)


def test_a_place_that_cannot_be_written_is_named_before_anything_is_done(tmp_path: Path) -> None:
    for make in (lambda p: VideoFile(p / "a.mp4", 30), lambda p: BoxFile(p / "a.txt"), check_writable):
        with pytest.raises(OutputError, match="cannot be written: No such file or directory"):
            make(tmp_path / "nowhere" / "below")
    with pytest.raises(OutputError, match="cannot be written: Is a directory"):
        BoxFile(tmp_path)


def test_checking_a_place_leaves_it_as_it_was(tmp_path: Path) -> None:
    check_writable(tmp_path / "new.txt")
    assert not (tmp_path / "new.txt").exists()
    (tmp_path / "old.txt").write_text("kept")
    check_writable(tmp_path / "old.txt")
    assert (tmp_path / "old.txt").read_text() == "kept"


def test_each_box_is_on_disk_at_once(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    with BoxFile(path) as file:
        file.write(Box(0, 0, 10, 20))
        assert path.read_text() == "1.00,1.00,10.00,20.00\n"
        file.write(Box(4.125, 5.5, 10, 20))
    assert path.read_text().splitlines()[1] == "5.12,6.50,10.00,20.00"


def test_a_box_file_leaves_what_was_there_until_the_first_box(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text("kept\n")
    with BoxFile(path):
        pass
    assert path.read_text() == "kept\n"
    with BoxFile(path) as file:
        file.write(Box(0, 0, 4, 4))
    assert path.read_text() == "1.00,1.00,4.00,4.00\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system to write to")
def test_a_full_disk_is_one_error_that_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "full.mp4").symlink_to("/dev/full")
    (tmp_path / "full.txt").symlink_to("/dev/full")

    def film() -> None:
        with VideoFile(tmp_path / "full.mp4", 30) as file:
            for frame in moving_target() * 20:
                file.write(frame)

    def film_live() -> None:
        with LiveVideoFile(tmp_path / "full.mp4", 30) as file:
            for k, frame in enumerate(moving_target() * 20):
                file.write(frame, k / 30)

    def list_boxes() -> None:
        with BoxFile(tmp_path / "full.txt") as file:
            file.write(Box(0, 0, 4, 4))

    for run in (film, film_live, list_boxes):
        with pytest.raises(OutputError, match=r"full\.(mp4|txt) cannot be written: .*No space left"):
            run()
