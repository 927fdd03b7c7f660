"""The exceptions for what a user can put right: a file, a setting, a name."""


class FingerflowError(Exception):
    """Names the file or setting, the value that was found and the way out.

    The command line prints it without a traceback and exits with status 2. A stream ends with it; after any other error
    of its source it tries again.
    """


class PlayerError(FingerflowError):
    """What the user of a stream can put right."""


class NoRoomError(FingerflowError):
    """Memory or disk is too small for now: the same may go well another time."""


def first_line(error: BaseException) -> str:
    """Return what an error says first, in at most 160 letters; of a system error its words without number and path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = (text.strip().splitlines() or [""])[0].strip("'\" ")
    return line[:160] or type(error).__name__
