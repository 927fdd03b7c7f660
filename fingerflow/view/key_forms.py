"""Forms of the page for the keys of a scene, derived from the table that `process` uses for validation."""

from typing import Any

from fingerflow.schema.scene_keys import (
    SCENE,
    Choice,
    Column,
    Each,
    File,
    NumberType,
    SceneKey,
    SceneTable,
    Switch,
    Text,
    Type,
    Whole,
    words_of,
)


def forms() -> dict[str, dict[str, Any]]:
    """Return a form for each table of the scene: its help, and the input fields of its keys.

    A field has name, label, help, kind of input, limits and default.

    Views are not among them, as they are drawn.
    """
    return {
        name: {
            "help": table.help,
            "keys": [_form(key, one) for key, one in table.keys.items() if isinstance(one, SceneKey)],
        }
        for name, table in SCENE.items()
        if isinstance(table, SceneTable)
    }


def _form(name: str, key: SceneKey) -> dict[str, Any]:
    words, unit = words_of(name, key)
    label = f"{words} ({unit})" if unit else words
    return {
        "name": name,
        "label": label,
        "help": key.help,
        "default": key.default,
        "needed": "process" in key.needed_by,
        **_input(key.type),
    }


def _input(kind: Type) -> dict[str, Any]:
    match kind:
        case Whole():
            return {"input": "whole", **_limits(kind), "odd": kind.odd}
        case NumberType():
            return {"input": "number", **_limits(kind)}
        case Choice():
            return {"input": "choice", "words": kind.words, "number": kind.number and _limits(kind.number)}
        case Switch():
            return {"input": "switch"}
        case File():
            return {"input": "file"}
        case Text():
            return {"input": "text"}
        case Column():
            return {"input": "column", "several": kind.several}
        case Each(among=(1, -1)):
            return {"input": "signs"}
        case _:
            return {"input": "toml"}  # a matrix or polygon is entered as TOML text


def _limits(number: NumberType) -> dict[str, float | None]:
    return {
        "least": number.above if number.least is None else number.least,
        "most": number.below if number.most is None else number.most,
    }
