"""Generation of the text of new, commented scene files from the key definitions in `schema.scene_tables`."""

import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from fingerflow.schema.keys import SceneKey, SceneTable
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.scene_tables import SCENE, views_of
from fingerflow.schema.toml_value import toml_value
from fingerflow.schema.views import View

_COMMENT = 30  # column at which comments begin
_WIDTH = 120
_TOPOGRAPHY, _CONTACT = View((0, 512), (0, 640)), View((0, 512), (640, 1280))
_HEAD = (
    "# Scene of fingerflow: a recording, and the settings with which it is processed. Paths are relative to this "
    "file.\n"
)
_ALWAYS = ("recording", "background", "calibration", "contact", "tracking", "fields")  # tables that are always written
# Keys of the table of forces, written if a force file is given.
_OF_FORCES = ("normal", "tangential", "trigger", "trigger_level")


def scene_text(
    *,
    frames: str = "frames.cine",
    frame_rate: float | None = None,
    trigger_frame: int | None = None,
    background: str = "empty.cine",
    dark: str | None = None,
    contact: View = _CONTACT,
    topography: View = _TOPOGRAPHY,
    forces: str | None = None,
    calibration: str = 'file = "calibration.toml"',
    region: View | None = None,
    slip: bool = False,
) -> str:
    """Return the text of a new scene file with comments, whose defaults suit the two-view rig of Willemet et al. 2021.

    ``calibration`` is the content of the table [calibration] in TOML. ``region`` is the part of the topography view
    where points are seeded. With ``slip`` the scene is a trial of tangential loading.
    """
    values: dict[str, dict[str, Any]] = {name: {} for name in _ALWAYS}
    values["recording"] = {"frames": frames, "frame_rate": frame_rate, "trigger_frame": trigger_frame}
    values["background"] = {"frames": background, "dark": dark}
    values["calibration"] = tomllib.loads(calibration)
    if forces:
        values["forces"] = {"file": forces, **{name: _sample(SCENE["forces"].keys[name]) for name in _OF_FORCES}}
    if slip:
        values["slip"] = {}
    if region:
        values["stream"] = {"region": _rectangle(region)}
    views = {"contact": contact, "topography": topography}
    other_kinds = ", ".join(scene_kind for scene_kind in KINDS if scene_kind != "press")
    lines = [_commented('# kind = "press"', f"or {other_kinds}; slip is the default of a scene with a table [slip]")]
    for name, table in SCENE.items():
        lines += ["", *_table_text(name, table, values.get(name))]
        if name == "recording":
            for view, rectangle in views_of(KINDS["press"]).keys.items():
                lines += ["", *_table_text(f"views.{view}", rectangle, _rectangle(views[view]))]
    return _HEAD + "\n".join(lines) + "\n"


def _table_text(name: str, table: SceneKey | SceneTable, values: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield the lines of the table `name` in the text of a new scene file; if `values` is None, all lines are comments.

    Keys without a value are comments with their default or sample; if all keys of the table have defaults, they are
    written with them.
    """
    assert isinstance(table, SceneTable)
    mark = "# " if values is None else ""
    yield _commented(f"{mark}[{name}]", table.help)
    by_default = all(isinstance(key, SceneKey) and key.default is not None for key in table.keys.values())
    for key, entry in table.keys.items():
        value = (values or {}).get(key)
        written = value is not None or (by_default and values is not None)
        value = _sample(entry) if value is None else value
        if value is not None:
            yield _commented(f"{'' if written else '# '}{key} = {toml_value(value)}", _help(entry))


def _help(entry: SceneKey | SceneTable) -> str:
    if isinstance(entry, SceneTable):
        return entry.help
    if entry.type.choices:
        words = ", ".join(map(toml_value, entry.type.choices))
        number = " or a number" if entry.type.form.get("number") else ""
        return f"{words}{number}: {entry.help}"
    return f"{entry.unit}, {entry.help}" if entry.unit not in ("", "px", "mm/px") else entry.help


def _sample(entry: SceneKey | SceneTable) -> Any:
    """Return the sample value, or else the default, that a new scene file shows for a key."""
    return entry.default if isinstance(entry, SceneKey) and entry.sample is None else entry.sample


def _rectangle(view: View) -> dict[str, Any]:
    return {"rows": list(view.rows), "columns": list(view.columns)}


def _commented(text: str, comment: str) -> str:
    """Return a line of TOML followed by a comment; a long comment continues on further lines."""
    lines = textwrap.wrap(comment, _WIDTH - _COMMENT - 2)
    fits = lines and len(text) + 4 + len(lines[0]) <= _WIDTH
    first = f"{text:<{_COMMENT - 2}}  # {lines.pop(0)}" if fits else text
    return "\n".join([first, *(" " * _COMMENT + f"# {line}" for line in lines)])
