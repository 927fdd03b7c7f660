"""Settings of a result as readable tables: without None and brackets, with units."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

_UNITS = {"mm": "mm", "px": "px", "mpa": "MPa", "s": "s"}
_OF_KEYS = {"frame_rate": "Hz", "sample_rate": "Hz"}
_CHOICES = {"threshold", "strain", "direction", "template", "points_from", "criterion"}  # keys whose values are words


def settings_tables(stored: str) -> dict[str, list[tuple[str, str]]]:
    """Return rows (name, value) by table from the attribute `settings` of a result; unset keys are left out."""
    tables: dict[str, list[tuple[str, str]]] = {}
    for name, values in json.loads(stored).items():
        if name == "views" and "camera" in values:
            values = {"camera": values["camera"]}  # its other names are aliases for stages
        rows = _rows(values, "") if isinstance(values, Mapping) else []
        if rows:
            tables[name.replace("_", " ")] = rows
    return tables


def transform_rows(stored: str) -> list[tuple[str, str]]:
    """Return rows on the transform in the attribute `topography_to_contact`; none for the identity."""
    matrix = np.array(json.loads(stored), dtype=np.float64)
    if np.array_equal(matrix, [[1, 0, 0], [0, 1, 0]]):
        return []
    linear = matrix[:, :2]
    left, sizes, right = np.linalg.svd(linear)
    turn = left @ right  # the nearest rotation
    return [
        ("topography to contact view: magnified", f"{np.sqrt(abs(np.linalg.det(linear))):.4f} ×"),
        ("turned, from x towards y", f"{np.degrees(np.arctan2(turn[1, 0], turn[0, 0])):.3f}°"),
        ("moved", f"{matrix[0, 2]:+.2f} px in x, {matrix[1, 2]:+.2f} px in y"),
        ("sheared by at most", f"{sizes[0] / sizes[1] - 1:.2%}"),
    ]


def _rows(values: Mapping[str, Any], above: str) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, value in values.items():
        if value is None or name == "topography_to_contact":  # shown by `transform_rows`
            continue
        if isinstance(value, Mapping):
            sides = ("rows", "columns")
            if set(sides) <= set(value):
                ranges = (f"{side} {value[side][0]} to {value[side][1] - 1}" for side in sides)
                rows.append((f"{above}{_said(name)}", ", ".join(ranges)))
                value = {key: one for key, one in value.items() if key not in sides}
            rows += _rows(value, f"{above}{_said(name)}: ")
            continue
        unit = _OF_KEYS.get(name) or (_UNITS.get(name.rpartition("_")[2], "") if name != "mm_per_px" else "")
        text = _value(value).replace("_", " ") if name in _CHOICES else _value(value)
        rows.append((f"{above}{_said(name, bool(unit))}", f"{text} {unit}".rstrip()))
    return rows


def _said(name: str, has_unit: bool = False) -> str:
    if name == "mm_per_px":
        return "scale (mm/px)"
    words, _, last = name.rpartition("_")
    return (words if has_unit and last in _UNITS else name).replace("_", " ")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(_value(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
