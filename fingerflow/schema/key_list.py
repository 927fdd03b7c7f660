"""List of all keys of scene files as text: type, default and meaning of each key."""

import json
from collections.abc import Iterator

from fingerflow.schema.keys import SceneKey, SceneTable, key_words
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.scene_tables import SCENE, views_of

# Description of a key in words: type, default, readers that need it, and meaning.
ListedKey = tuple[str, str, str, str]


def key_list() -> dict[str, ListedKey]:
    """Return descriptions of all keys of scene files by dotted path, in the order in which a scene of the kind "press"
    has them.
    """
    tables = {"views": views_of(KINDS["press"]), **SCENE}
    return {name: key for table, entry in tables.items() for name, key in _keys(entry, table)}


def as_text(name: str, key: ListedKey) -> str:
    """Return the description of a key as two lines of plain text."""
    words, default, needed_by, meaning = key
    needed = f", needed by {needed_by}" if needed_by else ""
    return f"{name}  {words}{f', default {default}' if default else ''}{needed}\n    {meaning}"


def _keys(entry: SceneKey | SceneTable, name: str) -> Iterator[tuple[str, ListedKey]]:
    if isinstance(entry, SceneTable):
        for key, inner in entry.keys.items():
            yield from _keys(inner, f"{name}.{key}")
        return
    default = "" if entry.default is None else json.dumps(entry.default)
    _, unit = key_words(name.rpartition(".")[2], entry)
    words = f"{entry.type.words} {unit}".rstrip()
    yield name, (words, default, ", ".join(sorted(entry.needed_by)), entry.help)
