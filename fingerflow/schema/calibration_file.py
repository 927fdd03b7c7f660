"""Reader of the calibration file of a rig, which `fingerflow calibrate` writes, into plain numbers."""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

Pixels = tuple[int, int]
# Names of the scalar entries of a disc.
DISC = ("angle", "center_sigma_px", "edge_rms_px", "coverage", "contrast", "significance")
DISC_PAIRS = ("center", "semi_axes_px")
_REMEDY = "Write it again with `fingerflow calibrate`"


class CalibrationError(Exception):
    """Error in a calibration file; the message names the file, the problem and the remedy."""


class TransformRows(NamedTuple):
    """Transform between the pixels of the two camera views as stored in a calibration file: matrix rows and residuals
    of the fit.

    Attributes:
        matrix: (2, 3), maps (x, y, 1) px to (x, y) px.
        residuals_px: (N, 2) px, residuals of the fit.
    """

    matrix: tuple[tuple[float, ...], ...]
    residuals_px: tuple[tuple[float, ...], ...]


class CalibrationFile(NamedTuple):
    """Content of a calibration file in plain numbers: image scale, transforms between the views, and the ellipses
    fitted to hole and discs of the calibration target.

    Pixels are those of a view. `views` holds half-open ranges of rows and columns of a frame.
    """

    mm_per_px: float
    hole_radius_mm: float
    hole: Mapping[str, Any]
    views: Mapping[str, tuple[Pixels, Pixels]]
    discs: tuple[tuple[Mapping[str, Any], Mapping[str, Any]], ...]
    affine: TransformRows | None
    similarity: TransformRows | None
    warnings: tuple[str, ...]

    def matrix(self) -> list[list[float]] | None:
        """Return the affine transform [[a, b, x], [c, d, y]] from px of the topography view to px of the contact view.

        Returns None where the calibration holds only a scale.
        """
        return None if self.affine is None else [list(row) for row in self.affine.matrix]


def read_calibration(path: Path) -> CalibrationFile:
    """Read a calibration file and return the content in plain numbers.

    Raises CalibrationError where the file cannot be read, lacks an entry, or holds an invalid scale or transform.
    """
    try:
        if path.exists() and not path.is_file():
            raise OSError(0, "it is no file")
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CalibrationError(f"{path}: this calibration cannot be read: {error.strerror}. {_REMEDY}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise CalibrationError(f"{path}: this calibration cannot be read: {error}. {_REMEDY}") from None
    try:
        transforms = table.get("topography_to_contact", {})
        found = CalibrationFile(
            mm_per_px=float(_number(table["mm_per_px"])),
            hole_radius_mm=float(_number(table["hole"]["radius_mm"])),
            hole=_disc(table["hole"]),
            views={
                name: (pixel_range("rows", view["rows"]), pixel_range("columns", view["columns"]))
                for name, view in table["views"].items()
            },
            discs=tuple((_disc(pair["topography"]), _disc(pair["contact"])) for pair in table.get("discs", [])),
            affine=_transform(transforms["affine"]) if transforms else None,
            similarity=_transform(transforms["similarity"]) if transforms else None,
            warnings=tuple(map(str, table["warnings"])),
        )
    except KeyError as error:
        raise CalibrationError(f"{path}: this calibration has no entry {error}. {_REMEDY}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(f"{path}: an entry of this calibration is wrong: {error}. {_REMEDY}") from None
    if not 0 < found.mm_per_px < math.inf:
        raise CalibrationError(f"{path}: mm_per_px is {found.mm_per_px}; it must be above 0. {_REMEDY}")
    return found


def pixel_range(name: str, values: Any) -> Pixels:
    """Check a range of pixels; return it as integers (first, end) with 0 <= first < end, or raise ValueError."""
    try:
        first, end = (int(value) for value in values)
        whole = (first, end) == tuple(values)
    except (TypeError, ValueError):
        whole = False
    if not whole or not 0 <= first < end:
        raise ValueError(
            f"a view's {name} are {values!r}; two whole numbers [first, end) with 0 <= first < end are needed, "
            f"for example [0, 512]"
        )
    return first, end


def can_be_undone(matrix: tuple[tuple[float, ...], ...], least: float = 0.0) -> bool:
    """Return whether a (2, 3) transform can be inverted: the absolute determinant of the 2 x 2 part exceeds `least`."""
    (a, b, _), (c, d, _) = matrix
    return abs(a * d - b * c) > least


def _disc(table: Mapping[str, Any]) -> dict[str, Any]:
    pairs = {name: _numbers(table[name]) for name in DISC_PAIRS}
    return {**pairs, **{name: _number(table[name]) for name in DISC}}


def _transform(table: Mapping[str, Any]) -> TransformRows:
    found = TransformRows(*(tuple(map(_numbers, table[name])) for name in TransformRows._fields))
    matrix = found.matrix
    whole = [len(row) for row in matrix] == [3, 3] and all(math.isfinite(one) for row in matrix for one in row)
    if not whole or not can_be_undone(matrix):
        raise ValueError(f"the matrix {[list(row) for row in matrix]} is no 2 x 3 transform that can be undone")
    if any(len(row) != 2 for row in found.residuals_px):
        raise ValueError(f"the residuals {[list(row) for row in found.residuals_px]} are no pairs of px")
    return found


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(map(_number, values))


def _number(value: Any) -> float:
    """Return a value unchanged if it is a number; raise TypeError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return value
