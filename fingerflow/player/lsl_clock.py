"""Lab Streaming Layer: the package pylsl, and the offset of its clock to `time.perf_counter`."""

import time
from typing import Any

from fingerflow.player.named_objects import load_library


def load_lsl() -> tuple[Any, float]:
    """Import the package pylsl; return the module, and the offset in s that added to `time.perf_counter()` gives the
    clock of the Lab Streaming Layer. Raise ImportError if the package is missing.

    A few readings are taken, of which the one with the shortest time around it counts.
    """
    pylsl = load_library("pylsl", "pylsl")
    readings = []
    for _ in range(5):
        before, there, after = time.perf_counter(), pylsl.local_clock(), time.perf_counter()
        readings.append((after - before, there - (before + after) / 2))
    return pylsl, min(readings)[1]
