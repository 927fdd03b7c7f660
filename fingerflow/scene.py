"""What was recorded and how it is to be evaluated: one TOML file a trial, read, checked and written."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetPydanticSchema,
    Strict,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import core_schema

from fingerflow.calibration import Calibration as CalibrationFile
from fingerflow.errors import FingerflowError
from fingerflow.scene_errors import describe, unknown_key, wrong
from fingerflow.views import View


def load_scene(path: str | PathLike[str]) -> "Scene":
    """The scene in a TOML file. Paths in it count from its folder; those of the result are absolute.

    Raises FingerflowError, with the line and the remedy, for a key that is not known or missing, a value that cannot
    be, and a file that is not there.
    """
    path = Path(path).resolve()
    try:
        text = path.read_text(encoding="utf-8-sig")
        table = tomllib.loads(text)
    except OSError as error:
        raise FingerflowError(
            f"{path}: this scene cannot be read: {error.strerror}. `fingerflow init` writes one to start from"
        ) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FingerflowError(
            f"{path} is not a TOML file: {error}. Text stands in quotes, paths have / or stand in single quotes"
        ) from error
    try:
        tables = _Tables.model_validate(table, context={"folder": path.parent})
    except ValidationError as error:
        raise describe(path, text, table, error) from error
    return Scene(path=path, **dict(tables))


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, values: Any) -> Any:
        for key in values if isinstance(values, dict) else ():
            if key not in cls.model_fields:
                raise unknown_key(key, cls.model_fields)
        return values


def _existing(path: Path, info: ValidationInfo) -> Path:
    """An absolute path; what follows :: is a place inside an HDF5 file."""
    name, separator, inside = str(path).partition("::")
    location = ((info.context or {}).get("folder", Path.cwd()) / name).resolve()
    if not location.exists():
        raise wrong(None, f"is {str(path)!r}, but {location} does not exist; correct the path or put the file there")
    return Path(f"{location}{separator}{inside}")


def _odd(size: int) -> int:
    if size % 2 == 0:
        raise wrong(None, f"is {size}; it must be odd, so that a pixel lies in the middle: {size - 1} or {size + 1}")
    return size


def _range(ends: tuple[int, int]) -> tuple[int, int]:
    first, end = ends
    if not 0 <= first < end:
        raise wrong(None, f"is {list(ends)}; a range [first, end) needs 0 <= first < end, its end is not part of it")
    return ends


Whole = Annotated[int, Strict()]
Number = Annotated[float, Strict()]
Positive = Annotated[Number, Field(gt=0)]
Odd = Annotated[Whole, Field(ge=1), AfterValidator(_odd)]
Count = Annotated[Whole, Field(ge=0)]
ExistingPath = Annotated[Path, AfterValidator(_existing)]
Range = Annotated[tuple[Whole, Whole], AfterValidator(_range)]
Row = tuple[Number, Number, Number]


class _Ranges(_Section):
    model_config = ConfigDict(from_attributes=True)

    rows: Range = Field(description="pixels [first, end), 0 at the top", examples=[(0, 512)])
    columns: Range = Field(description="pixels [first, end), 0 at the left", examples=[(640, 1280)])


def _view_schema(_source: Any, handler: Any) -> core_schema.CoreSchema:
    return core_schema.no_info_after_validator_function(
        lambda ranges: View(ranges.rows, ranges.columns),
        handler.generate_schema(_Ranges),
        serialization=core_schema.plain_serializer_function_ser_schema(asdict),
    )


CheckedView = Annotated[View, GetPydanticSchema(_view_schema)]


class Recording(_Section):
    """The frames."""

    frames: ExistingPath = Field(
        description="file, or folder of images; an HDF5 data set is file.h5::/group/name", examples=["recording.cine"]
    )
    frame_rate: Positive | None = Field(
        default=None, description="Hz, only where the recording states none or a wrong one", examples=[300.0]
    )
    first_frame: Count = Field(default=0, description="counted from 0")
    last_frame: Count | None = Field(default=None, description="inclusive; without it, to the end", examples=[299])

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.last_frame is not None and self.last_frame < self.first_frame:
            raise wrong("last_frame", f"is {self.last_frame}; it must be at least first_frame, {self.first_frame}")
        return self


class Views(_Section):
    """Where the views lie in a frame."""

    contact: CheckedView = Field(description="ridges that touch are dark", examples=[View((0, 512), (640, 1280))])
    topography: CheckedView | None = Field(
        default=None,
        description="grazing light; without it no skin point is tracked",
        examples=[View((0, 512), (0, 640))],
    )


class Background(_Section):
    """The glass without a finger: whole frames of the size of the recording; several are averaged."""

    frames: ExistingPath = Field(description="recording or image", examples=["background.tif"])
    dark: ExistingPath | None = Field(default=None, description="the same without light", examples=["dark.tif"])


class Forces(_Section):
    """The forces on the glass; without this table nothing is aligned to a trigger."""

    file: ExistingPath = Field(description="CSV, TDMS, MAT or HDF5", examples=["forces.csv"])
    normal: str = Field(description="channel", examples=["normal_force"])
    tangential: str | None = Field(default=None, description="channel", examples=["tangential_force"])
    trigger: str | None = Field(
        default=None,
        description="channel; where it passes trigger_level is the time 0 of the frames",
        examples=["trigger"],
    )
    trigger_level: Number | None = Field(default=None, description="in the unit of the trigger", examples=[2.5])
    time: str | None = Field(default=None, description="channel of the time", examples=["time"])
    sample_rate: Positive | None = Field(
        default=None, description="Hz, where there is no channel of time", examples=[10000.0]
    )

    @model_validator(mode="after")
    def _trigger_with_level(self) -> Self:
        if self.trigger is not None and self.trigger_level is None:
            raise wrong("trigger", f"is {self.trigger!r}; it needs a trigger_level, in its unit: trigger_level = 2.5")
        if self.trigger is None and self.trigger_level is not None:
            raise wrong("trigger_level", f'is {self.trigger_level}; it needs the channel, too: trigger = "trigger"')
        return self


class Calibration(_Section):
    """Either the file that `fingerflow calibrate` wrote, or its values."""

    file: ExistingPath | None = Field(
        default=None, description="instead of the two below", examples=["calibration.toml"]
    )
    mm_per_px: Positive = Field(description="of the contact view", examples=[0.0325])
    topography_to_contact: tuple[Row, Row] = Field(
        default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        description="(x, y, 1) px of the topography view to (x, y) px of the contact view",
    )

    @model_validator(mode="before")
    @classmethod
    def _values_of_file(cls, values: Any, info: ValidationInfo) -> Any:
        if not isinstance(values, dict) or not isinstance(values.get("file"), str):
            return values
        for key in values.keys() & {"mm_per_px", "topography_to_contact"}:
            raise wrong(key, f"is {values[key]!r}, but the calibration is in {values['file']}; remove one of the two")
        path = _existing(Path(values["file"]), info)
        calibration = CalibrationFile.from_toml(path)
        transform = calibration.topography_to_contact
        known = {} if transform is None else {"topography_to_contact": transform.tolist()}
        return {"file": path, "mm_per_px": calibration.mm_per_px, **known}

    @model_validator(mode="after")
    def _can_be_undone(self) -> Self:
        (xx, xy, _), (yx, yy, _) = self.topography_to_contact
        if xx * yy - xy * yx == 0:
            raise wrong(
                "topography_to_contact",
                f"is {self.topography_to_contact}, which maps the view onto a line; "
                f"use the transform that `fingerflow calibrate` finds",
            )
        return self


class Contact(_Section):
    """From light to contact area."""

    median_px: Odd = Field(default=9, description="size of the median filter")
    threshold: Literal["reference_frame", "per_frame"] | Annotated[Number, Field(gt=0, lt=1)] = Field(
        default="reference_frame",
        description='"reference_frame", "per_frame", or the share of light lost that is contact, 0 to 1',
    )
    gross_radius_px: Count = Field(default=8, description="gaps up to twice as wide belong to the gross contact")


class Tracking(_Section):
    """The skin points."""

    points: Annotated[Whole, Field(ge=1)] = Field(default=700, description="at most")
    window_px: Annotated[Odd, Field(ge=3)] = Field(default=21, description="size of the window around a point")
    min_distance_px: Positive = Field(default=7.0, description="between points")
    direction: Literal["forward", "backward"] = Field(default="forward", description="of time: forward or backward")
    template: Literal["keyframe", "previous"] = Field(
        default="keyframe", description="keyframe: does not drift; previous: from frame to frame"
    )
    forward_backward_limit_px: Positive = Field(default=1.0, description="beyond it a point is lost")
    search_px: Count = Field(
        default=0, description="range of a first search, for skin that jumps between frames; 0: none"
    )
    gain_offset: Annotated[bool, Strict()] = Field(default=False, description="true where the light changes")


class Fields(_Section):
    """Divergence, curl, strain and energy."""

    gauge_length_mm: Positive = Field(default=2.0, description="diameter over which a gradient is fitted")
    strain: Literal["green_lagrange", "as_printed", "infinitesimal"] = Field(
        default="green_lagrange", description="green_lagrange, as_printed (Willemet et al. 2021) or infinitesimal"
    )
    young_modulus_mpa: Positive = Field(default=1.0, description="of the skin")
    poisson_ratio: Annotated[Number, Field(gt=-1, lt=0.5)] = Field(default=0.4, description="of the skin")
    depth_mm: Positive = Field(default=2.0, description="of skin that deforms")
    rate_window_s: Positive = Field(default=0.05, description="over which a rate is fitted")


class _Tables(_Section):
    recording: Recording
    views: Views
    background: Background
    forces: Forces | None = None
    calibration: Calibration
    contact: Contact = Contact()
    tracking: Tracking = Tracking()
    fields: Fields = Fields()

    @model_validator(mode="after")
    def _calibrated_in_these_views(self) -> Self:
        """Pixels of a calibration are those of its views."""
        if self.calibration.file is None:
            return self
        calibrated = CalibrationFile.from_toml(self.calibration.file)
        if self.views.topography is not None and calibrated.topography_to_contact is None:
            raise wrong(
                "calibration",
                f"{self.calibration.file} has no topography_to_contact, but there is a [views.topography]; calibrate "
                f"with frames of both views",
            )
        for name in ("contact", "topography"):
            here, there = getattr(self.views, name), calibrated.views.get(name)
            if here is not None and there is not None and here != there:
                raise wrong(
                    "views",
                    f"{name} is {_ranges(here)}, but {self.calibration.file} was made with {_ranges(there)}; "
                    f"use these, or calibrate anew",
                )
        return self


class Scene(_Tables):
    """One recorded trial and the settings of its evaluation. `path` is its file, if it has one."""

    path: Path | None = None


def render_scene(**tables: Mapping[str, Any]) -> str:
    """The text of a scene file in which every entry is explained; `load_scene` reads it.

    tables: what is known, by table and key as in the file: recording={"frames": "press.cine"}, views={"contact":
        View(...)}. What is needed and not given holds an example; what is optional and not given is commented out:
        [forces] always, [views.topography] where other views are given.

    Raises FingerflowError for a table or a key that does not exist.
    """
    _refuse_unknown("the scene", tables, _Tables)
    lines = ["# A scene of fingerflow: what was recorded, and how it is evaluated.", "# Paths count from this file."]
    for name, section in _SECTIONS.items():
        given = tables.get(name)
        _refuse_unknown(f"[{name}]", given or {}, section)
        lines += ["", f"# {section.__doc__}"]
        if section is Views:
            lines += _view_lines(given)
        else:
            absent = section is Forces and given is None
            lines += [f"{'# ' if absent else ''}[{name}]"]
            for key, field in section.model_fields.items():
                lines.append(_entry(key, field, given or {}, unused=absent or _replaced(section, key, given or {})))
    return "\n".join(lines) + "\n"


_SECTIONS: dict[str, type[_Section]] = {
    "recording": Recording,
    "views": Views,
    "background": Background,
    "forces": Forces,
    "calibration": Calibration,
    "contact": Contact,
    "tracking": Tracking,
    "fields": Fields,
}


def _refuse_unknown(where: str, given: Mapping[str, Any], section: type[_Section]) -> None:
    for key in given:
        if key not in section.model_fields:
            raise FingerflowError(f"{where}: {key} {unknown_key(key, section.model_fields).message()}")


def _replaced(section: type[_Section], key: str, given: Mapping[str, Any]) -> bool:
    """Whether the calibration file stands for this entry."""
    return section is Calibration and key != "file" and given.get("file") is not None


def _entry(key: str, field: FieldInfo, given: Mapping[str, Any], unused: bool) -> str:
    value = given.get(key)
    if value is None and not field.is_required():
        value = field.default
    unused = unused or (value is None and not field.is_required())
    if value is None:
        value = (field.examples or [None])[0]
    return f"{'# ' if unused else ''}{key} = {_toml(value)}  # {field.description}"


def _view_lines(given: Mapping[str, View | None] | None) -> list[str]:
    lines = []
    for name, field in Views.model_fields.items():
        view = (field.examples or [None])[0] if given is None else given.get(name)
        mark = "# " if view is None else ""
        lines.append(f"{mark}[views.{name}]  # {field.description}")
        for key, part in _Ranges.model_fields.items():
            shown = view or (field.examples or [None])[0]
            lines.append(f"{mark}{key} = {_toml(getattr(shown, key))}  # {part.description}")
    return lines


def _toml(value: Any) -> str:
    """Numbers, text, paths and lists are written in TOML as in JSON."""
    return json.dumps(value, ensure_ascii=False, default=lambda path: Path(path).as_posix())


def _ranges(view: View) -> str:
    return f"rows = {list(view.rows)}, columns = {list(view.columns)}"
