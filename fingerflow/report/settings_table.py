"""Settings of a result as tables for readers, with units and without unset keys."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from fingerflow.schema.keys import SceneKey, SceneTable, key_words, keys_of
from fingerflow.schema.scene_tables import SCENE
from fingerflow.schema.views import Region


def settings_tables(stored: str) -> dict[str, list[tuple[str, str]]]:
    """Parse a result's attribute `settings`, and return rows (name, value) of each table without unset keys."""
    tables: dict[str, list[tuple[str, str]]] = {}
    for name, values in json.loads(stored).items():
        if name == "views" and "camera" in values:
            values = {"camera": values["camera"]}  # the other names are aliases of this view for stages
        rows = _rows(values, SCENE.get(name), "") if isinstance(values, Mapping) else []
        if rows:
            tables[name.replace("_", " ")] = rows
    return tables


def transform_rows(stored: str) -> list[tuple[str, str]]:
    """Return table rows on the scale, rotation and shift between the two views; none for an identity transform."""
    matrix = np.array(json.loads(stored), dtype=np.float64)
    if np.array_equal(matrix, [[1, 0, 0], [0, 1, 0]]):
        return []
    linear = matrix[:, :2]
    left, sizes, right = np.linalg.svd(linear)
    turn = left @ right  # the rotation nearest to the linear part
    return [
        ("topography to contact view: magnified", f"{np.sqrt(abs(np.linalg.det(linear))):.4f} ×"),
        ("turned, from x towards y", f"{np.degrees(np.arctan2(turn[1, 0], turn[0, 0])):.3f}°"),
        ("moved", f"{matrix[0, 2]:+.2f} px in x, {matrix[1, 2]:+.2f} px in y"),
        ("sheared by at most", f"{sizes[0] / sizes[1] - 1:.2%}"),
    ]


def _rows(values: Mapping[str, Any], table: SceneKey | SceneTable | None, above: str) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    keys = table.keys if isinstance(table, SceneTable) else {}
    for name, value in values.items():
        if value is None or name == "topography_to_contact":  # `transform_rows` shows the transform
            continue
        key = keys.get(name, keys_of(Region).get(name))
        words, unit = key_words(name, key) if key else (name.replace("_", " "), "")
        if isinstance(value, Mapping):
            sides = ("rows", "columns")
            if set(sides) <= set(value):
                ranges = (f"{side} {value[side][0]} to {value[side][1] - 1}" for side in sides)
                rows.append((f"{above}{words}", ", ".join(ranges)))
                value = {name: setting for name, setting in value.items() if name not in sides}
            rows += _rows(value, key, f"{above}{words}: ")
            continue
        text = _value(value)
        if isinstance(key, SceneKey) and key.type.form["input"] == "choice":
            text = text.replace("_", " ")
        rows.append((f"{above}{words}", f"{text} {unit}".rstrip()))
    return rows


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(_value(entry) for entry in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
