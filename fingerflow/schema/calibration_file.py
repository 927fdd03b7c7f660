"""Reader of what a scene takes from the calibration file of a rig, which `fingerflow calibrate` writes."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError
from fingerflow.schema.key_types import PIXEL_RANGE, TRANSFORM, KeyType, WrongValue, number
from fingerflow.schema.text_file import read_text

Pixels = tuple[int, int]
_SCALE = number(above=0)(False)
_REMEDY = "write it again with `fingerflow calibrate`"


def read_calibration(path: Path) -> tuple[dict[str, Any], dict[str, tuple[Pixels, Pixels]]]:
    """Read what a scene takes from a calibration file: values of the keys of its table [calibration], and the half-open
    ranges of rows and columns of the views for which they hold, by name. A calibration of a scale alone has no
    ``topography_to_contact``, one without a lens no ``intrinsics``.

    Raises FingerflowError where the file cannot be read, lacks a value, or holds an invalid one.
    """
    try:
        table = tomllib.loads(read_text(path, _REMEDY))
        values: dict[str, Any] = {key: table[key] for key in ("intrinsics", "distortion") if key in table}
        values["mm_per_px"] = _checked(table, "mm_per_px", _SCALE)
        views: dict[str, tuple[Pixels, Pixels]] = {
            name: (_checked(view, "rows", PIXEL_RANGE), _checked(view, "columns", PIXEL_RANGE))
            for name, view in table["views"].items()
        }
        if (transform := table.get("topography_to_contact")) is not None:
            values["topography_to_contact"] = _checked(transform["affine"], "matrix", TRANSFORM)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FingerflowError(f"{path}: this calibration cannot be read: {error}; {_REMEDY}") from None
    except KeyError as error:
        raise FingerflowError(f"{path}: this calibration has no entry {error}; {_REMEDY}") from None
    except (WrongValue, TypeError, ValueError, AttributeError) as error:
        raise FingerflowError(f"{path}: an entry of this calibration is wrong: {error}; {_REMEDY}") from None
    return values, views


def _checked(table: Mapping[str, Any], name: str, key_type: KeyType) -> Any:
    """Return the validated value of an entry of a table; raise KeyError or WrongValue if there is none."""
    try:
        return key_type.convert(table[name])
    except WrongValue as wrong:
        raise WrongValue(f"{name} is {table[name]!r}: {wrong}") from None
