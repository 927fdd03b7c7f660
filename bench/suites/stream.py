"""The player on a synthetic camera: 60 s of two 512 x 640 views, on the processor, every frame computed and written.

Each recipe of `export/` is played at 300 frames a second, as a camera would give them, and as fast as it goes. Latency
runs from when the camera gives a frame to its result; `overruns` is how often a frame came while 32 were waiting.
On cores that do other work latencies mean little.
"""

from pathlib import Path

from bench.rows import Row
from bench.streams import exported, play

RECIPES = Path(__file__).parents[2] / "export"
RATE = 300


def run(quick: bool) -> list[Row]:
    """Two rows a recipe."""
    rows: list[Row] = []
    for path in sorted(RECIPES.glob("*.toml")):
        with exported(path.read_text(encoding="utf-8")) as bundle:
            for pace in (RATE, None):
                count = 2 * RATE if quick else 60 * RATE if pace else 10 * RATE
                given = () if pace is None else ("--rate", str(pace))
                summary = play(bundle, "--frames", str(count), *given)
                rows.append(
                    {
                        "recipe": path.stem,
                        "asked_hz": pace,
                        "rate_hz": summary["rate_hz"],
                        "frames": summary["processed"],
                        "dropped": summary["dropped"],
                        "overruns": summary["overruns"],
                        # Without a pace the queue is always full, and latency is the wait in it.
                        **({f"{k}_ms": v for k, v in summary["latency_ms"].items()} if pace else {}),
                    }
                )
    return rows
