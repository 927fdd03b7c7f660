"""Forms of the page for the keys of a scene, and their words, derived from the table that `process` uses for
validation.
"""

import re
from typing import Any

from fingerflow.schema.scene_keys import (
    SCENE,
    VIEW_HELP,
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


def field_name(key: str) -> str:
    """Return the words by which the page names a dotted key: the heading of its form and the label of its field, as in
    "Forces: normal force column"; for a key of a view that view. A key without a field keeps its name.
    """
    table, _, name = key.partition(".")
    if key == "views":
        return "the views"
    if table == "views" and (view := name.partition(".")[0]) in VIEW_HELP:
        return f"the {view} view"
    found = SCENE.get(table)
    if not isinstance(found, SceneTable):
        return key
    field = found.keys.get(name)
    if isinstance(field, SceneKey):
        return f"{table.capitalize()}: {words_of(name, field)[0]}"
    return key if name else table.capitalize()


def in_words_of_page(text: str) -> str:
    """Return a message in which each key of a scene file, written as `forces.normal`, `[forces] normal` or `[forces]`,
    is replaced by the quoted words by which the page names it.
    """
    return _DOTTED.sub(_named, _BRACKETED.sub(_named, text))


_TABLES = f"({'|'.join((*SCENE, 'views'))})"
_BRACKETED = re.compile(rf"\[{_TABLES}((?:\.\w+)*)\](?: (\w+))?")
_DOTTED = re.compile(rf"(?<![\w/.\[-]){_TABLES}((?:\.\w+)+)")  # a file such as forces.csv has no known key


def _named(found: re.Match[str]) -> str:
    key, after = found[1] + found[2], found[3] if found.re is _BRACKETED else ""
    if after and field_name(f"{key}.{after}") != f"{key}.{after}" and not key.startswith("views"):
        key, after = f"{key}.{after}", ""
    name = field_name(key)
    if name == key:
        return found[0]
    return (name if key.startswith("views") else f'"{name}"') + (f" {after}" if after else "")


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
