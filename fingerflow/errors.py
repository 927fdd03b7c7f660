"""Exceptions for errors that the user can correct in a file, a setting or a name."""

from collections.abc import Iterable
from difflib import get_close_matches


class FingerflowError(Exception):
    """Error that the user can correct; its message names the file or setting, the value found, and the remedy.

    The command line prints it without a traceback and exits with status 2. A stream ends with it; after any other error
    of its source it tries again.
    """


class PlayerError(FingerflowError):
    """Error that the user of a stream can correct."""


class NoRoomError(FingerflowError):
    """Error for lack of memory or disk space, which may be transient: the same run may succeed another time."""


def is_out_of_memory(error: BaseException) -> bool:
    """Return True if an error says that memory is too small, also that of a GPU (torch.OutOfMemoryError)."""
    said = isinstance(error, RuntimeError) and "allocate memory" in str(error)
    return said or isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint, for a message, at the known word that is most like a misspelt one; "" if none is like it."""
    close = get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}? " if close else ""


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, up to 160 characters, without a system error's number and path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = (text.strip().splitlines() or [""])[0].strip("'\" ")
    return line[:160] or type(error).__name__
