"""Tests that freed memory is reused, even if Dask has told the C library to return it to the system at once."""

import os
import platform
import resource
import subprocess
import sys

import pytest

_BYTES, _TIMES = 1 << 20, 50
_FAULTS = f"""
import resource
import numpy as np
from fingerflow.study.allocator import keep_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range({_TIMES}):
        np.ones({_BYTES}, dtype=np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

first = faults()
keep_memory()
print(first, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is of the GNU C library")
def test_arrays_take_pages_that_are_there() -> None:
    """New arrays reuse pages of the heap; this runs in a process of its own, started as Dask starts a worker, because
    the setting lasts.
    """
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    done = subprocess.run([sys.executable, "-c", _FAULTS], env=environment, capture_output=True, text=True, check=True)
    first, then = map(int, done.stdout.split())
    pages = _BYTES // resource.getpagesize()
    if first < _TIMES * pages:  # huge pages, or a kernel that does not count faults
        pytest.skip(f"this system counts {first} page faults for {_TIMES * pages} new pages, which shows nothing")
    assert then <= 4 * pages  # once, when the heap grows
