"""List of all keys of scene files as text: type, default and meaning of each key."""

import json
from collections.abc import Iterator
from typing import NamedTuple

from fingerflow.schema.keys import SceneKey, SceneTable, key_words
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.scene_tables import SCENE, views_of


class ListedKey(NamedTuple):
    """Text description of one key of scene files: dotted path, type, default and meaning."""

    name: str
    type: str
    default: str
    needed_by: str
    help: str

    def __str__(self) -> str:
        """Return the description of the key as two lines of plain text."""
        needed = f", needed by {self.needed_by}" if self.needed_by else ""
        default = f", default {self.default}" if self.default else ""
        return f"{self.name}  {self.type}{default}{needed}\n    {self.help}"


def key_list() -> list[ListedKey]:
    """Return descriptions of all keys of scene files, in the order in which a scene of the kind "press" has them."""
    tables = {"views": views_of(KINDS["press"]), **SCENE}
    return [key for name, table in tables.items() for key in _keys(table, name)]


def _keys(entry: SceneKey | SceneTable, name: str) -> Iterator[ListedKey]:
    if isinstance(entry, SceneTable):
        for key, inner in entry.keys.items():
            yield from _keys(inner, f"{name}.{key}")
        return
    default = "" if entry.default is None else json.dumps(entry.default)
    _, unit = key_words(name.rpartition(".")[2], entry)
    words = f"{entry.type.words} {unit}".rstrip()
    yield ListedKey(name, words, default, ", ".join(sorted(entry.needed_by)), entry.help)
