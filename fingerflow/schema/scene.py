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
    """Settings in the table [recording] of a scene file: file with the frames, frame rate, trigger frame, and range of
    frames to process.
    """

    frames: Path
    frame_rate: float | None
    trigger_frame: int | None
    first_frame: int
    last_frame: int | None


class Views(Mapping[str, View]):
    """Settings in the tables [views] of a scene file: rectangle of the camera frame that each view occupies, by name of
    the view.
    """

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
        """Return the names of all views in the scene."""
        return tuple(self._views)

    @property
    def contact(self) -> View:
        """Return the contact view, in which skin in contact appears as `contact.appears` says, dark or bright."""
        return self["contact"]

    @property
    def topography(self) -> View | None:
        """Return the topographic view, which shows the ridges of the skin; None if the scene has none."""
        return self.get("topography")


@dataclass(frozen=True)
class BackgroundSettings:
    """Settings in the table [background] of a scene file: recordings of the empty glass, and of the view without
    light.
    """

    frames: Path
    dark: Path | None


@dataclass(frozen=True)
class ForceSettings:
    """Settings in the table [forces] of a scene file: force file, columns of the normal and tangential force, and
    calibration of the force sensors.

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
    """Settings in the table [calibration] of a scene file: image scale and transform between the views, given directly
    or by a calibration file.

    ``topography_to_contact`` is used only if there is a topography view.
    """

    file: Path | None
    mm_per_px: float
    topography_to_contact: tuple[Row, Row]


@dataclass(frozen=True)
class NoiseFloor:
    """Noise floor of a rig: standard deviations of a displacement component, the divergence and a strain component,
    measured in frames without motion.

    They hold for the window and the gauge length with which they were measured.
    """

    displacement_mm: float
    divergence: float
    strain: float
    window_px: float
    gauge_length_mm: float


@dataclass(frozen=True)
class RigSettings:
    """Settings in the table [rig] of a scene file: hardware that a recording does not state, and the measured noise
    floor, for the report.
    """

    camera: str | None
    lens: str | None
    aperture: float | None
    stand_off_mm: float | None
    noise_floor: NoiseFloor | None


@dataclass(frozen=True)
class ContactSettings:
    """Settings in the table [contact] of a scene file: whether contact appears dark or bright, and the segmentation of
    the real and of the apparent (gross) contact area.
    """

    appears: Literal["dark", "bright"]
    median_px: int
    threshold: float | Literal["reference_frame", "per_frame"]
    gross_radius_px: int


@dataclass(frozen=True)
class TrackingSettings:
    """Settings in the table [tracking] of a scene file: how skin points are seeded and tracked."""

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
    """Settings in the table [fields] of a scene file: how skin deformation is computed, and elastic constants of the
    skin.

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
    """Settings in the table [slip] of a scene file: how stick and slip are distinguished in a trial of tangential
    loading.

    A scene with this table is of the kind "slip" unless it states another. ``stuck_mm`` is used by the criteria
    "displacement" and "relative". ``displacement`` is measured at tracked points or, by dense flow, everywhere.
    """

    criterion: Literal["border", "displacement", "relative"]
    stuck_mm: float
    displacement: Literal["points", "dense_flow"]


@dataclass(frozen=True)
class StreamSettings:
    """Settings in the table [stream] of a scene file: additional settings for running exported graphs (a bundle) on a
    live camera stream.

    ``region`` is the part of the topography view in which skin is expected to touch, as it lies in the first frame.
    Points are seeded in it, by `process` too, so that both seed the same points.
    """

    output: Path | None
    region: View | None
    update_share: float | None
    update_frames: int | None


@dataclass(frozen=True)
class Scene:
    """Complete settings of an experiment: the recording, and everything needed to process it.

    ``path`` is the scene file, ``kind`` one of `schema.scene_kinds.KINDS`.
    """

    path: Path
    kind: str
    recording: RecordingSettings
    views: Views
    background: BackgroundSettings
    calibration: CalibrationSettings
    rig: RigSettings
    forces: ForceSettings | None
    contact: ContactSettings
    tracking: TrackingSettings
    fields: FieldSettings
    slip: SlipSettings
    stream: StreamSettings

    def files(self) -> tuple[Path, ...]:
        """Return the paths of the scene file and of all files named in it, which no output may overwrite."""
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
    def dense_flow_slip(self) -> bool | None:
        """Return True if slip is to be measured by dense optical flow, else None, so that ``has("dense_flow_slip")`` is
        False.
        """
        return True if self.slip.displacement == "dense_flow" else None

    def has(self, need: str) -> bool:
        """Return whether the scene has a value for a key, given as a dotted path such as "forces.tangential"."""
        found: Any = self
        for key in need.split("."):
            found = found.get(key) if isinstance(found, Views) else getattr(found, key)
            if found is None:
                return False
        return True

    def as_json(self) -> str:
        """Return all settings of the scene, including defaults, as JSON text with tables and keys as in the file."""
        return json.dumps(_plain(self))


def load_scene(path: str | Path) -> Scene:
    """Read and validate a scene file, and return the settings in it.

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
    """Return the scene with the given tables and keys, `written`, which is one of several scenes in the file `path`.

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
    """Return the scene that a TOML text describes, which will be written to the file `path`; raise errors as
    :func:`load_scene`.
    """
    try:
        return _scene(path.resolve(), parse_scene(text, path.resolve(), "process"))
    except SceneError as error:
        raise FingerflowError(str(error)) from None


def scene_of_settings(settings: str) -> Scene:
    """Return the scene from which a result was computed, given the JSON text of the result's attribute `settings`.

    Raises:
        FingerflowError: a file that it names is missing, or a key is no longer valid; with the remedy.
    """
    said = json.loads(settings)
    path = Path(said.pop("path"))
    kind = said.setdefault("kind", default_kind(said))
    shown = (*KINDS[kind].views, *KINDS[kind].optional_views) if kind in KINDS else ()
    said["views"] = {name: view for name, view in said["views"].items() if name in shown}  # scene files hold no roles
    said["calibration"].pop("file", None)  # the other settings already hold the values of this file
    checked, problems = check_scene(_without_none(said), path.parent, "process")
    if problems:
        lines = [f"settings of the result: {'.'.join(one.keys)} {one.said}" for one in problems]
        raise FingerflowError("\n".join(lines))
    return _scene(path, checked)


def _without_none(value: Any) -> Any:
    """Remove all keys with the value None from settings, since the scene file did not have them."""
    if isinstance(value, dict):
        return {name: _without_none(one) for name, one in value.items() if one is not None}
    return value


def _scene(path: Path, checked: Checked) -> Scene:
    found = checked.values
    region, forces, floor = found["stream"]["region"], found["forces"], found["rig"]["noise_floor"]
    views = {name: _view(view) for name, view in found["views"].items() if view is not None}
    return Scene(
        path=path,
        kind=checked.kind,
        recording=RecordingSettings(**found["recording"]),
        views=Views(views),
        background=BackgroundSettings(**found["background"]),
        calibration=CalibrationSettings(**found["calibration"]),
        rig=RigSettings(**{**found["rig"], "noise_floor": None if floor is None else NoiseFloor(**floor)}),
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
    """Convert settings (data classes, mappings and paths) to JSON types."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return str(value) if isinstance(value, Path) else value
