"""What is wrong in a scene file, said with the line, the value and the way out."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from fingerflow.errors import FingerflowError

Location = tuple[str, ...]

_HEADER = re.compile(r"""^\s*\[\s*([\w"'.\- ]+?)\s*\]\s*(#.*)?$""")
_KEY = re.compile(r"""^\s*([\w"'.\- ]+?)\s*=""")


def describe(path: Path, text: str, table: dict[str, Any], error: ValidationError) -> FingerflowError:
    """The first thing that is wrong in a scene file as one sentence for its author."""
    details = error.errors()
    location, value = _in_table(table, _location(details[0]))
    # A setting that may be of several kinds has one complaint for each kind.
    complaints = [detail["msg"] for detail in details if _in_table(table, _location(detail))[0] == location]
    name = _name(table, location)
    place = f"{path}, line {line_of(text, location)}: {name}"
    first = details[0]
    if first["type"] == "missing":
        key = str(first["loc"][-1])
        return FingerflowError(f"{path}, line {line_of(text, location)}: {_missing(table, location, key)}")
    if first["type"] == "scene":
        return FingerflowError(f"{place} {complaints[0]}")
    needed = " or ".join(dict.fromkeys(complaint.replace("Input should be", "it must be") for complaint in complaints))
    return FingerflowError(f"{place} is {value!r}; {needed}")


def wrong(key: str | None, sentence: str) -> PydanticCustomError:
    """The error of a validator about a key of its table; the sentence follows the name of the key."""
    return PydanticCustomError("scene", "{sentence}", {"sentence": sentence, "key": key})


def unknown_key(key: str, known: Iterable[str]) -> PydanticCustomError:
    """The error for a key that a table does not have."""
    names = sorted(known)
    close = get_close_matches(key, names, n=1, cutoff=0.5)
    guess = f"; did you mean {close[0]}?" if close else "."
    return wrong(key, f"is not known here{guess} Known are {', '.join(names)}")


def line_of(text: str, location: Location) -> int:
    """The line, from 1, on which a key or a table stands, or what it lies in, where it stands nowhere itself."""
    lines: dict[Location, int] = {}
    table: Location = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _parts(header[1])
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            lines.setdefault((*table, *_parts(key[1])), number)
    for depth in range(len(location), 0, -1):
        # [views.contact] is where `views` is, too.
        found = [number for name, number in lines.items() if name[:depth] == location[:depth]]
        if found:
            return lines.get(location[:depth], found[0])
    return 1


def _parts(name: str) -> Location:
    return tuple(part.strip(" \"'") for part in name.split("."))


def _location(detail: Any) -> Location:
    location = tuple(str(part) for part in detail["loc"])
    key = detail.get("ctx", {}).get("key")
    return (*location, key) if key else location


def _in_table(table: dict[str, Any], location: Location) -> tuple[Location, Any]:
    """The part of a location that stands in the file, and the value there."""
    value: Any = table
    for depth, part in enumerate(location):
        if not isinstance(value, dict) or part not in value:
            return location[:depth], value
        value = value[part]
    return location, value


def _name(table: dict[str, Any], location: Location) -> str:
    """[table] key, as one reads it in the file."""
    if isinstance(_in_table(table, location)[1], dict):
        return f"[{'.'.join(location)}]" if location else "the scene"
    return " ".join([*([f"[{'.'.join(location[:-1])}]"] if location[:-1] else []), location[-1]])


def _missing(table: dict[str, Any], location: Location, key: str) -> str:
    remedy = "`fingerflow init` writes a scene in which every entry is explained"
    return f"{_name(table, location)} has no {key}, which is needed; add it ({remedy})"
