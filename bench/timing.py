"""Compare the run times of several functions, called in turns so that other load on the machine slows all alike."""

import os
import statistics
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple


class Timing(NamedTuple):
    """Median, 10th and 90th percentile of repeated runs in ms, and the median ratio to the peer's time."""

    median_ms: float
    low_ms: float
    high_ms: float
    to_peer: float

    def of_each(self, count: int) -> "Timing":
        """Return the times per frame of runs over ``count`` frames."""
        return Timing(self.median_ms / count, self.low_ms / count, self.high_ms / count, self.to_peer)

    def cells(self) -> dict[str, float]:
        """Return the time columns of a row."""
        return {"ms": self.median_ms, "ms_p10": self.low_ms, "ms_p90": self.high_ms, "time_to_peer": self.to_peer}


_CLOCK = time.process_time if os.environ.get("OMP_NUM_THREADS") == "1" else time.perf_counter


def time_in_turns(
    candidates: Mapping[str, Callable[[], object]], peer: str, rounds: int, clock: Callable[[], float] = _CLOCK
) -> dict[str, Timing]:
    """Time candidates in turns: ``rounds`` rounds of all of them, after two rounds of warm-up.

    Other work on the machine slows a whole round rather than one candidate, so the ratio is taken within each round.

    Args:
        candidates: calls by name.
        peer: the candidate that the ratios refer to.
        rounds: at least 2.
        clock: in s, by default processor time for one thread (OMP_NUM_THREADS=1), elapsed time for more.
    """
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for number in range(-2, rounds):
        for name, call in candidates.items():
            start = clock()
            call()
            if number >= 0:
                seconds[name].append(clock() - start)
    return {name: _timing(runs, seconds[peer]) for name, runs in seconds.items()}


def _timing(runs: list[float], peer_runs: list[float]) -> Timing:
    deciles = statistics.quantiles(runs, n=10, method="inclusive")
    ratios = [run / other for run, other in zip(runs, peer_runs, strict=True)]
    return Timing(1e3 * statistics.median(runs), 1e3 * deciles[0], 1e3 * deciles[-1], statistics.median(ratios))
