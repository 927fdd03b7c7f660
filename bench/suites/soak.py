"""A day in miniature: 100,000 small frames through the player, and the memory that its process holds.

Views of 96 x 128 px, 50 points, as fast as it goes; each frame is computed, tracked and written. `rss_mib` is the
resident memory when so many frames had been written, `growth_mib` since the first row.
"""

import sys
import time
from pathlib import Path

from bench.rows import Row, Skipped
from bench.streams import exported, play

RECIPE = """
[views]
height = 96
width = 128
[contact]
real_contact_mask = false
[tracking]
points = 50
window_px = 15
"""


def run(quick: bool) -> list[Row]:
    """Ten rows over the run, the first after a tenth of it."""
    if not sys.platform.startswith("linux"):
        raise Skipped("resident memory is read from /proc")
    count = 2_000 if quick else 100_000
    seen: list[tuple[float, float]] = []

    def watch(pid: int) -> None:
        try:
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        except OSError:  # it has just ended
            return
        resident = [int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")]
        seen.extend((time.perf_counter(), mib) for mib in resident)

    with exported(RECIPE) as bundle:
        summary = play(bundle, "--frames", str(count), watch=watch)
    end = seen[-1][0]
    begin = end - summary["seconds"]
    rows: list[Row] = []
    for tenth in range(1, 11):
        at = begin + (end - begin) * tenth / 10
        mib = min(seen, key=lambda entry: abs(entry[0] - at))[1]
        first = rows[0]["rss_mib"] if rows else mib
        assert isinstance(first, float)
        rows.append({"frames": summary["processed"] * tenth // 10, "rss_mib": mib, "growth_mib": mib - first})
    return rows
