"""Experiment settings: the content of a scene file (TOML). Keys and rules are those of `schema.scene_keys`."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_check import Checked, check_scene
from fingerflow.schema.scene_file import SceneError, parse_scene, read_scene
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.views import DrawnEllipse, Region, View

Row = tuple[float, float, float]


@dataclass(frozen=True)
class RecordingSettings:
    """Settings [recording]: file of frames, frame rate, trigger frame, and range of frames used, numbered from 0."""

    frames: Path
    frame_rate: float | None
    trigger_frame: int | None
    first_frame: int
    last_frame: int | None


class Views(Mapping[str, View]):
    """Settings [views]: the rectangle of each view in the frame, by name."""

    def __init__(self, views: Mapping[str, View]) -> None:
        self._views = dict(views)

    def __getitem__(self, name: str) -> View:
        if name not in self._views:
            raise KeyError(f"the scene has no view {name!r}; it has {', '.join(self._views)}")
        return self._views[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    def names(self) -> tuple[str, ...]:
        """Return the names of the views that the scene has."""
        return tuple(self._views)

    @property
    def contact(self) -> View:
        """Return the view in which skin in contact with the glass appears dark."""
        return self["contact"]

    @property
    def topography(self) -> View | None:
        """Return the view of the skin's ridges; None if the scene has none."""
        return self.get("topography")


@dataclass(frozen=True)
class BackgroundSettings:
    """Settings [background]: recordings without a finger, and without light. A soft sensor needs neither."""

    frames: Path | None
    dark: Path | None


@dataclass(frozen=True)
class ForceSettings:
    """Settings [forces]: columns of the force file by name or by number from 1; ``tangential`` may have two components.

    ``units`` is the unit of all forces, None for the unit in each heading. ``gain``, ``sign`` and ``offset`` are one
    number for all or one each, normal first (`recordings.forces.newtons.Sensor`).
    """

    file: Path
    normal: str | int
    tangential: str | int | tuple[str | int, ...] | None
    units: Literal["N", "mN", "g", "kgf", "V"] | None
    gain: float | tuple[float, ...] | None
    sign: float | tuple[float, ...]
    offset: float | tuple[float, ...] | None
    tare: tuple[float, float] | None
    trigger: str | int | None
    trigger_level: float | None
    time: str | int | None
    sample_rate: float | None


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings [calibration]: image scale and transform, from the scene file or the file that `fingerflow calibrate`
    wrote.

    ``topography_to_contact`` is used only if there is a topography view.
    """

    file: Path | None
    mm_per_px: float
    topography_to_contact: tuple[Row, Row]


@dataclass(frozen=True)
class ContactSettings:
    """Settings [contact]: segmentation of the real and the gross contact."""

    median_px: int
    threshold: float | Literal["reference_frame", "per_frame"]
    gross_radius_px: int


@dataclass(frozen=True)
class TrackingSettings:
    """Settings [tracking]: how points are seeded and tracked."""

    points: int
    window_px: int
    min_distance_px: float
    points_from: Literal["recorded", "enhanced"]
    direction: Literal["forward", "backward"]
    template: Literal["keyframe", "previous"]
    forward_backward_limit_px: float
    search_px: int
    gain_offset: bool


@dataclass(frozen=True)
class FieldSettings:
    """Settings [fields]: how deformation of the skin is computed, and the elastic constants of the skin.

    ``reference`` is the instant from which displacement is measured: "onset", "first_frame", a frame number, or a time
    from the trigger, such as "0.25 s".
    """

    reference: str | int
    gauge_length_mm: float
    strain: Literal["green_lagrange", "as_printed", "infinitesimal"]
    young_modulus_mpa: float
    poisson_ratio: float
    depth_mm: float
    rate_window_s: float


@dataclass(frozen=True)
class SlipSettings:
    """Settings [slip] of a trial of tangential loading.

    A scene with this table is of the kind "slip" unless it states another. ``stuck_mm`` is used by the criteria
    "displacement" and "relative". ``displacement`` is measured at tracked points or, by dense flow, everywhere.
    """

    criterion: Literal["border", "displacement", "relative"]
    stuck_mm: float
    displacement: Literal["points", "dense_flow"]


@dataclass(frozen=True)
class StreamSettings:
    """Settings [stream]: additional settings for the player of an exported bundle.

    ``region`` is the part of the topography view in which skin is expected to touch, as it lies in the first frame.
    Points are seeded in it, by `process` too, so that both seed the same points.
    """

    output: Path | None
    region: View | None
    update_share: float | None
    update_frames: int | None


@dataclass(frozen=True)
class Scene:
    """Experiment settings: a recording, and everything that is needed to process it.

    ``path`` is the scene file, ``kind`` one of `schema.scene_kinds.KINDS`.
    """

    path: Path
    kind: str
    recording: RecordingSettings
    views: Views
    background: BackgroundSettings
    calibration: CalibrationSettings
    forces: ForceSettings | None
    contact: ContactSettings
    tracking: TrackingSettings
    fields: FieldSettings
    slip: SlipSettings
    stream: StreamSettings

    def files(self) -> tuple[Path, ...]:
        """Return the scene file and all files that it names; no result may overwrite them."""
        forces = None if self.forces is None else self.forces.file
        masks = (None if view.region is None else view.region.mask for view in self.views.values())
        named = (
            self.recording.frames,
            self.background.frames,
            self.background.dark,
            self.calibration.file,
            forces,
            *masks,
        )
        return (self.path, *(file for file in named if file is not None))

    @property
    def soft_sensor(self) -> bool | None:
        """Return True if markers on a gel are tracked, else None, which `Scene.has` treats as a key without a value."""
        return True if self.kind == "soft_sensor" else None

    @property
    def dense_flow_slip(self) -> bool | None:
        """Return True if dense flow measures slip, else None, which `Scene.has` treats as a key without a value."""
        return True if self.slip.displacement == "dense_flow" else None

    def has(self, need: str) -> bool:
        """Return whether a key of the scene file, given as a dotted path such as "forces.tangential", has a value."""
        found: Any = self
        for key in need.split("."):
            found = found.get(key) if isinstance(found, Views) else getattr(found, key)
            if found is None:
                return False
        return True

    def as_json(self) -> str:
        """Return all settings, including defaults, by table and key as JSON text."""
        return json.dumps(_plain(self))


def load_scene(path: str | Path) -> Scene:
    """Read a scene file, check it, and return its experiment settings.

    Raises:
        FingerflowError: the file is missing or is not valid TOML, a key is unknown, a value has the wrong type or
            range, keys contradict each other, or a file that it names is missing; with the line and the remedy.
    """
    path = Path(path).resolve()
    try:
        return _scene(path, read_scene(path, "process"))
    except SceneError as error:
        raise FingerflowError(str(error)) from None


def scene_from(written: Mapping[str, Any], path: Path, place: str) -> Scene:
    """Return one scene from its tables and keys in a file that holds several scenes.

    Args:
        written: tables and keys as parsed from TOML.
        path: that file; paths are relative to its folder.
        place: location of the scene in the file, for error messages.

    Raises:
        FingerflowError: as `load_scene`.
    """
    checked, problems = check_scene(written, path.parent, "process")
    if problems:
        raise FingerflowError("\n".join(f"{place}: {'.'.join(one.keys)} {one.said}" for one in problems))
    return _scene(path, checked)


def scene_of_text(text: str, path: Path) -> Scene:
    """Return the scene that a text describes before it is written to the file `path`; raise as :func:`load_scene`."""
    try:
        return _scene(path.resolve(), parse_scene(text, path.resolve(), "process"))
    except SceneError as error:
        raise FingerflowError(str(error)) from None


def scene_of_settings(settings: str) -> Scene:
    """Return the scene of a result, rebuilt from the result's attribute `settings`, a text of :meth:`Scene.as_json`.

    Raises:
        FingerflowError: a file that it names is missing, or a key is no longer valid; with the remedy.
    """
    said = json.loads(settings)
    path = Path(said.pop("path"))
    kind = said.setdefault("kind", default_kind(said))
    shown = (*KINDS[kind].views, *KINDS[kind].optional_views) if kind in KINDS else ()
    said["views"] = {name: view for name, view in said["views"].items() if name in shown}  # files omit roles
    said["calibration"].pop("file", None)  # the settings hold its values as well
    checked, problems = check_scene(_without_none(said), path.parent, "process")
    if problems:
        lines = [f"settings of the result: {'.'.join(one.keys)} {one.said}" for one in problems]
        raise FingerflowError("\n".join(lines))
    return _scene(path, checked)


def _without_none(value: Any) -> Any:
    """Return settings without the keys whose value is None, which were left out in the scene file."""
    if isinstance(value, dict):
        return {name: _without_none(one) for name, one in value.items() if one is not None}
    return value


def _scene(path: Path, checked: Checked) -> Scene:
    found = checked.values
    region, forces = found["stream"]["region"], found["forces"]
    views = {name: _view(view) for name, view in found["views"].items() if view is not None}
    return Scene(
        path=path,
        kind=checked.kind,
        recording=RecordingSettings(**found["recording"]),
        views=Views(views),
        background=BackgroundSettings(**found["background"]),
        calibration=CalibrationSettings(**found["calibration"]),
        forces=None if forces is None else ForceSettings(**forces),
        contact=ContactSettings(**found["contact"]),
        tracking=TrackingSettings(**found["tracking"]),
        fields=FieldSettings(**found["fields"]),
        slip=SlipSettings(**found["slip"]),
        stream=StreamSettings(**{**found["stream"], "region": None if region is None else View(**region)}),
    )


def _view(found: Mapping[str, Any]) -> View:
    region = found.get("region")
    if region is None:
        return View(found["rows"], found["columns"])
    ellipse = None if region["ellipse"] is None else DrawnEllipse(**region["ellipse"])
    return View(found["rows"], found["columns"], Region(region["polygon"], ellipse, region["mask"]))


def _plain(value: Any) -> Any:
    """Convert settings to types that JSON can represent."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return str(value) if isinstance(value, Path) else value
