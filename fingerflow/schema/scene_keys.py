"""Keys of a scene file: type, range, default and readers that need each, and the rules between keys.

A scene has two readers: `process` reads a recording, the player a `stream`. Where their needs differ, the entry of the
key states it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from fingerflow.schema.scene_kinds import Kind

Reader = Literal["process", "stream"]
PROCESS, STREAM = frozenset[Reader](("process",)), frozenset[Reader](("stream",))
BOTH = PROCESS | STREAM
NOBODY = frozenset[Reader]()


@dataclass(frozen=True)
class NumberType:
    """Finite number; an integer is accepted, a boolean is not."""

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None


@dataclass(frozen=True)
class Whole(NumberType):
    """Integer, written without a decimal point; ``odd`` for the side of a window with a middle pixel."""

    odd: bool = False


@dataclass(frozen=True)
class Switch:
    """Boolean: true or false."""


@dataclass(frozen=True)
class Text:
    """Text without restrictions."""


@dataclass(frozen=True)
class Choice:
    """One of several words, or a number."""

    words: tuple[str, ...]
    number: NumberType | None = None


@dataclass(frozen=True)
class Column:
    """Name of a column or its number from 1; or, if ``several`` > 1, a list of at most that many."""

    several: int = 1


@dataclass(frozen=True)
class Each:
    """One number for all forces, or a list of one a force, normal first; each in ``among`` unless that is empty."""

    number: NumberType = NumberType()
    among: tuple[float, ...] = ()


@dataclass(frozen=True)
class TimeRange:
    """Interval [t0, t1] in s from the trigger, t0 before t1."""


@dataclass(frozen=True)
class Moment:
    """Instant: one of several words, a frame number from 0, or a time from the trigger as text, "0.25 s"."""

    words: tuple[str, ...]


@dataclass(frozen=True)
class File:
    """Path relative to the scene file; "file.h5::/dataset" is a data set within a file.

    Attributes:
        there_for: readers for which the file must exist: a scene may be taken to a lab PC without its recording.
        calibration: whether it is a calibration file, which is read with the scene.
    """

    there_for: frozenset[Reader] = BOTH
    calibration: bool = False


@dataclass(frozen=True)
class PixelRange:
    """Half-open range [first, end) of pixels."""


@dataclass(frozen=True)
class CornersType:
    """Polygon [[x, y], ...] of three or more corners, px of a view."""


@dataclass(frozen=True)
class Pair:
    """Pair of numbers [x, y]."""

    each: NumberType = NumberType()


@dataclass(frozen=True)
class TransformType:
    """Invertible affine transform [[a, b, x], [c, d, y]]."""


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
    """Entry for one setting: its type, its default, and the readers that need it."""

    type: Type
    default: Any = None
    needed_by: frozenset[Reader] = NOBODY


@dataclass(frozen=True)
class SceneTable:
    """Table of settings. If left out, it takes its defaults, or is None where a reader needs one of its keys."""

    keys: Mapping[str, "SceneKey | SceneTable"]
    needed_by: frozenset[Reader] = NOBODY


POSITIVE, FROM_0 = NumberType(above=0), Whole(least=0)
RECTANGLE = {"rows": SceneKey(PixelRange(), needed_by=BOTH), "columns": SceneKey(PixelRange(), needed_by=BOTH)}
#: Region of a view by exactly one of these keys, in px of the view with integers at pixel centres.
REGION = SceneTable(
    {
        "polygon": SceneKey(CornersType()),
        "ellipse": SceneTable(
            {
                "center": SceneKey(Pair(), needed_by=BOTH),
                "semi_axes": SceneKey(Pair(POSITIVE), needed_by=BOTH),
                "angle": SceneKey(NumberType(), default=0.0),
            }
        ),
        "mask": SceneKey(File(there_for=PROCESS)),
    }
)

SCENE: dict[str, SceneKey | SceneTable] = {
    "recording": SceneTable(
        {
            "frames": SceneKey(File(there_for=PROCESS), needed_by=PROCESS),
            "frame_rate": SceneKey(NumberType(above=1e-6)),
            "trigger_frame": SceneKey(FROM_0),
            "first_frame": SceneKey(FROM_0, default=0),
            "last_frame": SceneKey(FROM_0),
        },
        needed_by=PROCESS,
    ),
    "background": SceneTable(
        {
            "frames": SceneKey(File(there_for=PROCESS), needed_by=BOTH),
            "dark": SceneKey(File(there_for=PROCESS)),
        },
        needed_by=PROCESS,
    ),
    "calibration": SceneTable(
        {
            "file": SceneKey(File(calibration=True)),
            "mm_per_px": SceneKey(NumberType(above=0, most=1)),
            # Used only if there is a topography view.
            "topography_to_contact": SceneKey(TransformType(), default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
        },
        needed_by=BOTH,
    ),
    "forces": SceneTable(
        {
            "file": SceneKey(File(there_for=PROCESS), needed_by=BOTH),
            "normal": SceneKey(Column(), needed_by=BOTH),
            "tangential": SceneKey(Column(several=2)),
            "units": SceneKey(Choice(("N", "mN", "g", "kgf", "V"))),
            "gain": SceneKey(Each()),
            "sign": SceneKey(Each(among=(1, -1)), default=1.0),
            "offset": SceneKey(Each()),
            "tare": SceneKey(TimeRange()),
            "trigger": SceneKey(Column()),
            "trigger_level": SceneKey(NumberType()),
            "time": SceneKey(Column()),
            "sample_rate": SceneKey(POSITIVE),
        },
    ),
    "contact": SceneTable(
        {
            "median_px": SceneKey(Whole(least=3, most=63, odd=True), default=3),
            "threshold": SceneKey(
                Choice(("reference_frame", "per_frame"), NumberType(above=0, below=1)), default="reference_frame"
            ),
            "gross_radius_px": SceneKey(Whole(least=1, most=255), default=8),
        },
    ),
    "tracking": SceneTable(
        {
            "points": SceneKey(Whole(least=3), default=700),
            "window_px": SceneKey(Whole(least=5, most=255, odd=True), default=25),
            "min_distance_px": SceneKey(POSITIVE, default=6.0),
            "points_from": SceneKey(Choice(("recorded", "enhanced")), default="recorded"),
            "direction": SceneKey(Choice(("forward", "backward")), default="forward"),
            "template": SceneKey(Choice(("keyframe", "previous")), default="keyframe"),
            "forward_backward_limit_px": SceneKey(POSITIVE, default=1.0),
            "search_px": SceneKey(FROM_0, default=8),
            "gain_offset": SceneKey(Switch(), default=True),
        },
    ),
    "fields": SceneTable(
        {
            "reference": SceneKey(Moment(("onset", "first_frame")), default="onset"),
            "gauge_length_mm": SceneKey(NumberType(above=0, most=100), default=1.6),
            "strain": SceneKey(Choice(("green_lagrange", "as_printed", "infinitesimal")), default="green_lagrange"),
            "young_modulus_mpa": SceneKey(POSITIVE, default=1.0),
            "poisson_ratio": SceneKey(NumberType(above=-1, below=0.5), default=0.4),
            "depth_mm": SceneKey(POSITIVE, default=2.0),
            "rate_window_s": SceneKey(POSITIVE, default=0.05),
        },
    ),
    "slip": SceneTable(
        {
            "criterion": SceneKey(Choice(("border", "displacement", "relative")), default="border"),
            "stuck_mm": SceneKey(POSITIVE, default=0.04),
            "displacement": SceneKey(Choice(("points", "dense_flow")), default="points"),
        }
    ),
    "stream": SceneTable(
        {
            "output": SceneKey(File(there_for=NOBODY)),
            "region": SceneTable(RECTANGLE),
            "rekey_share": SceneKey(NumberType(above=0, most=1)),
            "rekey_frames": SceneKey(Whole(least=1)),
        },
    ),
}


def views_of(kind: Kind) -> SceneTable:
    """Return the table [views] of a kind of scene: a rectangle for each view, and a region in it."""
    keys: dict[str, SceneKey | SceneTable] = {**RECTANGLE, **({"region": REGION} if kind.regions else {})}
    tables: dict[str, SceneKey | SceneTable] = {name: SceneTable(keys, needed_by=BOTH) for name in kind.views}
    tables |= {name: SceneTable(keys, needed_by=STREAM) for name in kind.optional_views}
    return SceneTable(tables, needed_by=BOTH)


def optional(table: SceneKey | SceneTable) -> SceneTable:
    """Return the same table with keys that no reader needs."""
    assert isinstance(table, SceneTable)
    return SceneTable({name: replace(key, needed_by=NOBODY) for name, key in table.keys.items()})


# Rules between keys, named by their dotted paths. An error is reported for the first key of a rule.


@dataclass(frozen=True)
class NotBefore:
    """Rule: a frame number is not below another."""

    key: str
    first: str


@dataclass(frozen=True)
class Together:
    """Rule: if the key is given, the other must be given too."""

    key: str
    other: str
    why: str
    remedy: str


@dataclass(frozen=True)
class NotBoth:
    """Rule: at most one of two keys is given."""

    key: str
    other: str
    why: str


@dataclass(frozen=True)
class OneEach:
    """Rule: a list has one number a force."""

    key: str
    forces: tuple[str, ...]


@dataclass(frozen=True)
class InPlaceOf:
    """Rule: a calibration file replaces the scale and, if present in it, the transform; else the scale is needed."""

    key: str
    needed: str
    transform: str


@dataclass(frozen=True)
class Inside:
    """Rule: a rectangle lies within a view."""

    key: str
    view: str


@dataclass(frozen=True)
class OneOf:
    """Rule: a table that is given has exactly one of its keys."""

    key: str


@dataclass(frozen=True)
class FitsTheViews:
    """Rule: the calibration maps the pixels of one view to the other and was made with these views."""

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
