"""Files that a run writes frame by frame; each is complete and usable after whatever ends the run."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

from mscf.arrays import Image
from mscf.errors import OutputError
from mscf.geometry import Box

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

_MILLISECOND = Fraction(1, 1000)


def check_writable(path: Path) -> None:
    """Fail now rather than after a long run.

    Raises
    ------
    OutputError
        If no file can be written there. What is there is not touched.
    """
    existed = path.exists()
    with _naming(path), path.open("ab"):
        pass
    if not existed:
        path.unlink()


class BoxFile:
    """Text file with a box a line: x,y,w,h, 1-based, as ground-truth files of tracking data sets have it.

    It appears with the first box, so that a run that fails before leaves what was there.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to write.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        check_writable(path)
        self._path = path
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            with _naming(self._path):
                self._file.close()

    def write(self, box: Box) -> None:
        """Append one frame's box; it is on disk when this returns.

        Raises
        ------
        OutputError
            If the file cannot be written any more.
        """
        with _naming(self._path):
            if self._file is None:
                self._file = self._path.open("w", buffering=1)  # a line at a time
            self._file.write(",".join(f"{value:.2f}" for value in box.to_one_based()) + "\n")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what the system says into one line with the path."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; give another place") from error


class _H264File:
    """MP4 with H.264 in 4:2:0, which every browser plays; what differs between the two kinds is handed in."""

    def __init__(self, path: Path, frames_per_s: float, muxer: dict[str, str], encoder: dict[str, object]) -> None:
        """Prepare to write; the file appears with the first frame.

        Raises
        ------
        OutputError
            If the file cannot be written, is not named .mp4, or PyAV is not installed.
        """
        if path.suffix.lower() != ".mp4":
            raise OutputError(f"{path} is not named .mp4: only MP4 is written")
        try:
            import av  # noqa: PLC0415 - an extra; without --save nobody needs it
        except ImportError as error:
            raise OutputError("a video needs PyAV: pip install av, or '.[recording]' in the clone") from error
        check_writable(path)
        self._av = av
        self._path = path
        self._rate = Fraction(frames_per_s).limit_denominator(1001)
        self._muxer, self._encoder = muxer, encoder
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _append(self, frame: Image, time_ms: int | None) -> None:
        """Encode a frame at a time since the first; None: one period after the last."""
        rows, cols = frame.shape[0] // 2 * 2, frame.shape[1] // 2 * 2
        try:
            if self._container is None or self._stream is None:
                self._container = self._av.open(str(self._path), "w", options=self._muxer)
                self._stream = self._container.add_stream("libx264", rate=self._rate)
                self._stream.width, self._stream.height, self._stream.pix_fmt = cols, rows, "yuv420p"
                self._stream.options = self._encoder
                if time_ms is not None:
                    self._stream.codec_context.time_base = _MILLISECOND
            picture = self._av.VideoFrame.from_ndarray(frame[:rows, :cols], format="bgr24")
            if time_ms is not None:
                picture.pts, picture.time_base = time_ms, _MILLISECOND
            self._container.mux(self._stream.encode(picture))
        except (OSError, self._av.FFmpegError) as error:
            self._stream = None  # flushing into what has failed once may crash FFmpeg
            self.close()
            raise self._error(error) from error

    def close(self) -> None:
        """Finish the file; safe to call twice.

        Raises
        ------
        OutputError
            If the file cannot be finished, unless an error of writing has been raised before.
        """
        container, stream = self._container, self._stream
        self._container = self._stream = None
        if container is None:
            return
        try:
            try:
                if stream is not None:
                    container.mux(stream.encode(None))
            finally:
                container.close()
        except (OSError, self._av.FFmpegError) as error:
            if stream is not None:
                raise self._error(error) from error

    def _error(self, error: Exception) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error}; give another place")


class VideoFile(_H264File):
    """A video of frames one period apart, which begins to play before it is loaded; playable once it is closed."""

    def __init__(self, path: Path, frames_per_s: float) -> None:
        super().__init__(path, frames_per_s, {"movflags": "+faststart"}, {"preset": "veryfast", "crf": "21"})

    def write(self, frame: Image) -> None:
        """Append a frame, (H, W, 3) BGR uint8; all of one size. A last odd row or column is left out.

        Raises
        ------
        OutputError
            If the file cannot be written any more.
        """
        self._append(frame, None)


class LiveVideoFile(_H264File):
    """A video of frames as they come, cheap to encode, on the caller's thread alone.

    It is in fragments of a second, each on disk when the next one begins: what ends the process, SIGKILL too, takes
    the last fragment only.

    Parameters
    ----------
    frames_per_s : about as many; each frame brings its own time.
    """

    def __init__(self, path: Path, frames_per_s: float) -> None:
        muxer = {"movflags": "+frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
        encoder: dict[str, object] = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "crf": "26",
            "threads": "1",
            "g": str(max(round(frames_per_s), 1)),
        }
        super().__init__(path, frames_per_s, muxer, encoder)
        self._first_s: float | None = None
        self._last_ms = -1

    def write(self, frame: Image, time_s: float) -> None:
        """Append a frame, (H, W, 3) BGR uint8, at a time from any zero; the first one decides on the size.

        One that is not later than the last is left out, and one of another size is scaled.

        Raises
        ------
        OutputError
            If the file cannot be written any more.
        """
        if self._first_s is None:
            self._first_s = time_s
        time_ms = round(1000 * (time_s - self._first_s))
        if time_ms <= self._last_ms:
            return
        self._last_ms = time_ms
        self._append(frame, time_ms)
