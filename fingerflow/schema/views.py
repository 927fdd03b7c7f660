"""Views of the finger: rectangles of the camera frame, which may show several views side by side."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.calibration_file import pixel_range


def negative(counts: Any, bit_depth: int | None) -> Any:
    """Return the negative of a picture, an array or a tensor of camera counts: the largest count of the camera less
    each count, so that contact which appears bright becomes dark.

    Raises FingerflowError without a bit depth, as floating-point counts have no largest value.
    """
    if bit_depth is None:
        raise FingerflowError(
            'contact.appears is "bright", and the frames are floating-point numbers, of which no largest grey level is '
            "known: record or convert them as integers of 8 to 16 bit"
        )
    return (2**bit_depth - 1) - counts


@dataclass(frozen=True)
class DrawnEllipse:
    """Ellipse that a scene file gives as a region, in px of the view.

    `angle`, in rad from x towards y, is the direction of the first semi-axis.
    """

    center: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float


@dataclass(frozen=True)
class Region:
    """Region of interest of a view, given as a polygon, an ellipse or a mask file, in px of the view."""

    polygon: tuple[tuple[float, float], ...] | None
    ellipse: DrawnEllipse | None
    mask: Path | None


@dataclass(frozen=True)
class View:
    """View of the finger: a rectangle of the camera frame, given as half-open ranges of `rows` and `columns`.

    `region` is the region of interest of the view.

    Raises FingerflowError where a range is not two whole numbers 0 <= first < end.
    """

    rows: tuple[int, int]
    columns: tuple[int, int]
    region: Region | None = None

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            try:
                object.__setattr__(self, name, pixel_range(name, getattr(self, name)))
            except ValueError as error:
                raise FingerflowError(str(error)) from None

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
