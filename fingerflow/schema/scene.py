"""What was recorded and what is asked of it: one TOML file. Its keys and rules are those of `schema.scene_keys`."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_check import Checked, check_scene
from fingerflow.schema.scene_file import SceneError, parse_scene, read_scene
from fingerflow.schema.scene_kinds import KINDS, default_kind
from fingerflow.schema.toml_string import toml_string
from fingerflow.schema.views import DrawnEllipse, Region, View

Row = tuple[float, float, float]


@dataclass(frozen=True)
class RecordingSettings:
    """[recording]: the frames, and which of them count. Frames are numbered from 0 as they stand in the file."""

    frames: Path
    frame_rate: float | None
    trigger_frame: int | None
    first_frame: int
    last_frame: int | None


class Views(Mapping[str, View]):
    """[views]: where each view lies in the frame, by its name."""

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
        """Of the views that the scene has."""
        return tuple(self._views)

    @property
    def contact(self) -> View:
        """The view of light that contact takes away."""
        return self["contact"]

    @property
    def topography(self) -> View | None:
        """The view of the skin's ridges."""
        return self.get("topography")


@dataclass(frozen=True)
class BackgroundSettings:
    """[background]: frames without a finger, and without light. A soft sensor needs none."""

    frames: Path | None
    dark: Path | None


@dataclass(frozen=True)
class ForceSettings:
    """[forces]: channels by their names in the file or their numbers, from 1; ``tangential`` may be two components.

    ``units`` is that of all forces, None for that of each heading; ``gain``, ``sign`` and ``offset`` are one number for
    all or one each, normal first (`recordings.forces.newtons.Sensor`).
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
    """[calibration]: given here, or by the file that `fingerflow calibrate` wrote.

    ``topography_to_contact`` matters only where there is a topography view.
    """

    file: Path | None
    mm_per_px: float
    topography_to_contact: tuple[Row, Row]


@dataclass(frozen=True)
class ContactSettings:
    """[contact]: what counts as contact."""

    median_px: int
    threshold: float | Literal["reference_frame", "per_frame"]
    gross_radius_px: int


@dataclass(frozen=True)
class TrackingSettings:
    """[tracking]: how points are chosen and followed."""

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
    """[fields]: deformation of the skin, and its elasticity.

    ``reference`` is what displacement counts from: "onset", "first_frame", a frame, or a time from the trigger, such
    as "0.25 s".
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
    """[slip]: of a trial of tangential loading. A scene that has it is of the kind "slip", unless it states another.

    ``stuck_mm`` is of the criteria "displacement" and "relative"; ``displacement`` is that of tracked points, or of all
    skin by dense flow.
    """

    criterion: Literal["border", "displacement", "relative"]
    stuck_mm: float
    displacement: Literal["points", "dense_flow"]


@dataclass(frozen=True)
class StreamSettings:
    """[stream]: what the player of an exported bundle reads beside the rest.

    ``region`` is the part of the topography view in which skin is expected to touch, as it lies in the first frame.
    Points are chosen there, by `process` too: so they are the same.
    """

    output: Path | None
    region: View | None
    rekey_share: float | None
    rekey_frames: int | None


@dataclass(frozen=True)
class Scene:
    """A recording and everything needed to process it.

    ``path`` is the file that says so, ``kind`` one of `schema.scene_kinds.KINDS`.
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
        """Everything that it is made of, itself first: what no result may replace."""
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
        """True where markers on a gel are followed, None else: what stages need of it, `has` tells."""
        return True if self.kind == "soft_sensor" else None

    @property
    def dense_flow_slip(self) -> bool | None:
        """True where slip is looked for by dense flow, None else: as `soft_sensor`."""
        return True if self.slip.displacement == "dense_flow" else None

    def has(self, need: str) -> bool:
        """Whether the scene gives what a dotted key of its file names: "views.topography", "forces.tangential"."""
        found: Any = self
        for key in need.split("."):
            found = found.get(key) if isinstance(found, Views) else getattr(found, key)
            if found is None:
                return False
        return True

    def as_json(self) -> str:
        """Every setting, as it counts, by table and key."""
        return json.dumps(_plain(self))


def load_scene(path: str | Path) -> Scene:
    """Reads a scene file.

    Raises:
        FingerflowError: the file is missing or is no TOML, a key is unknown, a value has the wrong type or range, keys
            do not go together, a file that it names is missing; with the line and the remedy.
    """
    path = Path(path).resolve()
    try:
        return _scene(path, read_scene(path, "process"))
    except SceneError as error:
        raise FingerflowError(str(error)) from None


def scene_from(written: Mapping[str, Any], path: Path, place: str) -> Scene:
    """A scene from the tables and keys of a file of several scenes.

    Args:
        written: as TOML gives it.
        path: of that file; paths are relative to its folder.
        place: where it says so, for errors.

    Raises:
        FingerflowError: as `load_scene`.
    """
    checked, problems = check_scene(written, path.parent, "process")
    if problems:
        raise FingerflowError("\n".join(f"{place}: {'.'.join(one.keys)} {one.said}" for one in problems))
    return _scene(path, checked)


def scene_of_text(text: str, path: Path) -> Scene:
    """What :func:`load_scene` will give of a file of this content, before it is written; it raises the same."""
    try:
        return _scene(path.resolve(), parse_scene(text, path.resolve(), "process"))
    except SceneError as error:
        raise FingerflowError(str(error)) from None


def scene_of_settings(settings: str) -> Scene:
    """The scene that a result was computed from, by what :meth:`Scene.as_json` has left in its attribute `settings`.

    Raises:
        FingerflowError: a file that it names has gone, or a key is no longer what it was; with the remedy.
    """
    said = json.loads(settings)
    path = Path(said.pop("path"))
    kind = said.setdefault("kind", default_kind(said))
    shown = (*KINDS[kind].views, *KINDS[kind].optional_views) if kind in KINDS else ()
    said["views"] = {name: view for name, view in said["views"].items() if name in shown}  # roles are not written
    said["calibration"].pop("file", None)  # its values stand beside it
    checked, problems = check_scene(_without_none(said), path.parent, "process")
    if problems:
        lines = [f"settings of the result: {'.'.join(one.keys)} {one.said}" for one in problems]
        raise FingerflowError("\n".join(lines))
    return _scene(path, checked)


def _without_none(value: Any) -> Any:
    """Settings that are None are those that were left out."""
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
    """What JSON can say."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return str(value) if isinstance(value, Path) else value


_TOPOGRAPHY, _CONTACT = View((0, 512), (0, 640)), View((0, 512), (640, 1280))


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
    """A commented scene file; the defaults are those of the two-view rig of Willemet et al. 2021.

    ``calibration`` is the content of the table [calibration], in TOML; ``region`` the part of the topography view where
    points are chosen; with ``slip`` the scene is a trial of tangential loading.
    """
    rate = f"frame_rate = {frame_rate}" if frame_rate else "# frame_rate = 300.0"
    trigger = "# trigger_frame = 12" if trigger_frame is None else f"trigger_frame = {trigger_frame}"
    dark_line = f"dark = {toml_string(dark)}" if dark else '# dark = "dark.cine"'
    mark = "" if forces else "# "
    live = "" if region else "# "
    loaded = "" if slip else "# "
    where = region or View((100, 400), (100, 540))
    return f"""# A scene of fingerflow: what was recorded and what is asked of it. Paths are relative to this file.
# kind = "press"              # or "slip", which is what a scene with a table [slip] is; or "single_view"

[recording]
frames = {toml_string(frames)}          # .cine, .mraw/.cih, TIFF, AVI/MP4, HDF5, .npy or a folder of images
{rate}          # Hz, only where the recording does not state it
{trigger}          # the frame at time 0, only where the recording does not state it
# first_frame = 0             # the frames that count, both included
# last_frame = 299

[views.contact]               # where the view lies in a frame: [first, last + 1) px
rows = {list(contact.rows)}
columns = {list(contact.columns)}
# region = {{ellipse = {{center = [320, 256], semi_axes = [200, 150]}}}}   # px of the view: elsewhere nothing touches;
                              # or {{polygon = [[x, y], ...]}}, or {{mask = "mask.png"}}, where it is not black

[views.topography]            # leave out where there is no such view: areas only
rows = {list(topography.rows)}
columns = {list(topography.columns)}
# region = {{polygon = [[120, 100], [520, 100], [320, 420]]}}   # points are chosen there, else where skin touches

[background]
frames = {toml_string(background)}       # without a finger; several frames are averaged
{dark_line}            # without light

{mark}[forces]
{mark}file = {toml_string(forces or "forces.csv")}           # CSV, HDF5, .mat or TDMS
{mark}normal = "normal_force"       # names of the channels in the file, or their numbers, from 1
{mark}tangential = "tangential_force"  # or two components, ["fx", "fy"]
# units = "N"                 # or "mN", "g", "kgf", "V"; only where the file does not state it
# gain = 1.0                  # of the sensor: N/V where units = "V"; or one a channel, normal first, [2.5, 1.2]
# sign = 1                    # or -1, where pressing is negative; or one a channel, [-1, 1]
# offset = 0.0                # reading without a load, in the file's unit; or
# tare = [-0.5, -0.1]         # s from the trigger, in which nothing touches: the mean there is the zero
{mark}trigger = "trigger"           # its first rise through trigger_level is time 0
{mark}trigger_level = 2.5

[calibration]
{calibration}

[contact]
median_px = 3                 # side of the median; the paper has 9, which rounds the ends of ridges
threshold = "reference_frame" # Otsu's in the frame of largest force; or "per_frame", or a relative intensity loss, 0.25
gross_radius_px = 8           # half the distance between ridges, or a little more

[tracking]
points = 700
window_px = 25
min_distance_px = 6.0
points_from = "recorded"      # picture in which they are chosen; "enhanced": background off, stretched, sharpened
direction = "forward"         # or "backward", from the last frame
template = "keyframe"         # or "previous": from frame to frame, errors add up
forward_backward_limit_px = 1.0
search_px = 8                 # how far to search for points that a jolt has carried away; 0 for not at all
gain_offset = true            # windows are compared whatever the light's gain and offset

[fields]
reference = "onset"           # displacement since each point's own onset of contact; or, for all points, since
                              # "first_frame", since a frame as it stands in the file, 120, or a time, "0.25 s"
gauge_length_mm = 1.6         # diameter over which a gradient is fitted
strain = "green_lagrange"     # or "as_printed" (Willemet et al. 2021, eq. 1), "infinitesimal"
young_modulus_mpa = 1.0
poisson_ratio = 0.4
depth_mm = 2.0                # of skin that the strain energy is integrated over
rate_window_s = 0.05

{loaded}[slip]                        # of a trial of tangential loading
{loaded}criterion = "border"          # of stuck skin: no slip at all; or "displacement" below stuck_mm, as in the
{loaded}                              # paper; or "relative": below it against the rigid motion of the skin that sticks
{loaded}# stuck_mm = 0.04             # the paper has 0.04
{loaded}displacement = "points"       # or "dense_flow": of all skin, compared with the points

{live}[stream]                      # of an exported bundle in its player; `process` takes the region too
{live}region = {{rows = {list(where.rows)}, columns = {list(where.columns)}}}  # of the topography view, for points
"""


def gel_scene_text(frames: str, frame_shape: tuple[int, int], mm_per_px: float) -> str:
    """A scene file of a soft sensor with printed markers, whose recording has frames of this shape."""
    height, width = frame_shape
    return f"""# A scene of fingerflow: markers on a soft sensor. Paths are relative to this file.
kind = "soft_sensor"          # its own frames tell how the gel looks at rest: no [background] is needed

[recording]
frames = {toml_string(frames)}          # AVI/MP4/MKV, TIFF, HDF5, .npy or a folder of images

[views.camera]                # where the gel lies in a frame: [first, last + 1) px
rows = [0, {height}]
columns = [0, {width}]

[calibration]
mm_per_px = {mm_per_px:g}              # on the gel

[slip]
stuck_mm = 0.04               # a marker that departs by less from the rigid motion of the contact sticks
"""
