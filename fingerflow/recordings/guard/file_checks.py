"""Check that files are plausible in size, and convert library exceptions to error messages."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.guard.claimed_sizes import MOST_COMPRESSED

_ALWAYS = 1 << 20  # bytes to which any file may unpack, however small it is


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
