"""Conversion between nested tables of scene files and flat dictionaries with dotted keys, such as `tracking.points`."""

from collections.abc import Iterator, Mapping
from typing import Any


def flattened(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables as pairs (dotted key, value), such as ("tracking.points", 200)."""
    for name, value in tables.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables built from a flat dictionary with dotted keys."""
    tables: dict[str, Any] = {}
    for dotted, value in values.items():
        table = tables
        *above, last = dotted.split(".")
        for name in above:
            table = table.setdefault(name, {})
        table[last] = value
    return tables
