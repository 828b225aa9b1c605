"""The autopilot's time since boot in our clock: by the smallest delay seen, and nearer by TIMESYNC.

Two bounds hold whatever the link does. Nothing arrives before it was sent: our clock is ahead of the autopilot's by at
most what the message with the least delay says. No question is heard before it was asked: it is ahead by at least
`ts1 - tc1` of an answer. Half way between is right where the ways there and back take the same time, and never further
off than half the round trip.

Deviation from MAVLink's "Time Synchronization Protocol", which takes the way back from the answer itself: ours waits in
the port until the command loop reads it, up to 50 ms. All messages together show the way back without that wait.
"""

import math
from collections import deque
from statistics import median

REBOOT_S = 1.0  # by which time_boot_ms goes back; less is reordering on the link
CLOCK_LEAK = 1e-4  # s/s: a quartz drifts less, and a link whose delay has grown is found again
MAX_ROUND_TRIP_S = 0.02  # a longer one has a queue or a radio in it, and is not likely to be the same both ways
ANSWERS = 9  # whose median counts
MIN_ANSWERS = 3
MAX_ANSWER_AGE_S = 10.0  # of the newest; by then two clocks may have drifted apart by a millisecond
_ROUNDING_S = 0.002  # time_boot_ms is in whole milliseconds


class BootClock:
    """Turns the autopilot's `time_boot_ms` into our time.

    ArduPilot's and PX4's answers to TIMESYNC are of the same clock as their `time_boot_ms`: microseconds since boot,
    times 1000 (`GCS_MAVLINK::handle_timesync`, `MavlinkTimesync::handle_message`). An answer in another clock, such as
    Unix time, contradicts the smallest delay and is not believed; then, and without answers, that delay counts as none.
    """

    def __init__(self) -> None:
        self._latest_s = math.inf  # our clock minus the autopilot's: at most
        self._earliest_s: deque[float] = deque(maxlen=ANSWERS)  # at least, by each of the last answers
        self._answered_s = -math.inf
        self._asked_ns: int | None = None  # ts1 of the question that is not answered yet
        self._boot_s = -math.inf
        self._arrival_s = 0.0

    def has_gone_back(self, boot_s: float) -> bool:
        """Whether the autopilot has begun anew."""
        return boot_s < self._boot_s - REBOOT_S

    def reset(self) -> None:
        """Forget all of it: what an autopilot said before it began anew is of another clock."""
        self.__init__()  # type: ignore[misc]  # all of it begins anew

    def ours_s(self, boot_s: float, arrival_s: float) -> float:
        """Our time at which a message was made; never after `arrival_s`, at which it came."""
        leaked_s = self._latest_s + CLOCK_LEAK * max(arrival_s - self._arrival_s, 0.0)
        self._latest_s = min(leaked_s, arrival_s - boot_s)
        self._boot_s, self._arrival_s = max(boot_s, self._boot_s), arrival_s
        return boot_s + self._latest_s - self._round_trip_s(arrival_s) / 2

    def ask(self, now_s: float) -> int:
        """TIMESYNC's `ts1` in ns for a question that leaves now; the one before is forgotten."""
        self._asked_ns = round(now_s * 1e9)
        return self._asked_ns

    def hear(self, tc1_ns: int, ts1_ns: int, now_s: float) -> None:
        """Take the autopilot's answer; one to another question, a slow one or one in another clock means nothing."""
        if ts1_ns != self._asked_ns:
            return
        self._asked_ns = None
        earliest_s = (ts1_ns - tc1_ns) / 1e9
        if -_ROUNDING_S <= self._latest_s - earliest_s <= MAX_ROUND_TRIP_S:
            self._earliest_s.append(earliest_s)
            self._answered_s = now_s

    def _round_trip_s(self, now_s: float) -> float:
        """The way there and back; 0 where it is not known."""
        if now_s - self._answered_s > MAX_ANSWER_AGE_S:
            self._earliest_s.clear()
        if len(self._earliest_s) < MIN_ANSWERS:
            return 0.0
        return max(self._latest_s - median(self._earliest_s), 0.0)
