"""Forms of the page for the keys of a scene, from the table that `process` checks them with."""

from typing import Any

from fingerflow.schema.scene_keys import SCENE, Choice, File, NumberType, SceneKey, SceneTable, Switch, Text, Whole
from fingerflow.schema.scene_kinds import KINDS


def kinds() -> list[str]:
    """Return the kinds of scenes."""
    return list(KINDS)


def forms() -> dict[str, list[dict[str, Any]]]:
    """Return the keys of each table with name, kind of input, limits and default.

    Views are not among them, as they are drawn.
    """
    return {
        name: [_form(key, one) for key, one in table.keys.items() if isinstance(one, SceneKey)]
        for name, table in SCENE.items()
        if isinstance(table, SceneTable)
    }


def _form(name: str, key: SceneKey) -> dict[str, Any]:
    kind = key.type
    said: dict[str, Any] = {"name": name, "default": key.default, "needed": "process" in key.needed_by}
    match kind:
        case Whole():
            return {**said, "input": "whole", **_limits(kind), "odd": kind.odd}
        case NumberType():
            return {**said, "input": "number", **_limits(kind)}
        case Choice():
            return {**said, "input": "choice", "words": kind.words, "number": kind.number and _limits(kind.number)}
        case Switch():
            return {**said, "input": "switch"}
        case File():
            return {**said, "input": "file"}
        case Text():
            return {**said, "input": "text"}
        case _:
            return {**said, "input": "toml"}  # a matrix or polygon, as TOML text


def _limits(number: NumberType) -> dict[str, float | None]:
    return {
        "least": number.above if number.least is None else number.least,
        "most": number.below if number.most is None else number.most,
    }
