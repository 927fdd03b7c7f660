"""List of all keys of scene files as text: type, default and meaning of each key."""

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from fingerflow.schema.scene_keys import (
    SCENE,
    Choice,
    Column,
    CornersType,
    Each,
    File,
    Moment,
    NumberType,
    Pair,
    PixelRange,
    SceneKey,
    SceneTable,
    Switch,
    Text,
    TimeRange,
    TransformType,
    Whole,
    views_of,
    words_of,
)
from fingerflow.schema.scene_kinds import KINDS


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
        for key, one in entry.keys.items():
            yield from _keys(one, f"{name}.{key}")
        return
    default = "" if entry.default is None else json.dumps(entry.default)
    _, unit = words_of(name.rpartition(".")[2], entry)
    kind = f"{_words(entry.type)} {unit}".rstrip()
    yield ListedKey(name, kind, default, ", ".join(sorted(entry.needed_by)), entry.help)


_PLAIN: dict[type, str] = {
    Switch: "true or false",
    Text: "text",
    TimeRange: "[t0, t1] from the trigger,",
    PixelRange: "[first, end)",
    CornersType: "[[x, y], ...], three or more,",
    TransformType: "[[a, b, x], [c, d, y]]",
}


def _words(of: Any) -> str:
    """Return the type and range of a scene file's key in words, such as "odd whole number ≥ 3", given its type `of`."""
    if type(of) in _PLAIN:
        return _PLAIN[type(of)]
    match of:
        case NumberType():
            limits = ((">", of.above), ("≥", of.least), ("≤", of.most), ("<", of.below))
            said = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)
            odd = "odd " if isinstance(of, Whole) and of.odd else ""
            return f"{odd}{'whole ' if isinstance(of, Whole) else ''}number {said}".strip()
        case Choice():
            words = [f'"{word}"' for word in of.words]
            return " or ".join([*words, *([] if of.number is None else [_words(of.number)])])
        case Moment():
            return " or ".join([*(f'"{word}"' for word in of.words), 'a frame, or a time such as "0.25 s"'])
        case Column():
            return "column" if of.several == 1 else f"column, or a list of up to {of.several}"
        case Each():
            values = " or ".join(f"{value:g}" for value in of.among) or _words(of.number)
            return f"{values}; or a list, one a force"
        case Pair():
            return f"[x, y], each a {_words(of.each)}"
        case File():
            return "path"
    raise TypeError(f"{of!r} has no words yet: add them here")
