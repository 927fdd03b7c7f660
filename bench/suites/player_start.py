"""Start-up time and memory of the player on a lab PC: with numpy and onnxruntime, without torch.

The command is `python -m fingerflow.player` of an exported bundle.

Each recipe of `export/` plays the synthetic source, two 512 x 640 views. `start_s` runs from the start of the process
to the first record on the disk; pages of libraries are in the system's cache after the first of `starts` runs, whose
time is `first_start_s`. The others give the median. `peak_mib` is the most that was resident at once, libraries among
it (VmHWM), over all frames of a run.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

from bench.bare_environment import ONNX, make_environment
from bench.rows import Row, Skipped
from bench.streams import exported_recipes, play


def run(quick: bool) -> list[Row]:
    """Return a row per recipe and engine."""
    if not sys.platform.startswith("linux"):
        raise Skipped("peak memory is read from /proc")
    starts, frames = (2, 20) if quick else (5, 1000)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, exported_recipes() as bundles:
        python = make_environment(Path(folder) / "env", ONNX)
        for recipe, bundle in bundles.items():
            for engine in ("native", "onnx"):
                homes = [Path(folder) / f"{recipe}-{engine}-{n}" for n in range(starts)]
                played = [_played(python, bundle, engine, home, frames) for home in homes]
                rows.append(
                    {
                        "recipe": recipe,
                        "engine": engine,
                        "first_start_s": played[0][0],
                        "start_s": statistics.median(seconds for seconds, _ in played[1:]),
                        "peak_mib": max(mib for _, mib in played),
                        "starts": starts,
                        "frames": frames,
                    }
                )
    return rows


def _played(python: Path, bundle: Path, engine: str, results: Path, frames: int) -> tuple[float, float]:
    """Return seconds until the first record of a stream is on the disk, and the peak memory in MiB."""
    records = results / "records.bin"
    seconds, mib = 0.0, 0.0
    begin = time.perf_counter()

    def watch(pid: int) -> None:
        nonlocal seconds, mib
        if not seconds and records.exists() and records.stat().st_size:
            seconds = time.perf_counter() - begin
        mib = max(mib, _peak_mib(pid))

    play(bundle, engine, frames=frames, python=python, watch=watch, watch_s=0.005, results=results)
    if not seconds:
        raise RuntimeError("the player ended before its first record was seen")
    return seconds, mib


def _peak_mib(process: int) -> float:
    """Return the peak resident memory so far; 0 for a process that has just ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return max((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), default=0.0)
