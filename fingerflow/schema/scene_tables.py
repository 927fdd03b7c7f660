"""Tables and keys of scene files: each key is a field of the class of its table, with type, range, default, unit and
meaning.

A scene has two readers: `process` reads a recording, the player a `stream`. Where their needs differ, the key states
it. The recipe of a bundle and the engines take the classes from which those of the tables inherit.
"""

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from fingerflow.schema.key_types import (
    BOTH,
    NOBODY,
    PROCESS,
    STREAM,
    TIME_RANGE,
    TRANSFORM,
    File,
    column,
    each,
    moment,
    number,
    row,
)
from fingerflow.schema.keys import SceneKey, SceneTable, key, keys_of, table
from fingerflow.schema.scene_kinds import Kind
from fingerflow.schema.variables import RIDGE_MM
from fingerflow.schema.views import Rectangle, View

Row = tuple[float, float, float]
POSITIVE, FROM_0, FROM_1 = number(above=0), number(least=0), number(least=1)
RECORDED = File(there_for=PROCESS)  # a scene may be taken to a lab PC without its recording


# fmt: off
@dataclass(frozen=True)
class RecordingSettings:
    """Settings in the table [recording] of a scene file: file with the frames, frame rate, trigger frame, and range of
    frames to process.
    """

    frames: Path = key("recording: .cine, .mraw/.cih, TIFF, AVI/MP4/MKV, HDF5, .npy or a folder of images",
        type=RECORDED, needed_by=PROCESS, sample="frames.cine", label="recording")
    frame_rate: float | None = key("only where the recording does not state it", type=number(above=1e-6),
        unit="Hz", sample=300.0)
    trigger_frame: int | None = key("frame at time 0, only where the recording does not state it", type=FROM_0,
        sample=12)
    first_frame: int = key("first frame that counts", 0, FROM_0)
    last_frame: int | None = key("last frame that counts", type=FROM_0, sample=299)


@dataclass(frozen=True)
class BackgroundSettings:
    """Settings in the table [background] of a scene file: recordings of the empty glass, and of the view without
    light. A stream may do without: ``frames`` is None then.
    """

    frames: Path = key("of the empty glass; several frames are averaged", type=RECORDED, needed_by=BOTH,
        sample="empty.cine", label="recording of the empty glass")
    dark: Path | None = key("without light", type=RECORDED, sample="dark.cine", label="recording without light")


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings in the table [calibration] of a scene file: image scale and transform between the views, given directly
    or by a calibration file.

    ``topography_to_contact`` is used only if there is a topography view. With ``intrinsics``, scale and transform are
    those of pixels without distortion and of equal sides.
    """

    file: Path | None = key("from `fingerflow calibrate`; in place of the other keys", type=File(calibration=True),
        sample="calibration.toml")
    mm_per_px: float = key("of the contact view", type=number(least=1e-6, most=1), unit="mm/px", sample=0.02,
        label="scale")
    topography_to_contact: tuple[Row, Row] = key("affine map of px, topography view to contact view",
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), TRANSFORM, label="map from topography to contact view")
    intrinsics: tuple[float, float, float, float] | None = key("focal lengths and principal point of the camera frame, "
        "as OpenCV's camera matrix has them: fx and fy differ where pixels are not square", type=row(fx=POSITIVE,
        fy=POSITIVE, cx=number(), cy=number()), unit="px", sample=[2000.0, 2000.0, 639.5, 255.5], label="lens")
    distortion: tuple[float, float, float, float, float] | None = key("of the lens, by OpenCV's model, with "
        "intrinsics", type=row(k1=number(), k2=number(), p1=number(), p2=number(), k3=number()),
        sample=[-0.1, 0.0, 0.0, 0.0, 0.0], label="distortion of the lens")


@dataclass(frozen=True)
class ForceSettings:
    """Settings in the table [forces] of a scene file: force file, columns of the normal and tangential force, and
    calibration of the force sensors.

    ``units`` is the unit of all forces, None for the unit in each heading. ``gain``, ``sign`` and ``offset`` are one
    number for all or one each, normal first (`recordings.forces.newtons`).
    """

    file: Path = key("CSV, HDF5, .mat or TDMS", type=RECORDED, needed_by=BOTH, sample="forces.csv")
    normal: str | int = key("channel of the normal force: its name in the file, or its number from 1", type=column(),
        needed_by=BOTH, sample="normal_force", label="normal force column")
    tangential: str | int | tuple[str | int, ...] | None = key('channel of the tangential force, or two, ["fx", "fy"]',
        type=column(2), sample="tangential_force", label="tangential force columns")
    units: Literal["N", "mN", "g", "kgf", "V"] | None = key("of the forces, only where the file does not state it",
        sample="N", label="unit of the file")
    gain: float | tuple[float, ...] | None = key("of the sensor, N/V where units is V; or one a channel, normal first",
        type=each(), sample=1.0, label="gain of the sensor")
    sign: float | tuple[float, ...] = key("-1 where pressing is negative; or one a channel, [-1, 1]", 1.0,
        each(1, -1), sample=1, label="sign of each column")
    offset: float | tuple[float, ...] | None = key("reading without a load, in the unit of the file", type=each(),
        sample=0.0, label="reading without load")
    tare: tuple[float, float] | None = key("time without contact, from the trigger: its mean is the zero; in place of "
        "offset", type=TIME_RANGE, unit="s", sample=[-0.5, -0.1], label="time without load")
    trigger: str | int | None = key("channel whose first rise through trigger_level is time 0", type=column(),
        sample="trigger", label="trigger column")
    trigger_level: float | None = key("in the unit of that channel", sample=2.5)
    position: str | int | None = key("channel of the position of the actuator that pulls, a length in m, mm or µm",
        type=column(), sample="position", label="actuator position column")
    time: str | int | None = key("column of the time, only where the file does not name it so", type=column(),
        sample="time", label="time column")
    sample_rate: float | None = key("only where the file has no time", type=POSITIVE, unit="Hz", sample=1000.0)


@dataclass(frozen=True)
class ContactSizes:
    """Settings [contact] that scenes, recipes and engines share: sizes in px for the segmentation of contact."""

    median_px: int = key("side of the median filter, narrower than a ridge, 1 for none; the paper has 9, which rounds "
        "the ends of ridges", 3, number(least=1, most=15, odd=True), label="median filter")
    gross_radius_px: int = key("half the distance between ridges, or a little more", 8, number(least=1, most=255),
        label="half ridge spacing")

    def rounded_share(self, mm_per_px: float) -> float:
        """Return the share of the real contact area that a median wider than the default may take: 2 to 13 % of ridges
        that lie 0.45 mm apart with 9 px of 0.03 mm.
        """
        return (max(self.median_px - ContactSizes.median_px, 0) * mm_per_px) ** 2 / RIDGE_MM


@dataclass(frozen=True)
class ContactCells(ContactSizes):
    """Settings [contact] that recipes and engines share, and a scene does not have."""

    stride_px: int = key("one line in so many counts for the threshold", 1, number(least=1, most=16))
    cell_px: Literal[4, 8] | None = key("side of the cells of the gross contact region")
    real_contact_mask: bool = key("whether the graph `contact` outputs the mask of the real contact", True)


@dataclass(frozen=True)
class ContactSettings(ContactSizes):
    """Settings in the table [contact] of a scene file: whether contact appears dark or bright, and the segmentation of
    the real and of the apparent (gross) contact area.
    """

    appears: Literal["dark", "bright"] = key("as skin in contact does beside the empty glass; bright where light "
        "leaves the glass through skin alone (frustrated total internal reflection). Areas are then those of the "
        "picture's negative, in which background.dark has no part", "dark", label="dark or bright")
    threshold: float | Literal["reference_frame", "per_frame"] = key("relative intensity loss that is contact; the "
        "words: Otsu's at the largest force, or of each frame", "reference_frame", number(above=0, below=1))


@dataclass(frozen=True)
class PointSettings:
    """Settings [tracking] that scenes, recipes and engines share: number and spacing of tracked points, sizes of
    windows and of the search, and limit of error.
    """

    points: int = key("most points that are tracked", 700, number(least=3), label="number of points")
    window_px: int = key("side of the window that is compared", 25, number(least=5, most=255, odd=True),
        label="side of windows")
    min_distance_px: float = key("least distance between two points", 6.0, number(above=0, most=1000),
        label="distance between points")
    forward_backward_limit_px: float = key("largest distance after tracking forward and back", 1.0, POSITIVE,
        label="limit of forward-backward error")
    search_px: int = key("reach of the search for points that a jolt has carried away; 0 for none", 8,
        number(least=0, most=255), label="search for lost points")
    gain_offset: bool = key("whether windows are compared up to gain and offset of the light", True,
        label="allow for changes of light")


@dataclass(frozen=True)
class TrackingSettings(PointSettings):
    """Settings in the table [tracking] of a scene file: how skin points are seeded and tracked."""

    points_from: Literal["recorded", "enhanced"] = key("picture in which points are seeded; enhanced: without "
        "background, stretched, sharpened", "recorded", label="picture for seeding")
    direction: Literal["forward", "backward"] = key("of tracking; backward from the last frame", "forward",
        label="direction of tracking")
    template: Literal["keyframe", "previous"] = key("frame that a window is compared with; errors add up with the "
        "previous one", "keyframe", label="windows compared with")


@dataclass(frozen=True)
class GaugeSettings:
    """Setting [fields] that scenes, recipes and engines share: gauge length in mm over which deformation is
    measured.
    """

    gauge_length_mm: float = key("diameter over which a gradient is fitted (virtual strain gauge)", 1.6,
        number(least=0.001, most=100))


@dataclass(frozen=True)
class FieldSettings(GaugeSettings):
    """Settings in the table [fields] of a scene file: how skin deformation is computed, and elastic constants of the
    skin.

    ``reference`` is the instant from which displacement is measured: "onset", "dilated_onset", "first_frame", a frame
    number, or a time from the trigger, such as "0.25 s".
    """

    reference: str | int = key('a frame of the file (120), or a time ("0.25 s"): moment from which displacement '
        "counts; onset is that of each point, dilated_onset that in the contact with a rim of contact.gross_radius_px, "
        "as in the script of Willemet et al. 2021", "onset", moment(("onset", "dilated_onset", "first_frame")),
        label="displacement counts from")
    strain: Literal["green_lagrange", "as_printed", "infinitesimal"] = key("measure of strain; as_printed: Willemet et "
        "al. 2021, equation 1", "green_lagrange", label="measure of strain")
    young_modulus_mpa: float = key("of the skin", 1.0, number(above=0, most=1e6), label="Young's modulus")
    poisson_ratio: float = key("of the skin", 0.4, number(above=-1, below=0.5), label="Poisson's ratio")
    depth_mm: float = key("of skin over which strain energy is integrated", 2.0, number(above=0, most=1000),
        label="depth for strain energy")
    rate_window_s: float = key("over which rates are fitted", 0.05, POSITIVE, label="time window of rates")


SETTINGS_FORMAT = 1  # of settings in results, increased whenever older versions cannot read them; absent is 0
STEP = 3  # px, spacing of the samples of a window (`Engine.windows`): 81 in a window of 25 px


@dataclass(frozen=True)
class EngineSettings(ContactCells, PointSettings, GaugeSettings):
    """Settings of an engine: those of a scene file that a recipe of a bundle may state too, by the same names, the
    cells of the contact, and the strain measure.
    """

    strain: str = FieldSettings.strain


@dataclass(frozen=True)
class SlipSettings:
    """Settings in the table [slip] of a scene file: how stick and slip are distinguished in a trial of tangential
    loading. A scene with this table is of the kind "slip" unless it states another.
    """

    criterion: Literal["border", "displacement", "relative"] = key("of stick: no slip at all; displacement below "
        "stuck_mm, as in the paper; or that relative to the rigid motion of the skin that sticks", "border",
        label="criterion of stick")
    stuck_mm: float = key("limit of the criteria displacement and relative, and of printed_stuck_ratio; the paper has "
        "0.04", 0.04, POSITIVE, label="limit of stick")
    displacement: Literal["points", "dense_flow"] = key("of tracked points, or of all skin by dense flow, compared "
        "with the points", "points", label="displacement from")


@dataclass(frozen=True)
class StreamSettings:
    """Settings in the table [stream] of a scene file: additional settings for running exported graphs (a bundle) on a
    live camera stream.

    ``region`` lies as it does in the first frame. Points are seeded in it, by `process` too, so that both seed the same
    points.
    """

    output: Path | None = key("folder of the results", type=File(there_for=NOBODY), sample="live")
    region: Rectangle | None = table("part of the topography view in which points are seeded, by `process` too",
        sample={"rows": [100, 400], "columns": [100, 540]}, default=None)
    update_share: float | None = key("least share of tracked points before templates are updated",
        type=number(above=0, most=1), sample=0.8)
    update_frames: int | None = key("most frames before templates are updated", type=FROM_1, sample=300)


@dataclass(frozen=True)
class NoiseFloor:
    """Noise floor of a rig: standard deviations of a displacement component, the divergence and a strain component,
    measured in frames without motion, with the window and the gauge length for which they hold.
    """

    displacement_mm: float = key("of a component of the displacement of a point", type=FROM_0, needed_by=BOTH)
    divergence: float = key("of the divergence at a point", type=FROM_0, needed_by=BOTH)
    strain: float = key("of a component of the strain of a triangle", type=FROM_0, needed_by=BOTH)
    window_px: float = key("tracking.window_px with which it was measured", type=POSITIVE, needed_by=BOTH)
    gauge_length_mm: float = key("fields.gauge_length_mm with which it was measured", type=POSITIVE, needed_by=BOTH)


@dataclass(frozen=True)
class RigSettings:
    """Settings in the table [rig] of a scene file: hardware that a recording does not state, and the measured noise
    floor, for the report.
    """

    participant: str | None = key("pseudonym of the person whose finger it is, the subject of NWB files", sample="P01")
    camera: str | None = key("maker and model", sample="maker, model")
    lens: str | None = key("maker, focal length or magnification", sample="maker, 100 mm macro")
    aperture: float | None = key("f-number that the lens was set to", type=POSITIVE, sample=8.0)
    stand_off_mm: float | None = key("from the glass to the front of the lens", type=POSITIVE, sample=300.0,
        label="stand-off")
    noise_floor: NoiseFloor | None = table("standard deviations in still frames, as `fingerflow noise-floor` prints "
        "them", sample={"displacement_mm": 0.0005, "divergence": 0.001, "strain": 0.001, "window_px":
            PointSettings.window_px, "gauge_length_mm": GaugeSettings.gauge_length_mm}, default=None)


class Views(dict[str, View]):
    """Settings in the tables [views] of a scene file: rectangle of the camera frame that each view occupies, by name of
    the view.
    """

    def __missing__(self, name: str) -> View:
        raise KeyError(f"the scene has no view {name!r}; it has {', '.join(self)}")

    @property
    def contact(self) -> View:
        """Return the contact view, in which skin in contact appears as `contact.appears` says, dark or bright."""
        return self["contact"]

    @property
    def topography(self) -> View | None:
        """Return the topographic view, which shows the ridges of the skin; None if the scene has none."""
        return self.get("topography")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Complete settings of an experiment: the recording, and everything needed to process it.

    ``path`` is the scene file, ``kind`` one of `schema.scene_kinds.KINDS`, ``profile`` the name of its set of keys in
    `schema.profiles.PROFILES`, ``given`` the dotted keys that the file, or
    the calibration file that it names, sets.
    """

    path: Path
    kind: str
    profile: str | None = None
    recording: RecordingSettings = table("frames of the trial, numbered from 0 as in the file", PROCESS)
    views: Views
    background: BackgroundSettings = table("pictures without a finger", PROCESS)
    calibration: CalibrationSettings = table("scale, and place of the views on each other", BOTH)
    forces: ForceSettings | None = table("force sensor")
    contact: ContactSettings = table("segmentation of real and gross contact")
    tracking: TrackingSettings = table("points on the skin")
    fields: FieldSettings = table("deformation of the skin, and its elasticity")
    slip: SlipSettings = table("trial of tangential loading")
    stream: StreamSettings = table("player of a deployment bundle")
    rig: RigSettings = table("what the recording cannot tell and the report states; it changes no result")
    given: frozenset[str] = field(default=frozenset(), compare=False)
# fmt: on

    def files(self) -> tuple[Path, ...]:
        """Return the paths of the scene file and of all files named in it, which no output may overwrite."""
        named = [self.recording.frames, self.background.frames, self.background.dark, self.calibration.file]
        named += [self.forces.file] if self.forces else []
        named += [view.region.mask for view in self.views.values() if view.region]
        return (self.path, *filter(None, named))

    @property
    def dense_flow_slip(self) -> bool | None:
        """Return True if slip is to be measured by dense optical flow, else None, so that ``has("dense_flow_slip")`` is
        False.
        """
        return True if self.slip.displacement == "dense_flow" else None

    @property
    def undistorted(self) -> bool | None:
        """Return True if the calibration states no lens, else None, as `dense_flow_slip` does."""
        return True if self.calibration.intrinsics is None else None

    def has(self, need: str) -> bool:
        """Return whether the scene has a value for a key, given as a dotted path such as "forces.tangential"."""
        value: Any = self
        for name in need.split("."):
            value = value.get(name) if isinstance(value, Views) else getattr(value, name)
            if value is None:
                return False
        return True

    def as_json(self) -> str:
        """Return all settings of the scene, including defaults, as JSON text with tables and keys as in the file, and
        the `format` of this text.
        """
        settings = asdict(self)
        del settings["given"]
        return json.dumps({"format": SETTINGS_FORMAT, **settings}, default=str)  # paths as text


#: Tables of a scene file other than [views], which depends on the kind of the scene.
SCENE: dict[str, SceneTable] = {name: entry for name, entry in keys_of(Scene).items() if isinstance(entry, SceneTable)}
#: A table of [views].
VIEW = SceneTable(keys=keys_of(View), settings=View, optional=True)
VIEW_HELP = {
    "contact": "view in which contact darkens the picture, or brightens it (contact.appears)",
    "topography": "view of the ridges; leave it out where there is none: areas only",
    "camera": "the only view",
}


def views_of(scene_kind: Kind) -> SceneTable:
    """Return the definition of the table [views] for a kind of scene, with a rectangle for each view."""
    views = {
        name: replace(VIEW, help=VIEW_HELP.get(name, ""), needed_by=BOTH if name in scene_kind.views else STREAM)
        for name in scene_kind.all_views
    }
    return SceneTable("rectangles of the frame", BOTH, keys=views)


def find_entry(dotted: str) -> SceneKey | SceneTable | None:
    """Return the definition of a key or table of scene files given with dots, such as `tracking.points`; None if there
    is no such key.
    """
    entry: SceneKey | SceneTable | None = SceneTable(keys=SCENE)
    for name in dotted.split("."):
        entry = entry.keys.get(name) if isinstance(entry, SceneTable) else None
    return entry
