"""Reader of what a scene takes from the calibration file of a rig, which `fingerflow calibrate` writes."""

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.text_file import read_text

Pixels = tuple[int, int]
_REMEDY = "write it again with `fingerflow calibrate`"


def read_calibration(path: Path) -> tuple[dict[str, Any], dict[str, tuple[Pixels, Pixels]]]:
    """Read what a scene takes from a calibration file: values of the keys of its table [calibration], and the half-open
    ranges of rows and columns of the views for which they hold, by name. A calibration of a scale alone has no
    ``topography_to_contact``, one without a lens no ``intrinsics``.

    Raises FingerflowError where the file cannot be read, lacks a value, or holds an invalid one.
    """
    try:
        table = tomllib.loads(read_text(path, _REMEDY))
        values: dict[str, Any] = {"mm_per_px": float(_number(table["mm_per_px"]))}
        values |= {key: table[key] for key in ("intrinsics", "distortion") if key in table}
        views = {
            name: (pixel_range("rows", view["rows"]), pixel_range("columns", view["columns"]))
            for name, view in table["views"].items()
        }
        if (transform := table.get("topography_to_contact")) is not None:
            values["topography_to_contact"] = _matrix(transform["affine"]["matrix"])
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FingerflowError(f"{path}: this calibration cannot be read: {error}; {_REMEDY}") from None
    except KeyError as error:
        raise FingerflowError(f"{path}: this calibration has no entry {error}; {_REMEDY}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise FingerflowError(f"{path}: an entry of this calibration is wrong: {error}; {_REMEDY}") from None
    if not 0 < values["mm_per_px"] < math.inf:
        raise FingerflowError(f"{path}: mm_per_px is {values['mm_per_px']}; it must be above 0; {_REMEDY}")
    return values, views


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


def can_be_undone(matrix: Sequence[Sequence[float]], least: float = 0.0) -> bool:
    """Return whether a (2, 3) transform can be inverted: the absolute determinant of the 2 x 2 part exceeds `least`."""
    (a, b, _), (c, d, _) = matrix
    return abs(a * d - b * c) > least


def _matrix(rows: Any) -> list[list[float]]:
    matrix = [list(map(_number, row)) for row in rows]
    whole = [len(row) for row in matrix] == [3, 3] and all(map(math.isfinite, (*matrix[0], *matrix[1])))
    if not whole or not can_be_undone(matrix):
        raise ValueError(f"the matrix {matrix} is no 2 x 3 transform that can be undone")
    return matrix


def _number(value: Any) -> float:
    """Return a value unchanged if it is a number; raise TypeError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return value
