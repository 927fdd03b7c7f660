"""Check that files are readable and plausible in size, and convert library exceptions to error messages."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.guard.claimed_sizes import MOST_COMPRESSED

_ALWAYS = 1 << 20  # bytes to which any file may unpack, however small it is
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_file(path: Path) -> int:
    """Check that a path is a readable file, and return the file size in bytes.

    Raises FingerflowError if it is not a file (opening a pipe would block), does not exist, or may not be read.
    """
    try:
        status = path.stat()
        for is_kind, file_type in _KINDS:
            if is_kind(status.st_mode):
                remedy = (
                    "name a file in it" if file_type == _KINDS[0][1] else "copy what it gives to a file and name that"
                )
                raise FingerflowError(f"{path}: is {file_type}, not a file; {remedy}")
        with path.open("rb"):
            return status.st_size
    except FileNotFoundError:
        raise FingerflowError(f"{path}: there is no such file (looked in {Path.cwd()})") from None
    except (OSError, ValueError) as error:  # ValueError: the name cannot be that of a file
        raise FingerflowError(
            f"{path}: cannot be opened ({first_line(error)}); make it readable, or copy it to a place where it is"
        ) from error


@contextmanager
def reading(path: Path, file_type: str) -> Iterator[None]:
    """Context manager that converts any exception of a file library into a FingerflowError with file name and remedy.

    Libraries of file formats do not specify what they raise for a damaged file: struct.error, KeyError, AssertionError,
    ZeroDivisionError and codecs' own exceptions were observed. Therefore every exception is converted; the context
    encloses only the library's calls.
    """
    try:
        yield
    except FingerflowError:
        raise
    except Exception as error:
        raise FingerflowError(
            f"{path}: cannot be read as {file_type}, it is of another kind or damaged ({first_line(error)}); copy or "
            "export it again"
        ) from error


def plausible_size(claimed: int, stored: int) -> bool:
    """Return whether `stored` compressed bytes can plausibly expand to `claimed` bytes."""
    return claimed <= MOST_COMPRESSED * stored + _ALWAYS
