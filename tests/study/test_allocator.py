"""Memory that is freed is used again, also where Dask has told the C library to give it back at once."""

import ctypes
import platform
import resource

import numpy as np
import pytest

from fingerflow.study.allocator import keep_memory

_BYTES, _TIMES = 1 << 20, 50
_MMAP_THRESHOLD = -3


def _faults() -> int:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(_TIMES):
        np.ones(_BYTES, dtype=np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is of the GNU C library")
def test_arrays_take_pages_that_are_there() -> None:
    pages = _BYTES // resource.getpagesize()
    ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 128 << 10)  # as Dask's workers are started
    try:
        assert _faults() >= _TIMES * pages  # else this shows nothing
    finally:
        keep_memory()
    assert _faults() <= 4 * pages  # once, where the heap has to grow
