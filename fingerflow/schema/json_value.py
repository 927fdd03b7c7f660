"""Conversion of Python values to JSON types."""

import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any


def json_value(value: Any) -> Any:
    """Convert a value, data class or NumPy array to JSON types, with None in place of NaN and infinity."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy have this method
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(name): json_value(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
