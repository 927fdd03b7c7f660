"""Recipe of a deployment bundle: settings of the exported graphs, in a validated TOML file."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from fingerflow.engines.bundle import GRAPHS, GraphName
from fingerflow.errors import FingerflowError

_LARGEST_SIDE = 4096  # px, largest side of a view: counts of pixels are exact in float32 up to 2^24


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"{value} is even; the middle pixel needs an odd side, such as {value + 1}")
    return value


Odd = Annotated[int, AfterValidator(_odd)]


class _Table(BaseModel):
    """Table of a recipe with strict types: text and booleans are not accepted as numbers, nor fractions as integers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class ViewRecipe(_Table):
    """Settings [views] of a recipe: size of both views in px, and bit depth.

    Pixels are uint8 for 8 bits, else uint16.
    """

    height: Annotated[int, Field(ge=48, le=_LARGEST_SIDE)]
    width: Annotated[int, Field(ge=48, le=_LARGEST_SIDE)]
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 8


class ContactRecipe(_Table):
    """Settings [contact] of a recipe: sizes in px for the detection of contact, as in a scene file, and whether the
    contact mask is an output.
    """

    median_px: Annotated[Odd, Field(ge=1, le=15)] = 3
    gross_radius_px: Annotated[int, Field(ge=1, le=255)] = 8
    stride_px: Annotated[int, Field(ge=1, le=16)] = 1
    cell_px: Literal[4, 8] | None = None  # side of the cells of the gross contact region
    real_contact_mask: bool = True  # True if `contact` outputs the mask of the real contact


class TrackingRecipe(_Table):
    """Settings [tracking] of a recipe: number and spacing of tracked points, window and search sizes, and error limit,
    as in a scene file.
    """

    points: Annotated[int, Field(ge=3, le=5000)] = 700
    window_px: Annotated[Odd, Field(ge=5, le=41)] = 25
    min_distance_px: Annotated[float, Field(ge=1, le=50)] = 6.0
    forward_backward_limit_px: Annotated[float, Field(gt=0)] = 1.0
    gain_offset: bool = True
    search_px: Annotated[int, Field(ge=1, le=16)] = 8


class FieldsRecipe(_Table):
    """Settings [fields] of a recipe: the gauge length in mm over which deformation is measured, as in a scene file."""

    gauge_length_mm: Annotated[float, Field(gt=0, le=100)] = 1.6


class ExportRecipe(_Table):
    """Settings [export] of a recipe: the graphs to export."""

    graphs: Annotated[tuple[GraphName, ...], Strict(False)] = GRAPHS  # not strict, since TOML has lists and no tuples


class Recipe(_Table):
    """Recipe of a deployment bundle: all tables of settings of a recipe file."""

    views: ViewRecipe
    contact: ContactRecipe = ContactRecipe()
    tracking: TrackingRecipe = TrackingRecipe()
    fields: FieldsRecipe = FieldsRecipe()
    export: ExportRecipe = ExportRecipe()

    @model_validator(mode="after")
    def _points_have_room(self) -> Self:
        if self.tracking.points > (self.views.height * self.views.width) // 16:
            raise ValueError(
                f"tracking.points is {self.tracking.points}: views of {self.views.height} x {self.views.width} px hold "
                f"no more than {self.views.height * self.views.width // 16}"
            )
        return self


def load_recipe(path: Path) -> Recipe:
    """Read and validate a recipe file, and return its settings.

    Raises:
        FingerflowError: the file cannot be read, is not valid TOML, or has an unknown key or a value out of range; with
            the file and key.
    """
    try:
        with path.open("rb") as file:
            content: dict[str, Any] = tomllib.load(file)
        return Recipe.model_validate(content)
    except OSError as error:
        raise FingerflowError(
            f"{path} cannot be read ({error.strerror}); recipes are TOML files such as export/exact.toml"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FingerflowError(f"{path} is no TOML file: {error}") from None
    except ValidationError as error:
        lines = [
            f"{'.'.join(str(part) for part in found['loc']) or 'recipe'}: {found['msg']} (found {found['input']!r})"
            if found["loc"]
            else found["msg"]
            for found in error.errors(include_url=False)
        ]
        raise FingerflowError(f"{path}: " + "; ".join(lines)) from None
