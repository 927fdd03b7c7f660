"""Benchmark of this computer: the frame rate that it holds with a bundle, and the latency at that rate."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from fingerflow.player.playing import play

_FREE_S, _HELD_S = 3.0, 10.0  # s, length of the run as fast as possible, and of each run at a fixed rate
_SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4)  # tried rates as shares of the rate of the first run
_INTERVALS = 5  # number of frame intervals within which 99 % of the results must come


def benchmark(bundle: Path, free_s: float = _FREE_S, held_s: float = _HELD_S) -> str:
    """Measure the frame rate that this computer holds with a bundle, and return it as text, below a table of the rates
    tried and their latencies.

    The synthetic source is played as fast as possible, then for ten seconds at shares of that rate, from 0.9 downwards,
    as a camera would give the frames. A rate is held if no frame had to wait for a free buffer, and 99 % of the results
    came within five frame intervals.
    """
    with tempfile.TemporaryDirectory() as folder:
        few = _played(bundle, folder, 60)
        free = _played(bundle, folder, max(60, int(free_s * few["rate_hz"])))["rate_hz"]
        lines = [f"as fast as possible: {free:.0f} frames/s", "frames/s   median ms   p99 ms   overruns"]
        for share in _SHARES:
            rate = round(share * free, 1)
            ended = _played(bundle, folder, max(60, int(held_s * rate)), rate)
            latency, overruns = ended["latency_ms"], ended["overruns"]
            lines.append(f"{rate:8.1f}   {latency['median']:9.2f}   {latency['p99']:6.2f}   {overruns:8d}")
            if not overruns and latency["p99"] <= 1e3 * _INTERVALS / rate:
                said = f"This PC holds {rate:.0f} frames/s: results come {latency['median']:.1f} ms after the frame"
                return "\n".join([*lines, f"{said} (median; 99 % within {latency['p99']:.1f} ms)."])
    return "\n".join([*lines, "This PC holds none of these rates: close other programs, or take a faster recipe."])


def _played(bundle: Path, folder: str, frames: int, rate: float | None = None) -> dict[str, Any]:
    """Play a number of frames of the synthetic source, at a rate in Hz or as fast as possible, into a new folder within
    `folder` and without live page; return the summary of the stream.
    """
    paced: dict[str, Any] = {} if rate is None else {"rate": rate}
    output = tempfile.mkdtemp(dir=folder) + "/results"
    return play(bundle, "synthetic", frames=frames, page="off", output=output, **paced)
