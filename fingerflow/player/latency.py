"""Statistics of latency: the time from the arrival of a frame to the result of that frame."""

import math

import numpy as np


class Latencies:
    """Histogram of latencies from 10 µs to 20 s, in bins 1 % wide, whose memory does not grow with the stream."""

    _first, _ratio = 1e-5, 1.01

    def __init__(self) -> None:
        self._counts = np.zeros(1460, np.int64)
        self.count = 0
        self.worst = 0.0

    def add(self, seconds: float) -> None:
        """Add a latency in s to the histogram; values outside its range count in the first or last bin."""
        index = math.log(max(seconds, self._first) / self._first) / math.log(self._ratio)
        self._counts[min(int(index), len(self._counts) - 1)] += 1
        self.count += 1
        self.worst = max(self.worst, seconds)

    def quantile(self, share: float) -> float:
        """Return the latency in s that a share (0 to 1) of all latencies does not exceed, rounded up to the end of a
        histogram bin; NaN if there are none.
        """
        if not self.count:
            return math.nan
        index = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        return min(self._first * self._ratio ** (index + 1), self.worst)

    def summary(self) -> dict[str, float | None]:
        """Return the median, 99th percentile and largest latency in ms; None for each if there are none."""
        facts = {"median": self.quantile(0.5), "p99": self.quantile(0.99), "worst": self.worst}
        return {name: round(1e3 * value, 3) if self.count else None for name, value in facts.items()}
