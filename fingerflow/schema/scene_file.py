"""Reader of scene files that reports each problem as one line: file, line number, key, value and remedy."""

import re
import tomllib
from pathlib import Path

from fingerflow.schema.scene_check import Checked, Keys, check_scene
from fingerflow.schema.scene_keys import Reader


class SceneError(Exception):
    """Error that lists all problems of a scene file, one per line."""


def read_scene(path: Path, reader: Reader) -> Checked:
    """Return the validated content of a scene file, checked for one reader: `process` or a stream.

    Raises SceneError where the file is missing or is not valid TOML, a key is unknown, a value has the wrong type or
    range, keys contradict each other, or a file that the reader needs is missing.
    """
    path = path.resolve()
    if path.exists() and not path.is_file():
        raise SceneError(f"{path}: is no file; name a scene file, which `fingerflow init` writes")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); `fingerflow init` writes a new one") from None
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{path}: is not UTF-8 text ({error.reason}); save it as UTF-8, or name a scene "
            "file, which `fingerflow init` writes, if this is a recording"
        ) from None
    return parse_scene(text, path, reader)


def parse_scene(text: str, path: Path, reader: Reader) -> Checked:
    """Return the validated content of a text that will be the scene file `path`; raise errors as :func:`read_scene`."""
    try:
        written = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SceneError(f"{path}: is not valid TOML: {error}; {toml_remedy(text, error)}") from None
    found, problems = check_scene(written, path.parent, reader)
    if problems:
        lines = [f"{path}, line {_line(text, one.keys)}: {'.'.join(one.keys)} {one.said}" for one in problems]
        raise SceneError("\n".join(lines))
    return found


def _line(text: str, keys: Keys) -> int:
    """Return the line number of a key in the text of a scene file; if absent, of the nearest enclosing table, or 1."""
    table: Keys = ()
    longest, result = 0, 1
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[+([^\[\]]+)\]", line)
        setting = re.match(r"([^#=]+)=", line)
        if header:
            place = table = _parts(header[1])
        elif setting:
            place = (*table, *_parts(setting[1]))
        else:
            continue
        if longest < len(place) and place == keys[: len(place)]:
            longest, result = len(place), number
    return result


def _parts(dotted: str) -> Keys:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


#: Patterns of a line that is not valid TOML, and what to do.
_SLIPS = {
    r"^[^\[#]*=\s*-?\d+,\d+\s*(#|$)": "write a decimal point in place of the comma",
    r"\\": "write / in place of \\ in a path",
    r"^[^\"#]*=\s*\"[^\"]*$": "a quotation mark is missing",
}


def toml_remedy(text: str, error: Exception) -> str:
    """Return what to do about the line that a parser of TOML refuses, if it shows one of the frequent slips."""
    place = re.search(r"at line (\d+)", str(error))
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    return next((remedy for slip, remedy in _SLIPS.items() if re.search(slip, line)), "correct it there")
