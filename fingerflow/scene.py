"""What was recorded and what is asked of it: one TOML file, validated."""

import re
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, model_validator
from pydantic_core import ErrorDetails

from fingerflow.calibration import Calibration as RigCalibration
from fingerflow.errors import FingerflowError
from fingerflow.views import View


def _existing(path: Path, info: ValidationInfo) -> Path:
    """Paths of a scene file are relative to its folder."""
    folder = (info.context or {}).get("folder", Path())
    found: Path = (folder / path).resolve()
    # "file.h5::/dataset" names a data set within a file.
    if not Path(str(found).split("::")[0]).exists():
        raise ValueError(f"{found} does not exist; paths are relative to the folder of the scene file")
    return found


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"{value} is even; the middle pixel needs an odd side, such as {value + 1}")
    return value


ExistingPath = Annotated[Path, AfterValidator(_existing)]
OddSide = Annotated[int, Field(ge=3), AfterValidator(_odd)]
Positive = Annotated[float, Field(gt=0)]
Row = tuple[float, float, float]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, allow_inf_nan=False)


class RecordingSettings(_Table):
    """[recording]: the frames, and which of them count."""

    frames: ExistingPath
    frame_rate: Positive | None = None
    first_frame: Annotated[int, Field(ge=0)] = 0
    last_frame: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.last_frame is not None and self.last_frame < self.first_frame:
            raise ValueError(f"last_frame {self.last_frame} lies before first_frame {self.first_frame}")
        return self


class ViewSettings(_Table):
    """[views.contact], [views.topography]: half-open ranges of pixels."""

    rows: tuple[int, int]
    columns: tuple[int, int]

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.view()
        except FingerflowError as error:
            raise ValueError(str(error)) from None
        return self

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
    trigger_level: float | None = None
    time: str | None = None
    sample_rate: Positive | None = None

    @model_validator(mode="after")
    def _trigger_has_level(self) -> Self:
        if (self.trigger is None) != (self.trigger_level is None):
            raise ValueError("trigger and trigger_level belong together: the channel, and the level that it crosses")
        return self


class CalibrationSettings(_Table):
    """[calibration]: given here, or by the file that `fingerflow calibrate` wrote."""

    mm_per_px: Positive
    topography_to_contact: tuple[Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, values: Any, info: ValidationInfo) -> Any:
        if not isinstance(values, dict) or "file" not in values:
            return values
        others = sorted(set(values) - {"file"})
        if others:
            raise ValueError(f"file and {', '.join(others)} exclude each other: keep one of them")
        path = _existing(Path(values["file"]), info)
        try:
            rig = RigCalibration.from_toml(path)
        except FingerflowError as error:
            raise ValueError(str(error)) from None
        found: dict[str, Any] = {"mm_per_px": rig.mm_per_px}
        if rig.topography_to_contact is not None:
            found["topography_to_contact"] = rig.topography_to_contact.tolist()
        return found

    @model_validator(mode="after")
    def _invertible(self) -> Self:
        (a, b, _), (c, d, _) = self.topography_to_contact
        if abs(a * d - b * c) < 1e-6:
            raise ValueError("topography_to_contact maps the whole view onto a line; its 2 x 2 part must be invertible")
        return self


class ContactSettings(_Table):
    """[contact]"""

    median_px: OddSide = 3
    threshold: Literal["reference_frame", "per_frame"] | Annotated[float, Field(gt=0, lt=1)] = "reference_frame"
    gross_radius_px: Annotated[int, Field(ge=1)] = 8


class TrackingSettings(_Table):
    """[tracking]"""

    points: Annotated[int, Field(ge=3)] = 700
    window_px: Annotated[OddSide, Field(ge=5)] = 25
    min_distance_px: Positive = 6.0
    direction: Literal["forward", "backward"] = "forward"
    template: Literal["keyframe", "previous"] = "keyframe"
    forward_backward_limit_px: Positive = 1.0
    search_px: Annotated[int, Field(ge=0)] = 0
    gain_offset: bool = False


class FieldSettings(_Table):
    """[fields]"""

    gauge_length_mm: Positive = 1.6
    strain: Literal["green_lagrange", "as_printed", "infinitesimal"] = "green_lagrange"
    young_modulus_mpa: Positive = 1.0
    poisson_ratio: Annotated[float, Field(gt=-1, lt=0.5)] = 0.4
    depth_mm: Positive = 2.0
    rate_window_s: Positive = 0.05


class Scene(_Table):
    """A recording and everything needed to process it; ``path`` is the file that says so."""

    path: Path
    recording: RecordingSettings
    views: Views
    background: BackgroundSettings
    calibration: CalibrationSettings
    forces: ForceSettings | None = None
    contact: ContactSettings = ContactSettings()
    tracking: TrackingSettings = TrackingSettings()
    fields: FieldSettings = FieldSettings()


def load_scene(path: str | Path) -> Scene:
    """Reads a scene file.

    Raises:
        FingerflowError: the file is missing or is no TOML, a key is unknown, a value has the wrong type or range, a
        file
            that it names is missing; with the line and the remedy.
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
        raise FingerflowError(f"{path}, line {_line(text, ['path'])}: path is not a key of a scene file; remove it")
    try:
        return Scene.model_validate({**values, "path": path}, context={"folder": path.parent})
    except ValidationError as error:
        problems = [_explain(path, text, detail) for detail in error.errors()]
        raise FingerflowError("\n".join(dict.fromkeys(problems))) from None


def _explain(path: Path, text: str, detail: ErrorDetails) -> str:
    """One line a problem: file, line, key, value, remedy."""
    # The alternatives of a union appear in the location as names of types; only keys of the file are kept.
    keys = [part for part in detail["loc"] if isinstance(part, str) and re.fullmatch(r"[a-z_]+", part)]
    keys = [key for key in keys if key not in ("float", "literal", "constrained", "str")]
    place = f"{path}, line {_line(text, keys)}: {'.'.join(keys) or 'the file'}"
    if detail["type"] == "extra_forbidden":
        known = _keys_of(keys[:-1])
        close = get_close_matches(keys[-1], known, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        return f"{place} is not a key; {hint}known here: {', '.join(known)}"
    if detail["type"] == "missing":
        return f"{place} is missing; add it, `fingerflow init` shows how"
    message = detail["msg"].removeprefix("Value error, ")
    return (
        f"{place} is {detail['input']!r}: {message}" if not isinstance(detail["input"], dict) else f"{place}: {message}"
    )


def _line(text: str, keys: list[str]) -> int:
    """The line that sets a key, or the header of the nearest table around it, or 1."""
    table, header = "", 1
    for number, line in enumerate(text.splitlines(), start=1):
        found = re.match(r"\s*\[([^\]]+)\]", line)
        if found:
            table = found.group(1).strip()
            if table == ".".join(keys[: table.count(".") + 1]):
                header = number
        elif keys and re.match(rf"\s*{re.escape(keys[-1])}\s*=", line) and table == ".".join(keys[:-1]):
            return number
    return header


def _keys_of(tables: list[str]) -> list[str]:
    """The keys that a table may hold."""
    model: Any = Scene
    for table in tables:
        field = next(f for name, f in model.model_fields.items() if table in (name, f.alias))
        kinds = (field.annotation, *getattr(field.annotation, "__args__", ()))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))
    keys = [field.alias or name for name, field in model.model_fields.items() if name != "path"]
    return sorted([*keys, "file"] if model is CalibrationSettings else keys)


_TOPOGRAPHY, _CONTACT = View((0, 512), (0, 640)), View((0, 512), (640, 1280))


def scene_text(
    *,
    frames: str = "frames.cine",
    frame_rate: float | None = None,
    background: str = "empty.cine",
    dark: str | None = None,
    contact: View = _CONTACT,
    topography: View = _TOPOGRAPHY,
    forces: str | None = None,
    calibration: str = 'file = "calibration.toml"',
) -> str:
    """A commented scene file; the defaults are those of the two-view rig of Willemet et al. 2021."""
    rate = f"frame_rate = {frame_rate}" if frame_rate else "# frame_rate = 300.0"
    dark_line = f'dark = "{dark}"' if dark else '# dark = "dark.cine"'
    mark = "" if forces else "# "
    return f"""# A scene of fingerflow: what was recorded and what is asked of it. Paths are relative to this file.

[recording]
frames = "{frames}"          # .cine, .mraw/.cih, TIFF, AVI/MP4, HDF5, .npy or a folder of images
{rate}          # Hz, only where the recording does not state it
# first_frame = 0             # the frames that count, both included
# last_frame = 299

[views.contact]               # where the view lies in a frame: [first, last + 1) px
rows = {list(contact.rows)}
columns = {list(contact.columns)}

[views.topography]            # leave out where there is no such view: areas only
rows = {list(topography.rows)}
columns = {list(topography.columns)}

[background]
frames = "{background}"       # without a finger; several frames are averaged
{dark_line}            # without light

{mark}[forces]
{mark}file = "{forces or "forces.csv"}"           # CSV, HDF5, .mat or TDMS
{mark}normal = "normal_force"       # names of the channels in the file
{mark}tangential = "tangential_force"
{mark}trigger = "trigger"           # its first rise through trigger_level is time 0
{mark}trigger_level = 2.5

[calibration]
{calibration}

[contact]
median_px = 3                 # side of the median; the paper has 9, which rounds the ends of ridges
threshold = "reference_frame" # Otsu's in the frame of largest force; or "per_frame", or a share of light lost, 0.25
gross_radius_px = 8           # half the distance between ridges, or a little more

[tracking]
points = 700
window_px = 25
min_distance_px = 6.0
direction = "forward"         # or "backward", from the last frame
template = "keyframe"         # or "previous": from frame to frame, errors add up
forward_backward_limit_px = 1.0
search_px = 0                 # how far to search for points that moved more than about 2 px between frames
gain_offset = false           # true where the light changes during the recording

[fields]
gauge_length_mm = 1.6         # diameter over which a gradient is fitted
strain = "green_lagrange"     # or "as_printed" (Willemet et al. 2021, eq. 1), "infinitesimal"
young_modulus_mpa = 1.0
poisson_ratio = 0.4
depth_mm = 2.0                # of skin that the strain energy is integrated over
rate_window_s = 0.05
"""
