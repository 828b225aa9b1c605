"""What another process takes of the machine: processor time and memory, as Linux's /proc says."""

import os
from dataclasses import dataclass, field
from pathlib import Path

SETTLED_S = 60.0  # memory of a process that has run so long is compared with that at its end


@dataclass(slots=True)
class Usage:
    """Readings of one process; empty where there is no /proc."""

    readings: list[tuple[float, float, float]] = field(default_factory=list)  # time s, processor s, resident MB

    def read(self, pid: int, time_s: float) -> None:
        """Take a reading; a process that is gone gives none."""
        try:
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        except (OSError, IndexError):
            return
        busy_s = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")  # utime, stime
        self.readings.append((time_s, busy_s, pages * os.sysconf("SC_PAGE_SIZE") / 2**20))

    def figures(self) -> dict[str, float]:
        """Share of one core between the first and the last reading, and resident memory."""
        if len(self.readings) < 2:
            return {}
        first, last = self.readings[0], self.readings[-1]
        settled = next((reading for reading in self.readings if reading[0] >= SETTLED_S), None)
        share = (last[1] - first[1]) / max(last[0] - first[0], 1e-9)
        settled_mb = {f"application_memory_at_{SETTLED_S:g}_s_mb": round(settled[2], 1)} if settled is not None else {}
        return {
            "application_cpu_percent_of_a_core": round(100 * share, 1),
            **settled_mb,
            "application_memory_at_the_end_mb": round(last[2], 1),
            "application_memory_peak_mb": round(max(reading[2] for reading in self.readings), 1),
        }
