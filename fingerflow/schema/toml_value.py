"""Formatting of Python values as TOML."""

import json
from collections.abc import Mapping
from typing import Any


def toml_value(value: Any) -> str:
    """Format a string, number, boolean, list or table as a TOML value on one line."""
    if isinstance(value, str):  # a JSON string is a TOML basic string, except that TOML also escapes U+007F
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {toml_value(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return repr(value)
