"""Files that may be damaged, cut short or hostile: what every reader does before and while it lets a library read."""

from fingerflow.untrusted.files import check_file, first_line, plausible_size, reading
from fingerflow.untrusted.hdf5 import check_hdf5, open_hdf5, stored_whole

__all__ = ["check_file", "check_hdf5", "first_line", "open_hdf5", "plausible_size", "reading", "stored_whole"]
