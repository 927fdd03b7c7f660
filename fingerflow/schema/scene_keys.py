"""Definitions of all keys of scene files (type, range, default, commands that need the key), and rules between keys.

A scene has two readers: `process` reads a recording, the player a `stream`. Where their needs differ, the entry of the
key states it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from fingerflow.schema.scene_kinds import Kind

Reader = Literal["process", "stream"]
PROCESS, STREAM = frozenset[Reader](("process",)), frozenset[Reader](("stream",))
BOTH = PROCESS | STREAM
NOBODY = frozenset[Reader]()


@dataclass(frozen=True)
class NumberType:
    """Type of a key that takes a finite number: integer or float, but no boolean."""

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None


@dataclass(frozen=True)
class Whole(NumberType):
    """Type of a key that takes an integer, which must be odd if ``odd`` is set."""

    odd: bool = False


@dataclass(frozen=True)
class Switch:
    """Type of a key that takes true or false."""


@dataclass(frozen=True)
class Text:
    """Type of a key that takes any text."""


@dataclass(frozen=True)
class Choice:
    """Type of a key that takes one of several words, or also a number if ``number`` is set."""

    words: tuple[str, ...]
    number: NumberType | None = None


@dataclass(frozen=True)
class Column:
    """Type of a key that takes a column of the force file, by name or by number from 1, or a list of up to ``several``
    columns.
    """

    several: int = 1


@dataclass(frozen=True)
class Each:
    """Type of a key that takes one number for all force channels, or a list with a number for each channel."""

    number: NumberType = NumberType()
    among: tuple[float, ...] = ()


@dataclass(frozen=True)
class TimeRange:
    """Type of a key that takes an interval [t0, t1] in s from the trigger, with t0 before t1."""


@dataclass(frozen=True)
class Moment:
    """Type of a key that takes an instant of the recording: a word, a frame number from 0, or a time from the trigger
    as "0.25 s".
    """

    words: tuple[str, ...]


@dataclass(frozen=True)
class File:
    """Type of a key that takes a path relative to the scene file, or "file.h5::/dataset" for a data set in a file.

    Attributes:
        there_for: readers for which the file must exist: a scene may be taken to a lab PC without its recording.
        calibration: whether it is a calibration file, which is read with the scene.
    """

    there_for: frozenset[Reader] = BOTH
    calibration: bool = False


@dataclass(frozen=True)
class PixelRange:
    """Type of a key that takes a half-open range [first, end) of pixels."""


@dataclass(frozen=True)
class CornersType:
    """Type of a key that takes a polygon [[x, y], ...] with three or more corners, in px of a view."""


@dataclass(frozen=True)
class Pair:
    """Type of a key that takes a pair of numbers [x, y]."""

    each: NumberType = NumberType()


@dataclass(frozen=True)
class TransformType:
    """Type of a key that takes an invertible affine transform [[a, b, x], [c, d, y]]."""


Type = (
    NumberType
    | Switch
    | Text
    | Choice
    | Column
    | Each
    | TimeRange
    | Moment
    | File
    | PixelRange
    | CornersType
    | Pair
    | TransformType
)


@dataclass(frozen=True)
class SceneKey:
    """Definition of one key of scene files: type, meaning, default and unit, and which reader (`process` or a stream)
    requires the key.

    Attributes:
        type: its type and range.
        help: what it means; shown in the commented scene file, the page's form and the documentation.
        default: where it is left out.
        needed_by: readers that need it.
        unit: of its value, "" if it has none or the type states it.
        sample: value that the commented scene file shows where there is no default.
        label: words for the key in forms and reports; "" where its name in words says enough.
    """

    type: Type
    help: str
    default: Any = None
    needed_by: frozenset[Reader] = NOBODY
    unit: str = ""
    sample: Any = None
    label: str = ""


@dataclass(frozen=True)
class SceneTable:
    """Definition of one table of scene files: its keys and meaning, and which reader (`process` or a stream) requires
    the table.

    A table that is left out takes its defaults, or is None if a reader needs one of its keys.

    Attributes:
        keys: its settings and tables.
        help: what it is about.
        needed_by: readers that need it.
        sample: value that the commented scene file shows for an optional table within another.
    """

    keys: Mapping[str, "SceneKey | SceneTable"]
    help: str = ""
    needed_by: frozenset[Reader] = NOBODY
    sample: Any = None


_UNITS = {"_px": "px", "_mm": "mm", "_s": "s", "_mpa": "MPa"}  # units by the endings of key names


def words_of(name: str, key: "SceneKey | SceneTable") -> tuple[str, str]:
    """Return the words for a key and its unit, such as "depth" and "mm" for `depth_mm`: its label or, without one, its
    name; the unit is "" if the key has none.
    """
    label, own = (key.label, key.unit) if isinstance(key, SceneKey) else ("", "")
    end = next((end for end in _UNITS if name.endswith(end)), "")
    return label or name.removesuffix(end).replace("_", " "), own or _UNITS.get(end, "")


POSITIVE, FROM_0 = NumberType(above=0), Whole(least=0)
RECTANGLE: dict[str, SceneKey | SceneTable] = {
    "rows": SceneKey(PixelRange(), "rows of the frame that it covers, [first, last + 1)", needed_by=BOTH, unit="px"),
    "columns": SceneKey(PixelRange(), "columns of the frame that it covers", needed_by=BOTH, unit="px"),
}
#: A region of a view is given by exactly one of these keys, in px of the view; integers are pixel centres.
REGION = SceneTable(
    {
        "polygon": SceneKey(CornersType(), "corners [[x, y], ...]", unit="px"),
        "ellipse": SceneTable(
            {
                "center": SceneKey(Pair(), "centre [x, y]", needed_by=BOTH, unit="px"),
                "semi_axes": SceneKey(Pair(POSITIVE), "semi-axes [a, b]", needed_by=BOTH, unit="px"),
                "angle": SceneKey(NumberType(), "of the axis a, from x towards y", default=0.0, unit="rad"),
            },
            "ellipse in the view",
        ),
        "mask": SceneKey(File(there_for=PROCESS), "image of the size of the view; where it is not black is inside"),
    },
    "where skin may touch (contact view) or points are seeded (topography view): {ellipse = {...}}, or {polygon = "
    '[[x, y], ...]}, or {mask = "mask.png"}, where it is not black; px of the view',
    sample={"ellipse": {"center": [320, 256], "semi_axes": [200, 150]}},
)

SCENE: dict[str, SceneKey | SceneTable] = {
    "recording": SceneTable(
        {
            "frames": SceneKey(File(there_for=PROCESS),
                "recording: .cine, .mraw/.cih, TIFF, AVI/MP4/MKV, HDF5, .npy or a folder of images",
                needed_by=PROCESS, sample="frames.cine", label="recording"),
            "frame_rate": SceneKey(NumberType(above=1e-6), "only where the recording does not state it",
                unit="Hz", sample=300.0),
            "trigger_frame": SceneKey(FROM_0, "frame at time 0, only where the recording does not state it", sample=12),
            "first_frame": SceneKey(FROM_0, "first frame that counts", default=0),
            "last_frame": SceneKey(FROM_0, "last frame that counts", sample=299),
        },
        "frames of the trial, numbered from 0 as in the file", needed_by=PROCESS,
    ),
    "background": SceneTable(
        {
            "frames": SceneKey(File(there_for=PROCESS), "of the empty glass; several frames are averaged",
                needed_by=BOTH, sample="empty.cine", label="recording of the empty glass"),
            "dark": SceneKey(File(there_for=PROCESS), "without light", sample="dark.cine",
                label="recording without light"),
        },
        "pictures without a finger", needed_by=PROCESS,
    ),
    "calibration": SceneTable(
        {
            "file": SceneKey(File(calibration=True), "from `fingerflow calibrate`; in place of the other keys",
                sample="calibration.toml"),
            "mm_per_px": SceneKey(NumberType(above=0, most=1), "of the contact view", unit="mm/px", sample=0.02,
                label="scale"),
            # This key is used only if there is a topography view.
            "topography_to_contact": SceneKey(TransformType(), "affine map of px, topography view to contact view",
                default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), label="map from topography to contact view"),
        },
        "scale, and place of the views on each other", needed_by=BOTH,
    ),
    "forces": SceneTable(
        {
            "file": SceneKey(File(there_for=PROCESS), "CSV, HDF5, .mat or TDMS", needed_by=BOTH, sample="forces.csv"),
            "normal": SceneKey(Column(), "channel of the normal force: its name in the file, or its number from 1",
                needed_by=BOTH, sample="normal_force", label="normal force column"),
            "tangential": SceneKey(Column(several=2), 'channel of the tangential force, or two, ["fx", "fy"]',
                sample="tangential_force", label="tangential force columns"),
            "units": SceneKey(Choice(("N", "mN", "g", "kgf", "V")), "of the forces, only where the file does not "
                "state it", sample="N", label="unit of the file"),
            "gain": SceneKey(Each(), "of the sensor, N/V where units is V; or one a channel, normal first",
                sample=1.0, label="gain of the sensor"),
            "sign": SceneKey(Each(among=(1, -1)), "-1 where pressing is negative; or one a channel, [-1, 1]",
                default=1.0, sample=1, label="sign of each column"),
            "offset": SceneKey(Each(), "reading without a load, in the unit of the file", sample=0.0,
                label="reading without load"),
            "tare": SceneKey(TimeRange(), "time without contact, from the trigger: its mean is the zero; in place of "
                "offset", unit="s", sample=[-0.5, -0.1], label="time without load"),
            "trigger": SceneKey(Column(), "channel whose first rise through trigger_level is time 0", sample="trigger",
                label="trigger column"),
            "trigger_level": SceneKey(NumberType(), "in the unit of that channel", sample=2.5),
            "time": SceneKey(Column(), "column of the time, only where the file does not name it so", sample="time",
                label="time column"),
            "sample_rate": SceneKey(POSITIVE, "only where the file has no time", unit="Hz", sample=1000.0),
        },
        "force sensor",
    ),
    "contact": SceneTable(
        {
            "appears": SceneKey(Choice(("dark", "bright")), "as skin in contact does beside the empty glass; bright "
                "where light leaves the glass through skin alone (frustrated total internal reflection). Areas are "
                "then those of the picture's negative, in which background.dark has no part",
                default="dark", label="dark or bright"),
            "median_px": SceneKey(Whole(least=3, most=15, odd=True),
                "side of the median filter, narrower than a ridge; the paper has 9, which rounds the ends of ridges",
                default=3, label="median filter"),
            "threshold": SceneKey(Choice(("reference_frame", "per_frame"), NumberType(above=0, below=1)),
                "relative intensity loss that is contact; the words: Otsu's at the largest force, or of each frame",
                default="reference_frame"),
            "gross_radius_px": SceneKey(Whole(least=1, most=255), "half the distance between ridges, or a little more",
                default=8, label="half ridge spacing"),
        },
        "segmentation of real and gross contact",
    ),
    "tracking": SceneTable(
        {
            "points": SceneKey(Whole(least=3), "most points that are tracked", default=700, label="number of points"),
            "window_px": SceneKey(Whole(least=5, most=255, odd=True), "side of the window that is compared",
                default=25, label="side of windows"),
            "min_distance_px": SceneKey(POSITIVE, "least distance between two points", default=6.0,
                label="distance between points"),
            "points_from": SceneKey(Choice(("recorded", "enhanced")), "picture in which points are seeded; enhanced: "
                "without background, stretched, sharpened", default="recorded", label="picture for seeding"),
            "direction": SceneKey(Choice(("forward", "backward")), "of tracking; backward from the last frame",
                default="forward", label="direction of tracking"),
            "template": SceneKey(Choice(("keyframe", "previous")), "frame that a window is compared with; errors add "
                "up with the previous one", default="keyframe", label="windows compared with"),
            "forward_backward_limit_px": SceneKey(POSITIVE, "largest distance after tracking forward and back",
                default=1.0, label="limit of forward-backward error"),
            "search_px": SceneKey(FROM_0, "reach of the search for points that a jolt has carried away; 0 for none",
                default=8, label="search for lost points"),
            "gain_offset": SceneKey(Switch(), "whether windows are compared up to gain and offset of the light",
                default=True, label="allow for changes of light"),
        },
        "points on the skin",
    ),
    "fields": SceneTable(
        {
            "reference": SceneKey(Moment(("onset", "first_frame")), 'a frame of the file (120), or a time ("0.25 '
                's"): moment from which displacement counts; onset is that of each point', default="onset",
                label="displacement counts from"),
            "gauge_length_mm": SceneKey(NumberType(above=0, most=100), "diameter over which a gradient is fitted "
                "(virtual strain gauge)", default=1.6),
            "strain": SceneKey(Choice(("green_lagrange", "as_printed", "infinitesimal")), "measure of strain; "
                "as_printed: Willemet et al. 2021, equation 1", default="green_lagrange", label="measure of strain"),
            "young_modulus_mpa": SceneKey(POSITIVE, "of the skin", default=1.0, label="Young's modulus"),
            "poisson_ratio": SceneKey(NumberType(above=-1, below=0.5), "of the skin", default=0.4,
                label="Poisson's ratio"),
            "depth_mm": SceneKey(POSITIVE, "of skin over which strain energy is integrated", default=2.0,
                label="depth for strain energy"),
            "rate_window_s": SceneKey(POSITIVE, "over which rates are fitted", default=0.05,
                label="time window of rates"),
        },
        "deformation of the skin, and its elasticity",
    ),
    "slip": SceneTable(
        {
            "criterion": SceneKey(Choice(("border", "displacement", "relative")), "of stick: no slip at all; "
                "displacement below stuck_mm, as in the paper; or that relative to the rigid motion of the skin that "
                "sticks",
                default="border", label="criterion of stick"),
            "stuck_mm": SceneKey(POSITIVE, "limit of the criteria displacement and relative, and of "
                "printed_stuck_ratio; the paper has 0.04",
                default=0.04, label="limit of stick"),
            "displacement": SceneKey(Choice(("points", "dense_flow")), "of tracked points, or of all skin by dense "
                "flow, compared with the points", default="points", label="displacement from"),
        },
        "trial of tangential loading",
    ),
    "stream": SceneTable(
        {
            "output": SceneKey(File(there_for=NOBODY), "folder of the results", sample="live"),
            "region": SceneTable(RECTANGLE, "part of the topography view in which points are seeded, by `process` too",
                sample={"rows": [100, 400], "columns": [100, 540]}),
            "update_share": SceneKey(NumberType(above=0, most=1), "least share of tracked points before templates are "
                "updated", sample=0.8),
            "update_frames": SceneKey(Whole(least=1), "most frames before templates are updated", sample=300),
        },
        "player of a deployment bundle",
    ),
    "rig": SceneTable(
        {
            "camera": SceneKey(Text(), "maker and model", sample="maker, model"),
            "lens": SceneKey(Text(), "maker, focal length or magnification", sample="maker, 100 mm macro"),
            "aperture": SceneKey(POSITIVE, "f-number that the lens was set to", sample=8.0),
            "stand_off_mm": SceneKey(POSITIVE, "from the glass to the front of the lens", sample=300.0,
                label="stand-off"),
            "noise_floor": SceneTable(
                {
                    "displacement_mm": SceneKey(NumberType(least=0), "of a component of the displacement of a point",
                        needed_by=BOTH, unit="mm"),
                    "divergence": SceneKey(NumberType(least=0), "of the divergence at a point", needed_by=BOTH),
                    "strain": SceneKey(NumberType(least=0), "of a component of the strain of a triangle",
                        needed_by=BOTH),
                    "window_px": SceneKey(POSITIVE, "tracking.window_px with which it was measured", needed_by=BOTH),
                    "gauge_length_mm": SceneKey(POSITIVE, "fields.gauge_length_mm with which it was measured",
                        needed_by=BOTH),
                },
                "standard deviations in still frames, as `fingerflow noise-floor` prints them",
                sample={"displacement_mm": 0.0005, "divergence": 0.001, "strain": 0.001, "window_px": 25,
                    "gauge_length_mm": 1.6},
            ),
        },
        "what the recording cannot tell and the report states; it changes no result",
    ),
}  # fmt: skip


VIEW_HELP = {
    "contact": "view in which contact darkens the picture, or brightens it (contact.appears)",
    "topography": "view of the ridges; leave it out where there is none: areas only",
    "camera": "the only view",
}


def views_of(kind: Kind) -> SceneTable:
    """Return the definition of the table [views] for a kind of scene, with a rectangle for each view."""
    keys = {**RECTANGLE, "region": REGION}
    tables: dict[str, SceneKey | SceneTable] = {
        name: SceneTable(keys, VIEW_HELP.get(name, ""), BOTH if name in kind.views else STREAM)
        for name in (*kind.views, *kind.optional_views)
    }
    return SceneTable(tables, "rectangles of the frame", BOTH)


#: New names of renamed keys, by their old dotted paths.
RENAMED = {"stream.rekey_share": "update_share", "stream.rekey_frames": "update_frames"}


# Rules between keys, which are named by their dotted paths. An error is reported for the first key of a rule.


@dataclass(frozen=True)
class NotBefore:
    """Rule of scene files: the frame number in `key` is not before the frame number in `first`."""

    key: str
    first: str


@dataclass(frozen=True)
class Together:
    """Rule of scene files: if `key` is given, then `other` must be given too."""

    key: str
    other: str
    why: str
    remedy: str


@dataclass(frozen=True)
class NotBoth:
    """Rule of scene files: `key` and `other` must not both be given."""

    key: str
    other: str
    why: str


@dataclass(frozen=True)
class OneEach:
    """Rule of scene files: a list in `key` has one number for each force channel that the keys `forces` name."""

    key: str
    forces: tuple[str, ...]


@dataclass(frozen=True)
class InPlaceOf:
    """Rule of scene files: a calibration file takes the place of the keys for image scale and transform."""

    key: str
    needed: str
    transform: str


@dataclass(frozen=True)
class Inside:
    """Rule of scene files: the rectangle that `key` describes lies inside the view that `view` describes."""

    key: str
    view: str


@dataclass(frozen=True)
class OneOf:
    """Rule of scene files: the table `key`, if given, has exactly one of the keys that are possible in it."""

    key: str


@dataclass(frozen=True)
class FitsTheViews:
    """Rule of scene files: the calibration has a transform between the two views of the scene, and was made with the
    same rectangles of the frame as views.
    """

    key: str
    scale: str
    transform: str
    view: str
    into: str


Rule = NotBefore | Together | NotBoth | OneEach | InPlaceOf | Inside | OneOf | FitsTheViews
_TRIGGER = "trigger and trigger_level belong together: the channel, and the level that it crosses at time 0"
RULES: tuple[Rule, ...] = (
    NotBefore("recording.last_frame", "recording.first_frame"),
    Together("forces.trigger", "forces.trigger_level", _TRIGGER, "add trigger_level = 2.5 in the channel's unit"),
    Together("forces.trigger_level", "forces.trigger", _TRIGGER, "add trigger = with the channel's name"),
    NotBoth("forces.tare", "forces.offset", "both say what the sensor reads without a load"),
    *(OneEach(f"forces.{key}", ("forces.normal", "forces.tangential")) for key in ("gain", "sign", "offset")),
    InPlaceOf("calibration.file", "calibration.mm_per_px", "calibration.topography_to_contact"),
    Inside("stream.region", "views.topography"),
    *(OneOf(f"views.{view}.region") for view in ("contact", "topography", "camera")),
    *(
        NotBoth("stream.region", f"views.{view}.region", "both say where points are chosen")
        for view in ("topography", "camera")
    ),
    FitsTheViews(
        "calibration.file",
        "calibration.mm_per_px",
        "calibration.topography_to_contact",
        "views.topography",
        "views.contact",
    ),
)
