"""Forms of the page for the keys of a scene, and their words, derived from the table that `process` uses for
validation.
"""

import re
from typing import Any

from fingerflow.schema.keys import SceneKey, key_words
from fingerflow.schema.scene_tables import SCENE, VIEW_HELP, find_entry


def forms() -> dict[str, dict[str, Any]]:
    """Return a form for each table of the scene: its help, and the input fields of its keys.

    A field has name, label, help, kind of input, limits and default.

    Views are not among them, as they are drawn.
    """
    tables = {}
    for name, table in SCENE.items():
        keys = [_form(key, entry) for key, entry in table.keys.items() if isinstance(entry, SceneKey)]
        tables[name] = {"help": table.help, "keys": keys}
    return tables


def field_name(key: str) -> str:
    """Return the words by which the page names a dotted key: the heading of its form and the label of its field, as in
    "Forces: normal force column"; for a key of a view that view. A key without a field keeps its name.
    """
    table, _, name = key.partition(".")
    if key == "views":
        return "the views"
    if table == "views" and (view := name.partition(".")[0]) in VIEW_HELP:
        return f"the {view} view"
    if table not in SCENE:
        return key
    field = find_entry(key)
    if isinstance(field, SceneKey) and "." not in name:
        return f"{table.capitalize()}: {key_words(name, field)[0]}"
    return key if name else table.capitalize()


def reword(text: str) -> str:
    """Return a message in which each key of a scene file, written as `forces.normal`, `[forces] normal` or `[forces]`,
    is replaced by the quoted words by which the page names it.
    """
    return _DOTTED.sub(_named, _BRACKETED.sub(_named, text))


_TABLES = f"({'|'.join((*SCENE, 'views'))})"
_BRACKETED = re.compile(rf"\[{_TABLES}((?:\.\w+)*)\](?: (\w+))?")
_DOTTED = re.compile(rf"(?<![\w/.\[-]){_TABLES}((?:\.\w+)+)")  # a file such as forces.csv has no known key


def _named(match: re.Match[str]) -> str:
    key, after = match[1] + match[2], match[3] if match.re is _BRACKETED else ""
    if after and field_name(f"{key}.{after}") != f"{key}.{after}" and not key.startswith("views"):
        key, after = f"{key}.{after}", ""
    name = field_name(key)
    if name == key:
        return match[0]
    return (name if key.startswith("views") else f'"{name}"') + (f" {after}" if after else "")


def _form(name: str, key: SceneKey) -> dict[str, Any]:
    words, unit = key_words(name, key)
    label = f"{words} ({unit})" if unit else words
    return {
        "name": name,
        "label": label,
        "help": key.help,
        "default": key.default,
        "needed": "process" in key.needed_by,
        **key.type.form,
    }
