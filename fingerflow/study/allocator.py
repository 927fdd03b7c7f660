"""What the C library does with memory that is given back."""

import ctypes
import platform

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt, <malloc.h> of the GNU C library
_LARGEST_FROM_HEAP = 32 << 20  # bytes, the most that it takes as a threshold
_KEPT = 256 << 20  # bytes at the end of a heap


def keep_memory() -> None:
    """Lets this process use memory again that it has freed, up to a few hundred MB, in place of asking the system.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_=65536: then each array above 128 kB is mapped anew and its pages
    are cleared by the system at the first touch, 600 of them a frame. Nothing is done where the C library is another
    one than GNU's.
    """
    if platform.libc_ver()[0] == "glibc":
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGEST_FROM_HEAP)
        library.mallopt(_TRIM_THRESHOLD, _KEPT)
