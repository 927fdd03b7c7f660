"""Draft of a scene file that the page edits: values, validation problems, and writing to disk."""

import re
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table as TomlTable

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording
from fingerflow.results.atomic_write import spare, write_text
from fingerflow.schema.scene import Scene, scene_of_text, toml_remedy
from fingerflow.schema.scene_check import MISSING, SceneCheck
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.scene_tables import SCENE
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.text_file import read_text
from fingerflow.view.key_forms import field_name, reword

_REMEDY = "name a scene file, which is UTF-8 text"

Keys = tuple[str, ...]
_MOST_FILES = 300  # that a page lists
_HEADING = re.compile(r"(?:# )?\[([\w.]+)\]")  # of a table, possibly commented
#: Messages for missing keys that need more than "is needed".
_NEEDED = {
    "background.frames": "is needed: choose a recording of the empty glass",
    "calibration.mm_per_px": "is needed: calibrate from pictures, choose a calibration file, or enter the scale",
    "forces.normal": "is needed: choose the column of the normal force",
}


class NeedsLeaveError(FingerflowError):
    """Error raised before overwriting a file that the page has neither read nor written: the user must confirm."""


class Draft:
    """Scene file as it is edited on the page and perhaps not yet saved; setting a value keeps the comments and the
    order of keys.

    Attributes:
        path: path of the scene file, which may not exist yet.
    """

    def __init__(self, path: Path, text: str, stored: str | None) -> None:
        """Parse the text of a scene file; `stored` is the content of the file on disk, or None if there is none."""
        self.path = path.resolve()
        self._document = _parsed(text, self.path)
        self._stored = stored

    @classmethod
    def read(cls, path: Path) -> "Draft":
        """Return the draft of an existing scene file; raise FingerflowError if it cannot be read or is not TOML."""
        text = read_text(path, _REMEDY)
        return cls(path, text, text)

    @classmethod
    def create(cls, recording: Recording) -> "Draft":
        """Return a new draft for a recording, with two default views; keys that the user must set are absent."""
        height, width = recording.frame_shape
        path, number = recording.path.absolute().parent / "scene.toml", 2
        while path.exists():
            path, number = path.with_stem(f"scene-{number}"), number + 1
        draft = cls(path, scene_text(frames=recording.path.name, calibration=""), None)
        draft.set(("views",), _default_views("press", height, width))
        draft.set(("background", "frames"), None)
        return draft

    @property
    def text(self) -> str:
        """Return the text of the scene file as it would be written."""
        return tomlkit.dumps(self._document)

    @property
    def is_stored(self) -> bool:
        """Return True if the draft equals the file on disk, as last read or written by this page."""
        return self._stored == self.text and self.path.is_file()

    def values(self) -> dict[str, Any]:
        """Return the values of the draft as plain Python types."""
        return dict(self._document.unwrap())

    def table(self, name: str) -> dict[str, Any]:
        """Return the values of one table of the draft; empty if the table is missing or invalid."""
        table = self.values().get(name)
        return table if isinstance(table, dict) else {}

    def scene_kind(self) -> str:
        """Return the kind of the scene (such as press or slip) that the draft sets, or the default kind."""
        values = self.values()
        return str(values.get("kind", default_kind(values)))

    def problems(self) -> list[dict[str, str]]:
        """Return the draft's validation problems: key, name of its field on the page, and a message that continues a
        sentence after that name.
        """
        problems = SceneCheck(self.values(), self.path.parent, "process").problems()
        # The remedy of a missing key addresses those who edit the file by hand.
        said = ((key, _NEEDED.get(key, "is needed") if text == MISSING else reword(text)) for key, text in problems)
        return [{"key": key, "field": field_name(key), "said": text} for key, text in said]

    def scene(self) -> Scene:
        """Return the scene that the draft describes; raise FingerflowError if it is invalid."""
        return scene_of_text(self.text, self.path)

    def set(self, keys: Keys, value: Any) -> None:
        """Set a key of the draft, given as a tuple of table names and key, or remove it if the value is None.

        A table that becomes empty is removed, unless it is required.

        Raises:
            FingerflowError: a parent of the key is not a table, or TOML has no such value.
        """
        *tables, last = keys
        if value is not None and len(tables) == 1:
            self._uncomment(tables[0], last)
        table: Any = self._document
        around = []
        for name in tables:
            if name not in table:
                if value is None:
                    return
                table[name] = tomlkit.table()
            around.append((table, name))
            table = table[name]
            if not isinstance(table, TomlTable | dict):
                raise FingerflowError(f"{'.'.join(keys)}: {name} is no table in {self.path}; correct it there")
        if value is not None:
            try:
                table[last] = value
            except TOMLKitError:
                raise FingerflowError(f"{'.'.join(keys)}: {value!r} is no valid TOML value; correct it") from None
        elif last in table:
            del table[last]
            for outer, name in reversed(around):
                # A table that `process` requires stays in the file even if empty.
                if not len(outer[name]) and not (name in SCENE and "process" in SCENE[name].needed_by):
                    del outer[name]

    def _uncomment(self, table: str, key: str) -> None:
        """Activate the commented-out line of a key, and the commented-out heading of its table, where they stand in the
        text.
        """
        values = self.table(table)
        if key in values:
            return
        lines, heading, number = self.text.splitlines(keepends=True), "", 0
        for k, line in enumerate(lines):
            if heading_match := _HEADING.match(line):
                heading, number = heading_match[1], k
            elif heading == table and line.startswith(f"# {key} = "):
                if lines[number].startswith("# "):
                    if values:  # the table stands elsewhere
                        return
                    lines[number] = lines[number].removeprefix("# ")
                lines[k] = line.removeprefix("# ")
                self._document = _parsed("".join(lines), self.path)
                return

    def set_kind(self, kind: str, frame_shape: tuple[int, int]) -> None:
        """Set the kind of the scene, replacing views that do not suit it by default views for frames of (height, width)
        px.

        Raises:
            FingerflowError: unknown kind.
        """
        if kind not in KINDS:
            raise FingerflowError(f"kind is {kind!r}: it should be one of {', '.join(KINDS)}")
        views, scene_kind = self.table("views"), KINDS[kind]
        stated = "kind" in self._document
        if kind != default_kind(self.values()) or stated:
            if not stated:  # top-level keys must precede all tables
                self._document = _parsed(f'kind = "{kind}"\n{self.text}', self.path)
            self._document["kind"] = kind
        if set(views) - {*scene_kind.views, *scene_kind.optional_views} or set(scene_kind.views) - set(views):
            self.set(("views",), _default_views(kind, *frame_shape))

    def write(self, to: Path | None = None, replace: bool = False) -> Path:
        """Validate the draft as `process` does, write it as the scene file or to another path `to`, and return the path
        of that file; `replace` allows overwriting a file that the page has not read.

        Raises:
            NeedsLeaveError: a file exists with other content than was read, and `replace` is false.
            FingerflowError: the scene is invalid, or the file cannot be written.
        """
        path = self.path if to is None else to.resolve()
        text = self.text
        spare(path, *scene_of_text(text, path).files()[1:])
        if path.exists():
            # This raises an error for a result or a recording, which a scene never replaces.
            content = read_text(path, _REMEDY)
            if path != self.path and "views" not in _parsed(content, path):
                raise FingerflowError(f"{path}: is no scene file, which has [views]; name another file")
            if not replace and (path != self.path or content != self._stored):
                raise NeedsLeaveError(f"{path} exists with content that this page has neither read nor written")
        write_text(path, text)
        self.path, self._stored = path, text
        return path


def list_names(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of folders and of files in a folder, at most 300 of each, without hidden ones.

    Raises FingerflowError if the folder cannot be read.
    """
    try:
        paths = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=lambda path: path.name)
        folders, files = ([path.name for path in paths if path.is_dir() == wanted] for wanted in (True, False))
        return folders[:_MOST_FILES], files[:_MOST_FILES]
    except (OSError, ValueError) as error:  # ValueError: a name that no folder can have
        raise FingerflowError(f"{folder}: cannot be read ({error}); choose another folder") from None


def files_beside(path: Path) -> list[str]:
    """Return the names of files and folders in the folder of a path, as choices for an input field."""
    try:
        folders, files = list_names(path.parent)
        return sorted([*folders, *files])
    except FingerflowError:
        return []


def _default_views(kind: str, height: int, width: int) -> dict[str, Any]:
    """Return default views for a kind of scene: both halves of the frame (Willemet et al. 2021), or all of it."""
    rows = [0, height]
    if "contact" in KINDS[kind].views:
        half = width // 2
        return {"contact": {"rows": rows, "columns": [half, width]}, "topography": {"rows": rows, "columns": [0, half]}}
    return {name: {"rows": rows, "columns": [0, width]} for name in KINDS[kind].views}


def _parsed(text: str, path: Path) -> tomlkit.TOMLDocument:
    try:
        return tomlkit.parse(text)
    except (TOMLKitError, ValueError, RecursionError) as error:
        raise FingerflowError(f"{path}: is not valid TOML: {error}; {toml_remedy(text, error)}") from None
