"""Frame rate and latency of the player on the CPU, with a synthetic camera that has two views of 512 x 640 px.

Every frame is computed and its results are written.

Each recipe of `export/` is played from its bundle, without torch, by the compiled library (`native`) and by ONNX
Runtime (`onnx`), as fast as it goes, and then for 60 s at 300 frames a second, as a camera would give them, or at two
thirds of its rate where that is less. As fast as it goes is the median of five runs, with the slowest and the fastest.
cpu_ms is the processor time of the player a frame, its start not counted, opencv_cpu_ms that of OpenCV's pipeline on a
recording (`bench pipeline`), the mean of a run before and one after, and cpu_to_opencv their ratio, which means the
same on other machines. At a camera's rate one thread tracks and measures as long as it keeps up.
Latency runs from when the camera gives a frame to its result; `overruns` is how often a frame came while 32 were
waiting. `load` is how many processes the machine had to run on average when the row ended: on cores that do other work
latencies mean little.
"""

import os
import tempfile
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from bench.recordings import QUICK_PRESS, write_quietly
from bench.rows import Row
from bench.streams import exported_recipes, play
from bench.suites.pipeline import PRESS, opencv_cpu_ms

CAMERA = 300  # frames a second
FRAMES = {"native": 4000, "onnx": 600}  # as fast as it goes: some seconds


def run(quick: bool) -> list[Row]:
    """Return two rows per recipe and engine."""
    rows, press = list[Row](), QUICK_PRESS if quick else PRESS
    with tempfile.TemporaryDirectory() as folder, exported_recipes() as bundles:
        recording = Path(folder) / "press"
        write_quietly(recording, press)
        opencv_cpu_ms(recording, press)  # a warm-up
        for recipe, bundle in bundles.items():
            for engine in ("native", "onnx"):
                played = partial(_played, bundle, engine, quick, partial(opencv_cpu_ms, recording, press))
                runs = sorted((played() for _ in range(1 if quick else 5)), key=itemgetter("rate_hz"))
                free = runs[len(runs) // 2] | {"slowest_hz": runs[0]["rate_hz"], "fastest_hz": runs[-1]["rate_hz"]}
                # A quarter of the frames takes a quarter of the time, but its start as long.
                start_s = (4 * play(bundle, engine, frames=free["frames"] // 4)["cpu_s"] - free["cpu_s"]) / 3
                for row in free, played(pace=min(CAMERA, round(free["rate_hz"] * 2 / 3))):
                    cpu_ms = 1e3 * (row.pop("cpu_s") - start_s) / row["frames"]
                    ratio = {"cpu_ms": cpu_ms, "cpu_to_opencv": cpu_ms / row["opencv_cpu_ms"]}
                    rows.append({"recipe": recipe, "engine": engine} | row | ratio)
    return rows


def _played(bundle: Path, engine: str, quick: bool, peer: Callable[[], float], pace: int = 0) -> dict[str, Any]:
    count = (2 if quick else 60) * pace if pace else FRAMES[engine] // (5 if quick else 1)
    before = peer()
    summary = play(bundle, engine, frames=count, rate=pace or None)
    return {
        "asked_hz": pace or None,
        **{name: summary[name] for name in ("rate_hz", "cpu_s", "dropped", "overruns")},
        "frames": summary["processed"],
        "load": os.getloadavg()[0],
        "opencv_cpu_ms": (before + peer()) / 2,
        # Without a pace the queue is always full, and latency is the wait in it.
        **({f"{k}_ms": v for k, v in summary["latency_ms"].items()} if pace else {}),
    }
