"""Memory of the player's process over 100,000 small frames.

Views of 96 x 128 px, 50 points, as fast as it goes; each frame is computed, tracked and written. `rss_mib` is the
resident memory when so many frames had been written, `growth_mib` since the first row.
"""

import time
from contextlib import suppress

import psutil

from bench.rows import Row
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
    """Return ten rows over the run, the first after a tenth of it."""
    count = 2_000 if quick else 100_000
    seen: list[tuple[float, float]] = []

    def watch(pid: int) -> None:
        with suppress(psutil.NoSuchProcess):  # the process has just ended
            seen.append((time.perf_counter(), psutil.Process(pid).memory_info().rss / 2**20))

    with exported(RECIPE) as bundle:
        summary = play(bundle, frames=count, watch=watch)
    end = seen[-1][0]
    begin = end - summary["seconds"]
    tenths = range(1, 11)
    moments = [begin + (end - begin) * tenth / 10 for tenth in tenths]
    resident = [min(seen, key=lambda entry: abs(entry[0] - moment))[1] for moment in moments]
    return [
        {"frames": summary["processed"] * tenth // 10, "rss_mib": mib, "growth_mib": mib - resident[0]}
        for tenth, mib in zip(tenths, resident, strict=True)
    ]
