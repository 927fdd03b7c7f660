"""Measurement of the processor time of each of several trials that run in one process."""

import time
from threading import Lock


class Share:
    """Context that measures processor time: that of the process, divided evenly among contexts entered at once."""

    _lock = Lock()
    _running = 0
    _each = 0.0  # s, share of a context that was entered all the time
    _looked = 0.0

    def __enter__(self) -> "Share":
        self._begun = self._look(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._look(-1)

    def seconds(self) -> float:
        """Return the processor time of this context so far, s."""
        return self._look(0) - self._begun

    @classmethod
    def _look(cls, more: int) -> float:
        with cls._lock:
            now = time.process_time()
            if cls._running:
                cls._each += (now - cls._looked) / cls._running
            cls._looked = now
            cls._running += more
            return cls._each
