"""Keep freed memory in the process by setting thresholds of the C library's allocator."""

import ctypes
import platform

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of mallopt, from <malloc.h> of the GNU C library
_LARGEST_FROM_HEAP = 32 << 20  # bytes, largest MMAP_THRESHOLD that mallopt accepts
_KEPT = 256 << 20  # bytes of free memory kept at the end of a heap


def keep_memory() -> None:
    """Keep up to a few hundred MB of freed memory in this process for reuse instead of returning it to the system.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_=65536. Each array above 128 kB is then mapped again and its pages
    are cleared by the system at the first touch, 600 of them per frame. Without the GNU C library nothing is done.
    """
    if platform.libc_ver()[0] == "glibc":
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGEST_FROM_HEAP)
        library.mallopt(_TRIM_THRESHOLD, _KEPT)
