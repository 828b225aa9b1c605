"""The one synchronised object: where threads meet."""

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Latest(Generic[T]):
    """A place for one value, the newest: whoever puts never waits, whoever is slow misses what came between.

    What is put in must not be changed after.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._value: T | None = None
        self._is_taken = True
        self._dropped = 0

    def put(self, value: T) -> None:
        """Replace what is there."""
        with self._changed:
            self._dropped += not self._is_taken
            self._value, self._is_taken = value, False
            self._changed.notify()

    def take(self, timeout_s: float) -> T | None:
        """The newest value that was not taken yet; None if none comes in time. For one reader."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._is_taken, timeout_s):
                return None
            self._is_taken = True
            return self._value

    @property
    def value(self) -> T | None:
        """The newest value, taken or not; None before the first."""
        with self._changed:
            return self._value

    @property
    def dropped(self) -> int:
        """How many values were replaced before they were taken."""
        with self._changed:
            return self._dropped
