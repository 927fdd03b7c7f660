"""A scene file while it is being set up: what it says, what is wrong with it, and its writing."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Table as TomlTable

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording
from fingerflow.results.atomic_write import spare, write_atomically
from fingerflow.schema.scene import Scene, scene_of_text, scene_text
from fingerflow.schema.scene_check import MISSING, check_scene
from fingerflow.schema.scene_keys import SCENE
from fingerflow.schema.scene_kinds import KINDS, default_kind

Keys = tuple[str, ...]
#: What is said of a key that is missing, where more helps than that it is.
_NEEDED = {
    "background.frames": "is needed: frames of the empty glass",
    "calibration.mm_per_px": "is needed: calibrate from pictures, name a calibration file, or type the scale",
    "forces.normal": "is needed: the column of the normal force in the file",
}


class NeedsLeaveError(FingerflowError):
    """A file would be replaced whose content this page has neither read nor written."""


class Draft:
    """The text of a scene file; comments and the order of the keys stay when a value changes.

    Attributes:
        path: the file that it is of, or will be.
    """

    def __init__(self, path: Path, text: str, stored: str | None) -> None:
        """`stored` is the content of the file as it was read, None where there was none."""
        self.path = path.resolve()
        self._document = _parsed(text, self.path)
        self._stored = stored

    @classmethod
    def of_file(cls, path: Path) -> "Draft":
        """Raises FingerflowError where the file cannot be read, or is no TOML."""
        text = _read(path)
        return cls(path, text, text)

    @classmethod
    def of_recording(cls, recording: Recording) -> "Draft":
        """A scene of two views side by side, beside the recording; what nobody can know of it is left out."""
        height, width = recording.frame_shape
        path = _free(recording.path.absolute().parent / "scene.toml")
        text = scene_text(frames=recording.path.name, calibration="")
        draft = cls(path, text, None)
        draft.set(("views",), _views_of("press", height, width))
        draft.set(("background", "frames"), None)
        return draft

    @property
    def text(self) -> str:
        """The content of the file as it would be written."""
        return tomlkit.dumps(self._document)

    @property
    def is_stored(self) -> bool:
        """Whether the file has this content."""
        return self._stored == self.text and self.path.is_file()

    def values(self) -> dict[str, Any]:
        """What it says, as TOML gives it."""
        return dict(self._document.unwrap())

    def kind(self) -> str:
        """The kind of the scene, stated or not."""
        values = self.values()
        return str(values.get("kind", default_kind(values)))

    def problems(self) -> list[dict[str, str]]:
        """What is wrong with which key, in words that follow the key."""
        _, problems = check_scene(self.values(), self.path.parent, "process")
        found = [{"key": ".".join(one.keys), "said": one.said} for one in problems]
        for one in found:
            if one["said"] == MISSING:  # whose remedy is for those who write the file by hand
                one["said"] = _NEEDED.get(one["key"], "is needed")
        return found

    def scene(self) -> Scene:
        """Raises FingerflowError where something is wrong."""
        return scene_of_text(self.text, self.path)

    def set(self, keys: Keys, value: Any) -> None:
        """Sets a key; None takes it out, and its table with its last one, where a scene can be without it.

        Raises FingerflowError where a key stands in the place of a table.
        """
        *tables, last = keys
        place: Any = self._document
        around = []
        for name in tables:
            if name not in place:
                if value is None:
                    return
                place[name] = tomlkit.table()
            around.append((place, name))
            place = place[name]
            if not isinstance(place, TomlTable | dict):
                raise FingerflowError(f"{'.'.join(keys)}: {name} is no table in {self.path}; correct it there")
        if value is not None:
            place[last] = value
        elif last in place:
            del place[last]
            for outer, name in reversed(around):
                if not len(outer[name]) and not _is_needed(name):
                    del outer[name]

    def set_kind(self, kind: str, frame_shape: tuple[int, int]) -> None:
        """Another kind of scene; where its views are others, they begin as the halves of a frame, or all of it.

        Raises FingerflowError for a kind that there is not.
        """
        if kind not in KINDS:
            raise FingerflowError(f"kind is {kind!r}: it should be one of {', '.join(KINDS)}")
        views, known = self.values().get("views", {}), KINDS[kind]
        stated = "kind" in self._document
        if kind != default_kind(self.values()) or stated:
            if not stated:  # keys of no table stand before all tables
                self._document = _parsed(f'kind = "{kind}"\n{self.text}', self.path)
            self._document["kind"] = kind
        if set(views) - {*known.views, *known.optional_views} or set(known.views) - set(views):
            self.set(("views",), _views_of(kind, *frame_shape))

    def write(self, to: Path | None = None, replace: bool = False) -> Path:
        """Writes the file, and checks it as `process` would read it before it appears.

        Raises:
            NeedsLeaveError: there is a file with another content than was read, and `replace` is false.
            FingerflowError: something is wrong with the scene, or it cannot be written.
        """
        path = self.path if to is None else to.resolve()
        text = self.text
        scene = scene_of_text(text, path)
        spare(path, *scene.files()[1:])
        if path.exists() and not replace and not (path == self.path and _read(path) == self._stored):
            raise NeedsLeaveError(f"{path} exists, and its content is not what this page has read or written")
        write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))
        self.path, self._stored = path, text
        return path


def files_beside(path: Path, most: int = 300) -> list[str]:
    """Names in the folder of a file, for somebody who has to choose one."""
    try:
        names: Iterable[str] = sorted(one.name for one in path.parent.iterdir() if not one.name.startswith("."))
    except OSError:
        return []
    return list(names)[:most]


def _views_of(kind: str, height: int, width: int) -> dict[str, Any]:
    """Two views are the halves of a frame as the rig of Willemet et al. 2021 has them; one is all of it."""
    rows = [0, height]
    if "contact" in KINDS[kind].views:
        half = width // 2
        return {
            "contact": {"rows": rows, "columns": [half, width]},
            "topography": {"rows": rows, "columns": [0, half]},
        }
    return {name: {"rows": rows, "columns": [0, width]} for name in KINDS[kind].views}


def _is_needed(table: str) -> bool:
    """Whether a scene must have a table, which then stays, to say which of its keys is missing."""
    return table in SCENE and "process" in SCENE[table].needed_by


def _free(path: Path) -> Path:
    """The path itself, or with a number where there is such a file."""
    found, number = path, 2
    while found.exists():
        found, number = path.with_stem(f"{path.stem}-{number}"), number + 1
    return found


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FingerflowError(f"{path}: cannot be read ({error}); name a scene file, which is UTF-8 text") from None


def _parsed(text: str, path: Path) -> tomlkit.TOMLDocument:
    try:
        return tomlkit.parse(text)
    except tomlkit.exceptions.TOMLKitError as error:
        raise FingerflowError(f"{path}: is not valid TOML: {error}; correct it there") from None
