"""What a user can put right, and how it is said."""

from fingerflow.errors import FingerflowError


class PlayerError(FingerflowError):
    """What the user of a stream can put right. A stream ends with it; of any other error it tries again."""


def first_line(error: BaseException) -> str:
    """What an error says first, or else its type."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
