"""A string as TOML writes it."""

import json


def toml_string(text: str) -> str:
    """A basic string with its quotes; backslashes of Windows paths, quotes and control characters are escaped."""
    # TOML's basic string is JSON's, except that TOML has U+007F escaped too.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")
