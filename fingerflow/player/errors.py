"""What a user can put right, and how it is said."""


class PlayerError(Exception):
    """What the user can put right: names the file or setting, the value found and the way out."""


def first_line(error: BaseException) -> str:
    """What an error says first, or else its type."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
