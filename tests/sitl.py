"""A fake autopilot served as ArduPilot and PX4 serve their SITL: behind a TCP port, by the wall's time."""

import math
import threading
import time

from sim.autopilot import FakeAutopilot
from sim.server import STEP_S, TcpEnd


class Sitl(threading.Thread):
    """An autopilot behind a TCP port, which runs by the wall once it is switched on."""

    def __init__(self, autopilot: FakeAutopilot, speedup: float = 1.0) -> None:
        super().__init__(name="sitl")
        self.end = TcpEnd()
        self.autopilot = autopilot
        self.modes: list[str] = []
        self.was_armed = autopilot.is_armed
        self.top_speed_mps = 0.0
        self.speedup = speedup
        self._stop_asked = threading.Event()

    def run(self) -> None:
        before_s = time.monotonic()
        while not self._stop_asked.is_set():
            self.autopilot.receive(self.end.read())
            now_s = time.monotonic()
            self.end.write(self.autopilot.step((now_s - before_s) * self.speedup))
            before_s = now_s
            self.was_armed |= self.autopilot.is_armed
            self.top_speed_mps = max(self.top_speed_mps, math.hypot(*self.autopilot.velocity_ned_mps[:2]))
            if self.autopilot.mode_name not in self.modes[-1:]:
                self.modes.append(self.autopilot.mode_name)
            time.sleep(STEP_S)

    def say(self, text: str) -> None:
        """What the flight says on its way: from the first picture on, time runs as the wall's does."""
        if text.startswith("flying"):
            self.speedup = 1.0

    def close(self) -> None:
        if self.ident is not None:
            self._stop_asked.set()
            self.join()
        self.end.close()
