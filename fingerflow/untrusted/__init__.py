"""Files that may be damaged, cut short or hostile: what every reader does before and while it lets a library read."""

from fingerflow.untrusted.files import check_file, first_line, plausible_size, reading
from fingerflow.untrusted.hdf5 import open_hdf5, stored_whole
from fingerflow.untrusted.walker import check_by_walking, read_matlab_apart

__all__ = [
    "check_by_walking",
    "check_file",
    "first_line",
    "open_hdf5",
    "plausible_size",
    "read_matlab_apart",
    "reading",
    "stored_whole",
]
