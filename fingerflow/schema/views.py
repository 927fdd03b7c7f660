"""Views of the finger: rectangles of the camera frame, which may show several views side by side."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.key_types import BOTH, CORNERS, PAIR, PIXEL_RANGE, PROCESS, File, WrongValue, number, row
from fingerflow.schema.keys import key, table

_SEMI_AXIS = number(least=1e-3, most=1e6)


def negative(counts: Any, largest: float) -> Any:
    """Return the negative of a picture, an array or a tensor of camera counts: the `largest` count of the camera less
    each count, so that contact which appears bright becomes dark.
    """
    return largest - counts.clip(max=largest)


# fmt: off
@dataclass(frozen=True)
class Rectangle:
    """Rectangle of a picture, given as half-open ranges of `rows` and `columns`.

    Raises FingerflowError where a range is not two whole numbers 0 <= first < end.
    """

    rows: tuple[int, int] = key("rows of the frame that it covers, [first, last + 1)", type=PIXEL_RANGE, needed_by=BOTH,
        unit="px")
    columns: tuple[int, int] = key("columns of the frame that it covers", type=PIXEL_RANGE, needed_by=BOTH, unit="px")

# fmt: on
    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            try:
                object.__setattr__(self, name, PIXEL_RANGE.convert(getattr(self, name)))
            except WrongValue as wrong:
                raise FingerflowError(f"a view's {name} are {getattr(self, name)!r}: {wrong}") from None

    @property
    def shape(self) -> tuple[int, int]:
        """Return the size (height, width) of the view, px."""
        return self.rows[1] - self.rows[0], self.columns[1] - self.columns[0]

    def crop(self, frame: Any) -> Any:
        """Crop frames (..., H, W), an array or a tensor, to the rectangle of the view, without a copy.

        Raises FingerflowError where the view does not fit into the frame.
        """
        height, width = frame.shape[-2:]
        if self.rows[1] > height or self.columns[1] > width:
            raise FingerflowError(
                f"the view rows {list(self.rows)}, columns {list(self.columns)} does not fit into a frame of "
                f"{height} rows and {width} columns: ranges are half-open, their ends are at most {height} and {width}"
            )
        return frame[..., self.rows[0] : self.rows[1], self.columns[0] : self.columns[1]]


# fmt: off
@dataclass(frozen=True)
class DrawnEllipse:
    """Ellipse that a scene file gives as a region, in px of the view.

    `angle`, in rad from x towards y, is the direction of the first semi-axis.
    """

    center: tuple[float, float] = key("centre [x, y]", type=PAIR, needed_by=BOTH, unit="px")
    semi_axes: tuple[float, float] = key("semi-axes [a, b]", type=row(a=_SEMI_AXIS, b=_SEMI_AXIS), needed_by=BOTH,
        unit="px")
    angle: float = key("of the axis a, from x towards y", 0.0, unit="rad")


@dataclass(frozen=True)
class Region:
    """Region of interest of a view, given by exactly one of these keys, in px of the view; integers are pixel
    centres.
    """

    polygon: tuple[tuple[float, float], ...] | None = key("corners [[x, y], ...]", type=CORNERS, unit="px")
    ellipse: DrawnEllipse | None = table("ellipse in the view", default=None)
    mask: Path | None = key("image of the size of the view; where it is not black is inside",
        type=File(there_for=PROCESS))


@dataclass(frozen=True)
class View(Rectangle):
    """View of the finger: a rectangle of the camera frame. `region` is the region of interest of the view."""

    region: Region | None = table("where skin may touch (contact view) or points are seeded (topography view): "
        "{ellipse = {...}}, or {polygon = [[x, y], ...]}, or {mask = \"mask.png\"}, where it is not black; px of the "
        "view", sample={"ellipse": {"center": [320, 256], "semi_axes": [200, 150]}}, default=None)
# fmt: on
