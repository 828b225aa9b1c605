"""The installed command `mscf` as a process of its own."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import av
import pytest

MSCF = [str(Path(sys.executable).with_name("mscf"))]
PEAK_MEMORY_KB = 300 * 1024
# ru_maxrss of a child starts with what its parent had; VmHWM is the program's own peak
REPORT_PEAK = """
import sys
from pathlib import Path
from mscf.cli import main
status = main(sys.argv[1:])
text = Path("/proc/self/status").read_text()
print("VmHWM", text.split("VmHWM:")[1].split()[0])
sys.exit(status)
"""


def frames_in(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def lines_in(path: Path) -> int:
    """Lines of a file that another process may be making, or trying out and removing."""
    try:
        return path.read_text().count("\n")
    except FileNotFoundError:
        return 0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
def test_the_demo_stays_under_300_mb(tmp_path: Path) -> None:
    command = [sys.executable, "-c", REPORT_PEAK, "demo", "--max-frames", "90", "--compare", "bacf", "--no-progress"]
    outputs = ["--save", "a.mp4", "--plot", "a.png", "--boxes", "a.txt"]
    done = subprocess.run([*command, *outputs], cwd=tmp_path, capture_output=True, text=True, check=True)
    peak = re.search(r"VmHWM (\d+)", done.stdout)
    assert peak is not None
    assert int(peak[1]) < PEAK_MEMORY_KB
    assert frames_in(tmp_path / "a.mp4") == 90


def test_ctrl_c_ends_with_130_and_leaves_all_files_whole(tmp_path: Path) -> None:
    command = [*MSCF, "demo", "--save", "a.mp4", "--boxes", "a.txt", "--plot", "a.png", "--no-progress"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        boxes = tmp_path / "a.txt"
        while process.poll() is None and lines_in(boxes) < 10:
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        said, complaints = process.communicate()
    assert process.returncode == 130, complaints
    assert "Traceback" not in complaints
    tracked = lines_in(boxes)
    assert tracked >= 10
    assert abs(frames_in(tmp_path / "a.mp4") - tracked) <= 1
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert f"mscf: {tracked} frames" in said


@pytest.mark.parametrize("content", [b"", b"no video at all"])
def test_a_file_that_is_no_video_is_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    done = subprocess.run([*MSCF, "demo", "a.mp4"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "mscf: a.mp4 is not a video that can be decoded: play it elsewhere, or convert it to MP4"
    ]


def test_progress_is_plain_lines_where_there_is_no_terminal(sequence_dir: Path) -> None:
    done = subprocess.run([*MSCF, "demo", str(sequence_dir)], capture_output=True, text=True, check=True)
    assert "\r" not in done.stderr
    assert done.stdout.startswith("mscf: 12 frames")


def test_a_reader_that_leaves_is_no_error_of_ours(sequence_dir: Path) -> None:
    command = f"{MSCF[0]} demo {sequence_dir} | true"
    done = subprocess.run(["/bin/bash", "-c", command], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
