"""The calibration of a rig: millimetres a pixel, and where a point of one view is in the other."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from fingerflow.calibration.edge import Array, Disc
from fingerflow.calibration.registration import Transform
from fingerflow.errors import FingerflowError
from fingerflow.toml_string import toml_string
from fingerflow.views import View


@dataclass(frozen=True, eq=False)
class Calibration:
    """What the calibration frames say. All pixels are those of a view, (x, y), integers at pixel centres.

    `mm_per_px` holds in the contact view. `discs` are pairs (topography, contact), the largest first, then clockwise.
    `affine` and `similarity` are the transforms topography -> contact; with one view only there are none and no discs.
    """

    mm_per_px: float
    hole_radius_mm: float
    hole: Disc
    views: Mapping[str, View]
    discs: tuple[tuple[Disc, Disc], ...] = ()
    affine: Transform | None = None
    similarity: Transform | None = None
    warnings: tuple[str, ...] = ()

    @property
    def topography_to_contact(self) -> Array | None:
        """The affine (2, 3) from (x, y, 1) px of the topography view to (x, y) px of the contact view."""
        return None if self.affine is None else self.affine.matrix

    def to_toml(self) -> str:
        """The text of a calibration file. Numbers are written in full, so that reading gives the same calibration."""
        lines = [
            "# fingerflow calibration. Pixels are those of a view, (x, y), integers at pixel centres.",
            f"mm_per_px = {_written(self.mm_per_px)}",
            f"warnings = [{', '.join(map(toml_string, self.warnings))}]",
        ]
        for name, view in self.views.items():
            lines += _section(f"[views.{toml_string(name)}]", asdict(view))
        lines += _section("[hole]", {"radius_mm": self.hole_radius_mm, **asdict(self.hole)})
        for name, transform in (("affine", self.affine), ("similarity", self.similarity)):
            if transform is not None:
                values = {"rms_px": transform.rms_px}
                values |= {field: value.tolist() for field, value in vars(transform).items()}
                lines += _section(f"[topography_to_contact.{name}]", values)
        for topography, contact in self.discs:
            lines += ["", "[[discs]]"]
            lines += _section("[discs.topography]", asdict(topography))
            lines += _section("[discs.contact]", asdict(contact))
        return "\n".join(lines) + "\n"

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """The calibration in a file with the text of `to_toml`.

        Raises FingerflowError where it cannot be read, lacks an entry, or holds a scale or a transform that cannot be.
        """
        remedy = "Write it anew with `fingerflow calibrate`"
        try:
            table = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise FingerflowError(f"{path}: this calibration cannot be read: {error}. {remedy}") from error
        try:
            transforms = table.get("topography_to_contact", {})
            calibration = cls(
                mm_per_px=float(table["mm_per_px"]),
                hole_radius_mm=float(table["hole"]["radius_mm"]),
                hole=_disc(table["hole"]),
                views={name: View(view["rows"], view["columns"]) for name, view in table["views"].items()},
                discs=tuple((_disc(pair["topography"]), _disc(pair["contact"])) for pair in table.get("discs", [])),
                affine=_transform(transforms["affine"]) if transforms else None,
                similarity=_transform(transforms["similarity"]) if transforms else None,
                warnings=tuple(table["warnings"]),
            )
        except KeyError as error:
            raise FingerflowError(f"{path}: this calibration has no entry {error}. {remedy}") from error
        except (TypeError, ValueError, AttributeError, FingerflowError) as error:
            raise FingerflowError(f"{path}: an entry of this calibration is wrong: {error}. {remedy}") from error
        if not 0 < calibration.mm_per_px < np.inf:
            raise FingerflowError(f"{path}: mm_per_px is {calibration.mm_per_px}; it must be above 0. {remedy}")
        return calibration


def _section(title: str, values: Mapping[str, Any]) -> list[str]:
    return ["", title, *(f"{name} = {_written(value)}" for name, value in values.items())]


def _written(value: Any) -> str:
    """Numbers, NumPy's too, and lists of them as TOML has them, in full."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_written, value))}]"
    return repr(int(value) if isinstance(value, (int, np.integer)) else float(value))


def _disc(table: Mapping[str, Any]) -> Disc:
    values: dict[str, Any] = {field.name: table[field.name] for field in fields(Disc)}
    return Disc(**{**values, "center": tuple(values["center"]), "semi_axes_px": tuple(values["semi_axes_px"])})


def _transform(table: Mapping[str, Any]) -> Transform:
    matrix, residuals = (np.array(table[field.name], dtype=np.float64) for field in fields(Transform))
    if matrix.shape != (2, 3) or not np.isfinite(matrix).all() or np.linalg.det(matrix[:, :2]) == 0:
        raise ValueError(f"the matrix {matrix.tolist()} is no 2 x 3 transform that can be undone")
    return Transform(matrix, residuals)
