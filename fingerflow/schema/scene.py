"""Reading of experiment settings: the content of a scene file (TOML), whose problems are reported with line, key, value
and remedy.
"""

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.key_types import Reader
from fingerflow.schema.scene_check import Keys, SceneCheck
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.scene_tables import SCENE, SETTINGS_FORMAT, VIEW
from fingerflow.schema.scene_tables import Scene as Scene
from fingerflow.schema.scene_tables import Views as Views
from fingerflow.schema.text_file import read_text

_VIEW_MM = (2.0, 100.0)  # mm, least and largest side of a view of a fingertip


def load_scene(path: str | Path, reader: Reader = "process") -> Scene:
    """Read and validate a scene file for one reader, `process` or a stream, and return the settings in it.

    Raises:
        FingerflowError: the file is missing or is not valid TOML, a key is unknown, a value has the wrong type or
            range, keys contradict each other, or a file that the reader needs is missing; with the line and the remedy.
    """
    path = Path(path).resolve()
    return scene_of_text(read_text(path, "name a scene file, which `fingerflow init` writes"), path, reader)


def scene_of_text(text: str, path: Path, reader: Reader = "process") -> Scene:
    """Return the scene that a TOML text describes, which is or will be the file `path`; raise errors as
    :func:`load_scene`.
    """
    path = path.resolve()
    written = SceneCheck(parse_toml(text, path), path.parent, reader)
    return _scene(written, path, lambda keys: f"{path}, line {line_number(text, keys)}")


def scene_from(written: Mapping[str, Any], path: Path, origin: str, reader: Reader = "process") -> Scene:
    """Return the scene with the given tables and keys, `written`, which is one of several scenes in the file `path`.

    Args:
        written: tables and keys as parsed from TOML.
        path: that file; paths are relative to its folder.
        place: location of the scene in the file, for error messages.
        reader: `process` or a stream.

    Raises:
        FingerflowError: as `load_scene`.
    """
    return _scene(SceneCheck(written, path.parent, reader), path, lambda _: origin)


def scene_of_settings(settings: str) -> Scene:
    """Return the scene from which a result was computed, given the JSON text of the result's attribute `settings`.

    Raises:
        FingerflowError: a file that it names is missing, a key is no longer valid, or a later version wrote the
            settings; with the remedy.
    """
    stored = json.loads(settings)
    path = Path(stored.pop("path"))
    if (version := stored.pop("format", 0)) > SETTINGS_FORMAT:
        raise FingerflowError(f"{path}: the settings in its result have format {version}; update fingerflow")
    scene_kind = stored.setdefault("kind", default_kind(stored))
    shown = KINDS[scene_kind].all_views if scene_kind in KINDS else ()
    stored["views"] = {name: stored["views"][name] for name in shown if name in stored["views"]}  # files hold no roles
    stored["calibration"].pop("file", None)  # the other settings already hold the values of this file
    return scene_from(stored, path, "settings of the result")


def _scene(check: SceneCheck, path: Path, place_of: Callable[[Keys], str]) -> Scene:
    """Build a scene of its validated content, or raise FingerflowError with one line for each problem."""
    check.raise_problems(place_of)
    tables = {name: table.build(check.values[name]) for name, table in SCENE.items()}
    views = {name: VIEW.build(view) for name, view in check.values["views"].items() if view is not None}
    return Scene(
        path=path, kind=check.kind, profile=check.profile, views=Views(views), given=frozenset(check.given), **tables
    )


def line_number(text: str, keys: Keys) -> int:
    """Return the line number of a key in the text of a scene file; if absent, of the nearest enclosing table, or 1."""
    table: Keys = ()
    longest, result = 0, 1
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[+([^\[\]]+)\]", line):
            position = table = _parts(header[1])
        elif setting := re.match(r"([^#=]+)=", line):
            position = (*table, *_parts(setting[1]))
        else:
            continue
        if longest < len(position) and position == keys[: len(position)]:
            longest, result = len(position), number
    return result


def _parts(dotted: str) -> Keys:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


#: Patterns of a line that is not valid TOML, and what to do.
_SLIPS = {
    r"^[^\[#]*=\s*-?\d+,\d+\s*(#|$)": "write a decimal point in place of the comma",
    r"\\": "write / in place of \\ in a path",
    r"^[^\"#]*=\s*\"[^\"]*$": "a quotation mark is missing",
}


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the tables of the text of a TOML file; raise FingerflowError where it is none."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FingerflowError(f"{path}: is not valid TOML: {error}; {toml_remedy(text, error)}") from None


def toml_remedy(text: str, error: Exception) -> str:
    """Return what to do about the line that a parser of TOML refuses, if it shows one of the frequent slips."""
    match = re.search(r"at line (\d+)", str(error))
    line = text.splitlines()[int(match[1]) - 1] if match else ""
    return next((remedy for slip, remedy in _SLIPS.items() if re.search(slip, line)), "correct it there")


def check_scale(scene: Scene) -> Iterator[str]:
    """Yield a warning if the contact view, by the image scale, is far narrower or wider than a fingertip."""
    scale, (least, most) = scene.calibration.mm_per_px, _VIEW_MM
    width = scale * max(scene.views.contact.shape)
    if not least <= width <= most:
        yield (
            f"calibration.mm_per_px = {scale:g} makes the contact view {width:.2g} mm wide, those of fingertips are "
            f"{least:g} to {most:g} mm wide: the scale is wrong, and lengths and areas with it; calibrate again"
        )
