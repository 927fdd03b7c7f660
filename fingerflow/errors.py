"""The one exception for what a user can put right: a file, a setting, a name."""


class FingerflowError(Exception):
    """Names the file or setting, the value that was found and the way out.

    The command line prints it without a traceback and exits with status 2.
    """


class NoRoomError(FingerflowError):
    """Memory or disk is too small for now: the same may go well another time."""
