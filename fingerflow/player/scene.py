"""What a stream needs of a scene file."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .arrays import Array
from .bundle import Bundle
from .errors import PlayerError

# The keys of a scene file, as `fingerflow process` has them; the player reads a part, one file serves both.
SCENE_KEYS = {
    "recording": ("first_frame", "frame_rate", "frames", "last_frame", "trigger_frame"),
    "views": ("contact", "topography"),
    "background": ("dark", "frames"),
    "forces": ("file", "normal", "sample_rate", "tangential", "time", "trigger", "trigger_level"),
    "calibration": ("file", "mm_per_px", "topography_to_contact"),
    "contact": ("gross_radius_px", "median_px", "threshold"),
    "tracking": (
        *("direction", "forward_backward_limit_px", "gain_offset", "min_distance_px"),
        *("points", "search_px", "template", "window_px"),
    ),
    "fields": ("depth_mm", "gauge_length_mm", "poisson_ratio", "rate_window_s", "strain", "young_modulus_mpa"),
    "stream": ("output", "region", "rekey_frames", "rekey_share"),
    "slip": ("stuck_mm",),
}


class View(NamedTuple):
    """A rectangle of pixels, half-open ranges."""

    rows: tuple[int, int]
    columns: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows[1] - self.rows[0], self.columns[1] - self.columns[0]

    def crop(self, frame: Array) -> Array:
        return frame[self.rows[0] : self.rows[1], self.columns[0] : self.columns[1]]


@dataclass(frozen=True)
class Scene:
    """Where the views lie in a frame, their scale, and what empty glass looks like.

    Frames count from `first_frame` to `last_frame` of the recording. ``region`` is the part of the topography view in
    which points are chosen, None for all of it. ``asked`` has the settings that a recipe has decided already, by table
    and key.
    """

    contact: View
    topography: View
    mm_per_px: float
    topography_to_contact: Array
    threshold: float | None = None
    background: Path | None = None
    dark: Path | None = None
    frames: Path | None = None
    frame_rate: float | None = None
    first_frame: int = 0
    last_frame: int | None = None
    output: Path | None = None
    region: View | None = None
    rekey_share: float | None = None
    rekey_frames: int | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)


def load_scene(path: Path) -> Scene:
    """Reads what a stream needs of a scene file; raises PlayerError with file, key, value and remedy."""
    return _SceneFile(path).scene()


class _SceneFile:
    """One TOML file; every complaint names it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.values = self._read(path)
        self._refuse_unknown(self.values, ("kind", *SCENE_KEYS), "")
        for table, keys in SCENE_KEYS.items():
            self._refuse_unknown(self.values.get(table, {}), keys, f"{table}.")

    def scene(self) -> Scene:
        first, last = self._count("recording.first_frame", 0) or 0, self._count("recording.last_frame", 0)
        if last is not None and last < first:
            raise self._wrong(
                "recording.last_frame", last, f"both are included: first_frame, {first}, or more is needed"
            )
        scale, transform = self._calibration()
        return Scene(
            contact=self._view("views.contact"),
            topography=self._view("views.topography"),
            mm_per_px=scale,
            topography_to_contact=transform,
            threshold=self._threshold(),
            background=self._file("background.frames"),
            dark=self._file("background.dark"),
            frames=self._file("recording.frames"),
            frame_rate=self._number("recording.frame_rate", 0.0, 1e6),
            first_frame=first,
            last_frame=last,
            output=self._file("stream.output"),
            region=None if self._get("stream.region") is None else self._view("stream.region"),
            rekey_share=self._number("stream.rekey_share", 0.0, 1.0),
            rekey_frames=self._count("stream.rekey_frames"),
            asked={
                f"{table}.{key}": value
                for table in ("contact", "tracking", "fields")
                for key, value in self.values.get(table, {}).items()
            },
        )

    def _threshold(self) -> float | None:
        """None where it is to be measured, whether from the reference frame or from each."""
        value = self._get("contact.threshold")
        if value in (None, "reference_frame", "per_frame"):
            return None
        return self._number("contact.threshold", 0.0, 1.0)

    def _calibration(self) -> tuple[float, Array]:
        """mm_per_px and the affine (2, 3) of the scene, or of the calibration file that it names."""
        place, transform_key = self, "calibration.topography_to_contact"
        scale_key = "calibration.mm_per_px"
        if (path := self._file("calibration.file")) is not None:
            place = _SceneFile.__new__(_SceneFile)
            place.path, place.values = path, self._read(path)
            scale_key, transform_key = "mm_per_px", "topography_to_contact.affine.matrix"
        scale, rows = place._number(scale_key, 0.0, 1.0), place._get(transform_key)
        if scale is None:
            raise place._wrong(scale_key, None, "mm per px of the contact view is needed")
        try:
            matrix = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError):
            matrix = np.empty(0)
        if matrix.shape != (2, 3) or abs(np.linalg.det(matrix[:, :2])) < 1e-6:
            raise place._wrong(transform_key, rows, "an invertible [[a, b, x], [c, d, y]] is needed")
        return scale, matrix

    def _read(self, path: Path) -> dict[str, Any]:
        try:
            return tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise PlayerError(
                f"{path}: cannot be read as TOML ({error}); scene.toml of a bundle is an example"
            ) from None

    def _refuse_unknown(self, table: Any, known: tuple[str, ...], prefix: str) -> None:
        if not isinstance(table, dict):
            raise self._wrong(prefix[:-1], table, "it must be a table")
        for key in table:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {close[0]!r}? " if close else ""
                raise PlayerError(f"{self.path}: {prefix}{key} is not a key; {hint}known here: {', '.join(known)}")

    def _get(self, name: str) -> Any:
        found: Any = self.values
        for key in name.split("."):
            found = found.get(key) if isinstance(found, dict) else None
        return found

    def _wrong(self, name: str, value: Any, needed: str) -> PlayerError:
        return PlayerError(f"{self.path}: {name} {'is missing' if value is None else f'is {value!r}'}; {needed}")

    def _number(self, name: str, above: float, most: float) -> float | None:
        value = self._get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not above < value <= most:
            raise self._wrong(name, value, f"a number above {above:g} and up to {most:g} is needed")
        return float(value)

    def _count(self, name: str, least: int = 1) -> int | None:
        value = self._number(name, least - 1, 1e9)
        if value is not None and value != int(value):
            raise self._wrong(name, value, "a whole number is needed")
        return None if value is None else int(value)

    def _file(self, name: str) -> Path | None:
        value = self._get(name)
        if value is not None and not isinstance(value, str):
            raise self._wrong(name, value, "a path, relative to the scene file, is needed")
        return None if value is None else (self.path.parent / value).resolve()

    def _view(self, name: str) -> View:
        ranges = []
        for key in ("rows", "columns"):
            value = self._get(f"{name}.{key}")
            whole = isinstance(value, list) and len(value) == 2 and all(type(end) is int for end in value)
            if not whole or not 0 <= value[0] < value[1]:
                raise self._wrong(f"{name}.{key}", value, "[first, end] px with 0 <= first < end is needed")
            ranges.append((value[0], value[1]))
        return View(*ranges)


def check_scene(scene: Scene, bundle: Bundle) -> None:
    """Raises PlayerError where the views are not of the bundle's size, or the region leaves the view."""
    size = (bundle.height, bundle.width)
    for name, view in (("contact", scene.contact), ("topography", scene.topography)):
        if view.shape != size:
            raise PlayerError(
                f"views.{name} of the scene is {view.shape[0]} x {view.shape[1]} px, the bundle was exported for "
                f"{size[0]} x {size[1]}; correct rows and columns, or export one with views of that size"
            )
    if scene.region and (scene.region.rows[1] > size[0] or scene.region.columns[1] > size[1]):
        raise PlayerError(f"stream.region of the scene ends beyond the topography view of {size[0]} x {size[1]} px")


_PLAYED = {  # what a stream does, whatever a scene says, because later frames are not known or graphs are fixed
    "contact.threshold": "reference_frame",
    "tracking.direction": "forward",
    "tracking.search_px": 0,
    "tracking.template": "keyframe",
    "fields.strain": "green_lagrange",
}


def contradictions(scene: Scene, recipe: Mapping[str, Any]) -> list[str]:
    """One sentence for each setting of the scene that the recipe has decided otherwise."""
    decided = {f"{table}.{key}": value for table, keys in recipe.items() for key, value in keys.items()} | _PLAYED
    return [
        f"{name} of the scene is {value!r}; the bundle plays with {decided[name]!r}"
        for name, value in scene.asked.items()
        if name in decided and value != decided[name] and not (name == "contact.threshold" and scene.threshold)
    ]
