"""What was recorded and what is asked of it: one TOML file, validated."""

import re
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from fingerflow.calibration import Calibration as RigCalibration
from fingerflow.errors import FingerflowError
from fingerflow.player.contract.scene_kinds import KINDS, default_kind
from fingerflow.strict import Odd, StrictBool, StrictInt, StrictNumber
from fingerflow.toml_string import toml_string
from fingerflow.views import View


class _Clash(ValueError):
    """Keys that do not go together: one of them is blamed, by its path below the table in which they were compared."""

    def __init__(self, keys: tuple[str, ...], message: str) -> None:
        super().__init__(message)
        self.keys = keys


def _existing(path: Path, info: ValidationInfo) -> Path:
    """Paths of a scene file are relative to its folder."""
    folder = (info.context or {}).get("folder", Path())
    found: Path = (folder / path).resolve()
    # "file.h5::/dataset" names a data set within a file.
    if not Path(str(found).split("::")[0]).exists():
        raise ValueError(f"{found} does not exist; paths are relative to the folder of the scene file")
    return found


ExistingPath = Annotated[Path, AfterValidator(_existing)]
OddSide = Annotated[Odd, Field(ge=3)]
Positive = Annotated[StrictNumber, Field(gt=0)]
PixelRange = tuple[StrictInt, StrictInt]
Row = tuple[StrictNumber, StrictNumber, StrictNumber]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, allow_inf_nan=False)


class RecordingSettings(_Table):
    """[recording]: the frames, and which of them count. Frames are numbered from 0 as they stand in the file."""

    frames: ExistingPath
    frame_rate: Positive | None = None
    trigger_frame: Annotated[StrictInt, Field(ge=0)] | None = None
    first_frame: Annotated[StrictInt, Field(ge=0)] = 0
    last_frame: Annotated[StrictInt, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.last_frame is not None and self.last_frame < self.first_frame:
            raise _Clash(
                ("last_frame",),
                f"that is before first_frame, {self.first_frame}; both are included, so give at least "
                f"{self.first_frame} or leave last_frame out",
            )
        return self


class ViewSettings(_Table):
    """[views.contact], [views.topography]: half-open ranges of pixels."""

    rows: PixelRange
    columns: PixelRange

    @field_validator("rows", "columns")
    @classmethod
    def _possible(cls, pixels: tuple[int, int], info: ValidationInfo) -> tuple[int, int]:
        try:
            View(**{"rows": (0, 1), "columns": (0, 1), str(info.field_name): pixels})
        except FingerflowError as error:
            raise ValueError(str(error)) from None
        return pixels

    def view(self) -> View:
        return View(self.rows, self.columns)


class Views(_Table):
    """[views]: where each view lies in the frame."""

    contact_range: Annotated[ViewSettings, Field(alias="contact")]
    topography_range: Annotated[ViewSettings | None, Field(alias="topography")] = None

    @property
    def contact(self) -> View:
        return self.contact_range.view()

    @property
    def topography(self) -> View | None:
        return None if self.topography_range is None else self.topography_range.view()

    def names(self) -> tuple[str, ...]:
        """Of the views that the scene has."""
        return tuple(name for name in ("contact", "topography") if getattr(self, name) is not None)

    def __getitem__(self, name: str) -> View:
        if name not in self.names():
            raise KeyError(f"the scene has no view {name!r}; it has {', '.join(self.names())}")
        view: View = getattr(self, name)
        return view


class BackgroundSettings(_Table):
    """[background]: frames without a finger, and without light."""

    frames: ExistingPath
    dark: ExistingPath | None = None


class ForceSettings(_Table):
    """[forces]: channels by their names in the file."""

    file: ExistingPath
    normal: str
    tangential: str | None = None
    trigger: str | None = None
    trigger_level: StrictNumber | None = None
    time: str | None = None
    sample_rate: Positive | None = None

    @model_validator(mode="after")
    def _trigger_has_level(self) -> Self:
        together = "trigger and trigger_level belong together: the channel, and the level that it crosses at time 0"
        if self.trigger is not None and self.trigger_level is None:
            raise _Clash(("trigger",), f"{together}; add trigger_level = 2.5 in the channel's unit")
        if self.trigger is None and self.trigger_level is not None:
            raise _Clash(("trigger_level",), f"{together}; add trigger = with the channel's name")
        return self


class CalibrationSettings(_Table):
    """[calibration]: given here, or by the file that `fingerflow calibrate` wrote.

    ``topography_to_contact`` matters only where there is a topography view, and must then be given.
    """

    file: Path | None = None
    mm_per_px: Annotated[Positive, Field(le=1.0)]
    topography_to_contact: tuple[Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, values: Any, info: ValidationInfo) -> Any:
        if not isinstance(values, dict) or "file" not in values:
            return values
        others = sorted(set(values) - {"file"})
        if others:
            raise _Clash(("file",), f"a file and {', '.join(others)} exclude each other; keep one of them")
        if not isinstance(values["file"], str):
            raise _Clash(("file",), "that is no path of a file")
        try:
            path = _existing(Path(values["file"]), info)
            rig = RigCalibration.from_toml(path)
        except (ValueError, FingerflowError) as error:
            raise _Clash(("file",), str(error)) from None
        found: dict[str, Any] = {"file": path, "mm_per_px": rig.mm_per_px}
        if rig.topography_to_contact is not None:
            found["topography_to_contact"] = rig.topography_to_contact.tolist()
        return found

    @field_validator("topography_to_contact")
    @classmethod
    def _invertible(cls, matrix: tuple[Row, Row]) -> tuple[Row, Row]:
        (a, b, _), (c, d, _) = matrix
        if abs(a * d - b * c) < 1e-6:
            raise ValueError("it maps the whole view onto a line; its 2 x 2 part must be invertible")
        return matrix


class ContactSettings(_Table):
    """[contact]"""

    median_px: Annotated[OddSide, Field(le=63)] = 3
    threshold: Literal["reference_frame", "per_frame"] | Annotated[StrictNumber, Field(gt=0, lt=1)] = "reference_frame"
    gross_radius_px: Annotated[StrictInt, Field(ge=1, le=255)] = 8


class TrackingSettings(_Table):
    """[tracking]"""

    points: Annotated[StrictInt, Field(ge=3)] = 700
    window_px: Annotated[OddSide, Field(ge=5, le=255)] = 25
    min_distance_px: Positive = 6.0
    direction: Literal["forward", "backward"] = "forward"
    template: Literal["keyframe", "previous"] = "keyframe"
    forward_backward_limit_px: Positive = 1.0
    search_px: Annotated[StrictInt, Field(ge=0)] = 8
    gain_offset: StrictBool = True


class FieldSettings(_Table):
    """[fields]"""

    gauge_length_mm: Annotated[Positive, Field(le=100.0)] = 1.6
    strain: Literal["green_lagrange", "as_printed", "infinitesimal"] = "green_lagrange"
    young_modulus_mpa: Positive = 1.0
    poisson_ratio: Annotated[StrictNumber, Field(gt=-1, lt=0.5)] = 0.4
    depth_mm: Positive = 2.0
    rate_window_s: Positive = 0.05


class SlipSettings(_Table):
    """[slip]: of a trial of tangential loading. Where the scene has it, slip is among what is computed by default."""

    stuck_mm: Positive = 0.04


class StreamSettings(_Table):
    """[stream]: what the player of an exported bundle reads beside the rest.

    ``region`` is the part of the topography view in which skin is expected to touch, as it lies in the first frame.
    Points are chosen there, by `process` too: so they are the same.
    """

    output: Path | None = None
    region: ViewSettings | None = None
    rekey_share: Annotated[Positive, Field(le=1.0)] | None = None
    rekey_frames: Annotated[StrictInt, Field(ge=1)] | None = None


class Scene(_Table):
    """A recording and everything needed to process it; ``path`` is the file that says so."""

    path: Path
    kind: str
    recording: RecordingSettings
    views: Views
    background: BackgroundSettings
    calibration: CalibrationSettings
    forces: ForceSettings | None = None
    contact: ContactSettings = ContactSettings()
    tracking: TrackingSettings = TrackingSettings()
    fields: FieldSettings = FieldSettings()
    slip: SlipSettings = SlipSettings()
    stream: StreamSettings = StreamSettings()

    def has(self, need: str) -> bool:
        """Whether the scene gives what a dotted key of its file names: "views.topography", "forces.tangential"."""
        found: Any = self
        for key in need.split("."):
            found = getattr(found, key)
            if found is None:
                return False
        return True

    @model_validator(mode="before")
    @classmethod
    def _states_its_kind(cls, values: Any) -> Any:
        return {"kind": default_kind(values), **values}

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError(f"it should be {' or '.join(map(repr, KINDS))}")
        return kind

    @model_validator(mode="after")
    def _region_lies_in_its_view(self) -> Self:
        region, view = self.stream.region, self.views.topography
        if region is not None and view is not None:
            height, width = view.shape
            if region.rows[1] > height or region.columns[1] > width:
                raise _Clash(
                    ("stream", "region"), f"it ends beyond the topography view of {height} x {width} px; give less"
                )
        return self

    @model_validator(mode="after")
    def _calibration_fits_the_views(self) -> Self:
        topography, given = self.views.topography, self.calibration
        if topography is None:
            return self  # the scale holds whatever part of the frame the view is
        if "topography_to_contact" not in given.model_fields_set:
            if given.file is None:
                raise _Clash(
                    ("calibration", "mm_per_px"),
                    "the scene has a topography view, and nothing says where its pixels are in the contact view; add "
                    "topography_to_contact = [[a, b, x], [c, d, y]], or use a file of `fingerflow calibrate --target`",
                )
            raise _Clash(
                ("calibration", "file"),
                "the scene has a topography view, and this calibration is the scale alone; write one that holds the "
                "transform between the views too, with `fingerflow calibrate --target`, or remove [views.topography]",
            )
        if given.file is not None:
            made_with = RigCalibration.from_toml(given.file).views
            for name, view in (("topography", topography), ("contact", self.views.contact)):
                other = made_with.get(name)
                if other != view:
                    raise _Clash(
                        ("calibration", "file"),
                        f"it was made with the {name} view {_ranges(other)}, and the scene has {_ranges(view)}: the "
                        f"transform holds for the same pixels only. Calibrate with the views of this scene, "
                        f"`fingerflow calibrate --topography {_option(topography)} --contact "
                        f"{_option(self.views.contact)}`, or use the views of the calibration",
                    )
        return self


def load_scene(path: str | Path) -> Scene:
    """Reads a scene file.

    Raises:
        FingerflowError: the file is missing or is no TOML, a key is unknown, a value has the wrong type or range, keys
            do not go together, a file that it names is missing; with the line and the remedy.
    """
    path = Path(path).resolve()
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FingerflowError(
            f"{path}: cannot be read ({error.strerror}); `fingerflow init` writes a new one"
        ) from error
    except UnicodeDecodeError as error:
        raise FingerflowError(f"{path}: is not UTF-8 text ({error.reason}); save it as UTF-8") from error
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FingerflowError(f"{path}: is not valid TOML: {error}") from error
    if "path" in values:
        raise FingerflowError(f"{path}, line {_line(text, ('path',))}: path is not a key of a scene file; remove it")
    try:
        return Scene.model_validate({**values, "path": path}, context={"folder": path.parent})
    except ValidationError as error:
        raise FingerflowError("\n".join(_explain(path, text, values, error))) from None


def _explain(path: Path, text: str, values: dict[str, Any], error: ValidationError) -> list[str]:
    """One line a problem: file, line, key, value, remedy."""
    sentences: dict[tuple[str, ...], list[str]] = {}
    meant: set[tuple[str, ...]] = set()  # the keys that misspelt ones stand for: these are not missing
    missing = set()
    for detail in error.errors():
        keys = _keys_in(values, detail["loc"])
        said, found = _in_words_of_toml(detail["msg"]), detail["input"]
        if detail["type"] == "extra_forbidden":
            known = _keys_of(keys[:-1])
            close = get_close_matches(keys[-1], known, n=1)
            meant |= {(*keys[:-1], key) for key in close}
            hint = f"did you mean {close[0]!r}? " if close else ""
            sentence = f"is not a key; {hint}known here: {', '.join(known)}"
        elif detail["type"] == "missing":
            missing.add(keys)
            sentence = "is missing; add it, `fingerflow init` shows how"
        else:
            cause = detail.get("ctx", {}).get("error")
            if isinstance(cause, _Clash):
                keys = (*keys, *cause.keys)
                found = _value_at(values, keys)
            if cause is not None:
                said = str(cause)
            sentence = f"is a table: {said}" if isinstance(found, dict) else f"is {found!r}: {said}"
        others = sentences.setdefault(keys, [])
        # The alternatives of a union are refused one by one.
        others.append(f"or {said}" if others else sentence)
    for keys in missing & meant:
        del sentences[keys]
    return [f"{path}, line {_line(text, keys)}: {'.'.join(keys)} {', '.join(some)}" for keys, some in sentences.items()]


def _in_words_of_toml(message: str) -> str:
    message = re.sub("a valid dictionary.*", "a table", message)
    for pydantic, toml in (
        ("Input should", "it should"),
        ("Tuple should", "it should"),
        ("a valid tuple", "a list"),
        (" after validation", ""),
    ):
        message = message.replace(pydantic, toml)
    return message


def _keys_in(values: Any, location: tuple[int | str, ...]) -> tuple[str, ...]:
    """The part of pydantic's location that is keys of the file; below, it counts items and names types of a union."""
    keys = []
    for part in location:
        if not isinstance(values, dict) or not isinstance(part, str):
            break
        keys.append(part)
        values = values.get(part)
    return tuple(keys)


def _value_at(values: Any, keys: tuple[str, ...]) -> Any:
    for key in keys:
        values = values[key]
    return values


def _line(text: str, keys: tuple[str, ...]) -> int:
    """The line that sets a key, or else that opens or sets the nearest table around it, or 1."""
    table: tuple[str, ...] = ()
    longest, result = 0, 1
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[+([^\[\]]+)\]", line)
        setting = re.match(r"([^#=]+)=", line)
        if header:
            place = table = _parts(header[1])
        elif setting:
            place = (*table, *_parts(setting[1]))
        else:
            continue
        if longest < len(place) and place == keys[: len(place)]:
            longest, result = len(place), number
    return result


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


def _ranges(view: View | None) -> str:
    return "none" if view is None else f"rows {list(view.rows)}, columns {list(view.columns)}"


def _option(view: View) -> str:
    """A view as the command line takes it."""
    return " ".join(map(str, (*view.rows, *view.columns)))


def _keys_of(tables: tuple[str, ...]) -> list[str]:
    """The keys that a table may hold."""
    model: Any = Scene
    for table in tables:
        field = next(f for name, f in model.model_fields.items() if table in (name, f.alias))
        kinds = (field.annotation, *getattr(field.annotation, "__args__", ()))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))
    return sorted(field.alias or name for name, field in model.model_fields.items() if name != "path")


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

[recording]
frames = {toml_string(frames)}          # .cine, .mraw/.cih, TIFF, AVI/MP4, HDF5, .npy or a folder of images
{rate}          # Hz, only where the recording does not state it
{trigger}          # the frame at time 0, only where the recording does not state it
# first_frame = 0             # the frames that count, both included
# last_frame = 299

[views.contact]               # where the view lies in a frame: [first, last + 1) px
rows = {list(contact.rows)}
columns = {list(contact.columns)}

[views.topography]            # leave out where there is no such view: areas only
rows = {list(topography.rows)}
columns = {list(topography.columns)}

[background]
frames = {toml_string(background)}       # without a finger; several frames are averaged
{dark_line}            # without light

{mark}[forces]
{mark}file = {toml_string(forces or "forces.csv")}           # CSV, HDF5, .mat or TDMS
{mark}normal = "normal_force"       # names of the channels in the file
{mark}tangential = "tangential_force"
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
direction = "forward"         # or "backward", from the last frame
template = "keyframe"         # or "previous": from frame to frame, errors add up
forward_backward_limit_px = 1.0
search_px = 8                 # how far to search for points that a jolt has carried away; 0 for not at all
gain_offset = true            # windows are compared whatever the light's gain and offset

[fields]
gauge_length_mm = 1.6         # diameter over which a gradient is fitted
strain = "green_lagrange"     # or "as_printed" (Willemet et al. 2021, eq. 1), "infinitesimal"
young_modulus_mpa = 1.0
poisson_ratio = 0.4
depth_mm = 2.0                # of skin that the strain energy is integrated over
rate_window_s = 0.05

{loaded}[slip]                        # of a trial of tangential loading
{loaded}stuck_mm = 0.04               # skin that has moved by less since the first frame is stuck; the paper has 0.04

{live}[stream]                      # of an exported bundle in its player; `process` takes the region too
{live}region = {{rows = {list(where.rows)}, columns = {list(where.columns)}}}  # of the topography view, for points
"""
