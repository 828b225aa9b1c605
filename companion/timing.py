"""How punctual the command loop is, and how old its frames are: what `ctl timing` reports."""

from collections import deque

import numpy as np

from companion.types import TrackSample

WINDOW = 12000  # samples: ten minutes at 20 Hz


class Timing:
    """The last ten minutes of three figures."""

    def __init__(self) -> None:
        self.overruns = 0  # periods that were missed
        self._late_s: deque[float] = deque(maxlen=WINDOW)
        self._vision_s: deque[float] = deque(maxlen=WINDOW)
        self._latency_s: deque[float] = deque(maxlen=WINDOW)
        self._seq: int | None = None

    def add_step(self, late_s: float) -> None:
        """A step began so much after it was due."""
        self._late_s.append(late_s)

    def see(self, sample: TrackSample | None) -> None:
        """What vision has said last: its way from capture to the box, once."""
        if sample is not None and sample.seq != self._seq:
            self._seq = sample.seq
            self._vision_s.append(sample.finished_s - sample.captured_s)

    def add_setpoint(self, latency_s: float) -> None:
        """A setpoint was written so long after the capture of the frame that it rests on."""
        self._latency_s.append(latency_s)

    def summary(self) -> dict[str, float]:
        """Median, 99th percentile and count of each, in ms."""
        out: dict[str, float] = {"overruns": self.overruns}
        figures = {
            "step_late": self._late_s,
            "capture_to_box": self._vision_s,
            "capture_to_setpoint": self._latency_s,
        }
        for name, values in figures.items():
            out[f"{name}_count"] = len(values)
            if values:
                median, p99 = np.percentile(values, [50, 99])
                out[f"{name}_median_ms"] = round(float(median) * 1000, 2)
                out[f"{name}_p99_ms"] = round(float(p99) * 1000, 2)
        return out
