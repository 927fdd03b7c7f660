"""The player on a synthetic camera: two 512 x 640 views, on the processor, every frame computed and written.

Each recipe of `export/` is played as fast as it goes, one frame after the other and two side by side (the option
`--parallel-frames 2`), and then two side by side for 60 s at the rate it is for, as a camera would give the frames.
Latency runs from when the camera gives a frame to its result; `overruns` is how often a frame came while 32 were
waiting. `stalled` is what the machine takes from programs that only read the clock, in gaps of more than 1 ms, mean of
3 s before and after: on cores that do other work latencies mean little.
"""

from pathlib import Path

from bench.rows import Row
from bench.stalls import stalled_ms_per_s
from bench.streams import exported, play

RECIPES = Path(__file__).parents[2] / "export"
RATES = {"fast": 300, "exact": 100}


def run(quick: bool) -> list[Row]:
    """Three rows a recipe."""
    rows: list[Row] = []
    for path in sorted(RECIPES.glob("*.toml")):
        with exported(path.read_text(encoding="utf-8")) as bundle:
            rate, before = RATES[path.stem], stalled_ms_per_s()
            for pace, parallel in ((None, 1), (None, 2), (rate, 2)):
                count = 2 * rate if quick else 60 * rate if pace else 10 * rate
                given = () if pace is None else ("--rate", str(pace))
                summary = play(bundle, "--frames", str(count), "--parallel-frames", str(parallel), *given)
                after = stalled_ms_per_s()
                rows.append(
                    {
                        "recipe": path.stem,
                        "side_by_side": parallel,
                        "asked_hz": pace,
                        "rate_hz": summary["rate_hz"],
                        "frames": summary["processed"],
                        "dropped": summary["dropped"],
                        "overruns": summary["overruns"],
                        "stalled_ms_per_s": (before + after) / 2,
                        # Without a pace the queue is always full, and latency is the wait in it.
                        **({f"{k}_ms": v for k, v in summary["latency_ms"].items()} if pace else {}),
                    }
                )
                before = after
    return rows
