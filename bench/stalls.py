"""How much of the processor a machine takes from a program that does nothing but read the clock."""

import os
import subprocess
import sys
import time

_STALL = 1e-3  # s between two readings of the clock, which are a ten-thousandth of that apart


def stalled_ms_per_s(seconds: float = 3.0) -> float:
    """Time that is missing in gaps of more than 1 ms, of all cores together and a second of the clock."""
    command = [sys.executable, "-c", f"from bench.stalls import missing; print(missing({seconds}))"]
    watching = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(os.cpu_count() or 1)]
    return 1e3 * sum(float(one.communicate()[0]) for one in watching) / seconds


def missing(seconds: float) -> float:
    """The same on one core, s."""
    total, last = 0.0, time.perf_counter()
    end = last + seconds
    while last < end:
        now = time.perf_counter()
        if now - last > _STALL:
            total += now - last
        last = now
    return total
