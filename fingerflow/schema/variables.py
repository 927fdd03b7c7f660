"""Definitions of all result variables: name, dimensions, unit, meaning, equation and shown unit.

They stand in `variables.toml`; the formulas of those that follow from others, and their names by group, are here. The
data set, its files and tables, the records of a stream, figures, pages and the documentation use these entries. Only
the standard library is imported, because an exported bundle contains this file.
"""

import tomllib
from collections.abc import Iterable
from math import pi
from operator import truediv
from pathlib import Path
from typing import Any

from fingerflow.schema.variable_record import SHOWN_UNITS, ShownUnit, Variable

#: Symbols used in the equations.
SYMBOLS = """\
I is a pixel of a frame, I₀ of the empty glass, D without light; s mm per pixel of the contact view; x the position of a
point on the glass, X its reference position, u = x − X = (u, v) its displacement; u_x = ∂u/∂X and so on, from planes
fitted to u with weights (1 − (r/R)²)² within R, half of fields.gauge_length_mm; σ a standard deviation, Σ the
covariance of the inputs, propagated to first order. E, ν and h are fields.young_modulus_mpa, poisson_ratio and
depth_mm.
"""

FRAME = ("frame",)
DARK_SHARE = 0.1  # a frame darker than this share of the empty glass's light is dark; a contact leaves half of it
SATURATED_SHARE = 0.5  # a frame with a larger share of blocks at the highest grey level is saturated


def _gross_area_std(semi_axes: Any, real_area: Any) -> Any:
    """Return the standard deviation, mm^2, of the gross contact area in each frame, from the semi-axes (frames, 2), mm,
    of its ellipse and the real contact area (frames,).

    Where there is no ellipse but a real area (frames,), a contact of a ridge or less is too small to be seen as one.
    The constants are measured on presses through real prints (docs/methods/contact.md).
    """
    small = 0.3**2 / (1 + (pi / 1.5 * semi_axes.prod(-1)) ** 4)
    deviation = ((0.015 * pi) ** 2 * 2 * (semi_axes**2).sum(-1) + 0.15**2 + small) ** 0.5
    deviation[(deviation != deviation) & (real_area > 0)] = 0.25
    return deviation


def _real_area_std(real_area: Any) -> Any:
    """Return the standard deviation, mm^2, of the real contact area (frames,), most of it shared by all frames.

    The edges of ridges are blurred, and the median takes their corners: measured on presses through real prints.
    """
    return (0.025**2 * real_area ** (4 / 3) + 0.01**2) ** 0.5


def _ratio_std(real_area: Any, real_std: Any, gross_area: Any, gross_std: Any) -> Any:
    """Return the standard deviation of the ratio of two areas with independent errors."""
    return (real_std**2 + (real_area / gross_area * gross_std) ** 2) ** 0.5 / gross_area


def _ellipse_std(lengths: Any) -> Any:
    """Return the standard deviation, mm, of lengths of the ellipse: the same on contacts of 1 to 60 mm^2."""
    return 0 * lengths + 0.028


def _angle_std(semi_axes: Any) -> Any:
    """Return the standard deviation, rad, of the angle of an ellipse, at most that of any angle, pi / sqrt(12)."""
    return 1 / (12 / pi**2 + ((semi_axes[..., 0] - semi_axes[..., 1]) / 0.03) ** 2) ** 0.5


_FORMULAS = {
    "real_contact_area_std": _real_area_std,
    "gross_contact_area_std": _gross_area_std,
    "contact_area_ratio": truediv,
    "contact_area_ratio_std": _ratio_std,
    "ellipse_center_std": _ellipse_std,
    "ellipse_semi_axes_std": _ellipse_std,
    "ellipse_angle_std": _angle_std,
}


def _read_variables() -> dict[str, tuple[Variable, ...]]:
    """Return the variables that `variables.toml` defines, by the names of their groups."""
    groups = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    texts = groups.pop("texts")

    def variable(name: str, long_name: str, equation: str = "", shown_in: str = "", **facts: Any) -> Variable:
        lists = {key: tuple(value) for key, value in facts.items() if isinstance(value, list)}
        words = {"long_name": long_name.format_map(texts), "equation": equation.format_map(texts)}
        formula, unit = _FORMULAS.get(name), SHOWN_UNITS.get(shown_in)
        return Variable(name, **{**facts, **lists, **words}, shown_in=unit, formula=formula)

    return {group: tuple(variable(name, **facts) for name, facts in named.items()) for group, named in groups.items()}


_GROUPS = _read_variables()
(TIME,), FRAME_CHECK, LOADING, CONTACT, PRINTED_CONTACT, TRACKING = (
    _GROUPS[group] for group in ("time", "frame_check", "loading", "contact", "printed_contact", "tracking")
)
DISPLACEMENT, FIELDS, STRAIN, SLIP, STREAM = (
    _GROUPS[group] for group in ("displacement", "fields", "strain", "slip", "stream")
)


def by_name(*groups: Iterable[Variable]) -> dict[str, Variable]:
    """Return the variables in several groups as a mapping from name to definition."""
    return {variable.name: variable for group in groups for variable in group}


#: All variables of results and streams by name.
VARIABLES: dict[str, Variable] = by_name(*_GROUPS.values())
#: Names of the frame status values; only usable frames have results.
FRAME_STATUS = VARIABLES["frame_status"].flags
#: Names of the values of `fingerflow.kernels.tracking_limits.TrackStatus`, which defines each.
TRACK_STATUS = VARIABLES["status"].flags
ENTRY = VARIABLES["entry"].flags


def shown_unit(name: str, units: str) -> ShownUnit:
    """Return the unit in which figures and tables show the variable `name`; a variable that is not defined here is
    shown in `units`.
    """
    return VARIABLES.get(name, Variable(name, (), units, "")).shown_unit
