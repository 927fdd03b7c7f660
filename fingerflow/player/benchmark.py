"""Benchmark of this computer: the frame rate that it holds with a bundle, and the latency at that rate."""

import tempfile
from collections.abc import Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from fingerflow.kernels.kernel import cores
from fingerflow.player.playing import play

_FREE_S = 3.0  # s, length of the run as fast as possible
_HELD_S = 10.0  # s, length of each run at a fixed rate
_SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4)  # tried rates as shares of the rate of the first run
_FULL = 0.9  # share of a core from which a thread, or all of them on all cores, count as busy
_INTERVALS = 5  # number of frame intervals within which 99 % of the results must come


def benchmark(bundle: Path, options: Mapping[str, Any], free_s: float = _FREE_S, held_s: float = _HELD_S) -> str:
    """Measure the frame rate that this computer holds with a bundle, and return it as text, below a table of the rates
    tried and their latencies.

    The synthetic source is played as fast as possible, then for ten seconds at shares of that rate, from 0.9 downwards,
    as a camera would give the frames. A rate is held if no frame had to wait for a free buffer, and 99 % of the results
    came within five frame intervals. `options` are those of `play` that choose engine, provider and threads.
    """
    with tempfile.TemporaryDirectory() as folder:

        def played(frames: int, **rate: Any) -> dict[str, Any]:
            output = tempfile.mkdtemp(dir=folder) + "/results"
            return play(bundle, "synthetic", frames=max(60, frames), page="off", output=output, **options, **rate)

        few = played(0)
        fastest = played(int(free_s * few["rate_hz"]))
        free = fastest["rate_hz"]
        lines = [
            f"as fast as possible: {free:.0f} frames/s, computed by {few['engine']}; {_limit(fastest['busy'])}",
            "frames/s   median ms   p99 ms   overruns",
        ]
        for share in _SHARES:
            rate = round(share * free, 1)
            ended = played(int(held_s * rate), rate=rate)
            latency, overruns = ended["latency_ms"], ended["overruns"]
            lines.append(f"{rate:8.1f}   {latency['median']:9.2f}   {latency['p99']:6.2f}   {overruns:8d}")
            if not overruns and latency["p99"] <= 1e3 * _INTERVALS / rate:
                summary = f"This PC holds {rate:.0f} frames/s: results come {latency['median']:.1f} ms after the frame"
                return "\n".join([*lines, f"{summary} (median; 99 % within {latency['p99']:.1f} ms)."])
    return "\n".join([*lines, "This PC holds none of these rates: close other programs, or take a faster recipe."])


def _limit(busy: Mapping[str, float]) -> str:
    """Return in words what limits a stream, from the shares of a processor core that its threads use."""
    shares = ", ".join(f"{name} {share:.0%}" for name, share in busy.items())
    name, most = max(busy.items(), key=itemgetter(1))
    if sum(busy.values()) > _FULL * cores():
        limit = "the processor, whose cores are all busy"
    elif most > _FULL:
        limit = f"the thread {name}, which is always busy"
    elif sum(busy.values()) > _FULL:
        limit = "threads that wait for each other, as only one of them runs Python at a time"
    else:
        limit = "other programs, which take the processor"
    return f"limit: {limit} (processor time of the threads: {shares} of a core)"
