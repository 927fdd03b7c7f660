"""Calibration of a rig: image scale in mm per pixel, and transform from the topography view to the contact view."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fingerflow.calibration.edge import Disc
from fingerflow.calibration.registration import Transform
from fingerflow.errors import FingerflowError
from fingerflow.recordings.lens import Lens
from fingerflow.schema.calibration_file import read_calibration
from fingerflow.schema.json_value import json_value
from fingerflow.schema.toml_value import toml_value
from fingerflow.schema.views import View


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of a rig: image scale, transforms between the two views, and the matched discs of the target.

    Positions are (x, y) in px of a view; integers are pixel centres. `mm_per_px` holds in the contact view. `discs` are
    pairs (topography, contact), the largest first, then clockwise. `affine` and `similarity` are the transforms
    topography -> contact; a single view has neither transforms nor discs. With a `lens`, scale and transforms are those
    of straight pixels.
    """

    mm_per_px: float
    hole_radius_mm: float
    hole: Disc
    views: Mapping[str, View]
    discs: tuple[tuple[Disc, Disc], ...] = ()
    affine: Transform | None = None
    similarity: Transform | None = None
    warnings: tuple[str, ...] = ()
    lens: Lens | None = None

    @property
    def mm_per_px_std(self) -> float:
        """Return the standard deviation of the scale, mm per px, that the error of the hole's fitted radius in px
        causes; `hole_radius_mm` counts as exact.
        """
        return self.mm_per_px * self.hole.radius_sigma_px / self.hole.radius_px

    def to_toml(self) -> str:
        """Return the text of a calibration file. Numbers have full precision, so reading gives the same calibration."""
        lines = [
            "# fingerflow calibration. Pixels are those of a view, (x, y), integers at pixel centres.",
            f"mm_per_px = {_value(self.mm_per_px)}",
            f"mm_per_px_std = {_value(self.mm_per_px_std)}",
            f"warnings = {_value(self.warnings)}",
        ]
        if self.lens is not None:
            lines += [f"{name} = {_value(value)}" for name, value in asdict(self.lens).items()]
        for name, view in self.views.items():
            lines += _section(f"[views.{toml_value(name)}]", {"rows": view.rows, "columns": view.columns})
        lines += _section("[hole]", {"radius_mm": self.hole_radius_mm, **asdict(self.hole)})
        for name, transform in (("affine", self.affine), ("similarity", self.similarity)):
            if transform is not None:
                lines += _section(f"[topography_to_contact.{name}]", {"rms_px": transform.rms_px, **vars(transform)})
        for topography, contact in self.discs:
            lines += ["", "[[discs]]"]
            lines += _section("[discs.topography]", asdict(topography))
            lines += _section("[discs.contact]", asdict(contact))
        return "\n".join(lines) + "\n"


def is_calibration(path: Path) -> bool:
    """Return whether a file is a valid calibration file."""
    try:
        read_calibration(path)
    except FingerflowError:
        return False
    return True


def _section(title: str, values: Mapping[str, Any]) -> list[str]:
    return ["", title, *(f"{name} = {_value(value)}" for name, value in values.items())]


def _value(value: Any) -> str:
    """Format a Python or NumPy value as TOML at full precision."""
    return toml_value(json_value(value))
