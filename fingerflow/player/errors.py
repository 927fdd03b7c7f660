"""What a user can put right, and how it is said."""


class PlayerError(Exception):
    """What the user can put right: names the file or setting, the value found and the way out."""


def first_line(error: BaseException) -> str:
    """Of what an error says, or its class where it says nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
