"""Quoting of strings for TOML files."""

import json


def toml_string(text: str) -> str:
    """Return a TOML basic string with its quotes; backslashes, quotes and control characters are escaped."""
    # A TOML basic string is a JSON string in which U+007F is escaped too.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")
