"""Define a result variable, and the unit in which figures and reports show it."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

#: Labels along dimensions.
LABELS = {
    "xy": ("x", "y"),
    "axis": ("major", "minor"),
    "strain_component": ("exx", "eyy", "exy"),
    "shear_component": ("along_axes", "along_diagonals"),
    "principal": ("major", "minor"),
}


#: Environment variable; "1" shows values in % that are otherwise shown in µm/mm. The button of the page sets it.
IN_PERCENT = "FINGERFLOW_PERCENT"


@dataclass(frozen=True)
class ShownUnit:
    """Unit in which figures, reports, web pages and exported tables show a variable.

    Attributes:
        name: as it is printed; "" if dimensionless.
        factor: from the unit of the data set to this one.
        decimals: digits after the point that a live page shows.
        percent: unit in % that takes its place on request (`IN_PERCENT`), or None.
    """

    name: str
    factor: float = 1.0
    decimals: int = 2
    percent: "ShownUnit | None" = None

    def heading(self, words: str) -> str:
        """Return a label or the name of a column, followed by the unit in brackets if there is one."""
        return f"{words} ({self.name})" if self.name else words


PERCENT, PERCENT_PER_S = ShownUnit("%", 100.0, 1), ShownUnit("%/s", 100.0, 1)
UM_PER_MM, UM_PER_MM_S = ShownUnit("µm/mm", 1e3, 1, PERCENT), ShownUnit("µm/mm/s", 1e3, 1, PERCENT_PER_S)
MICROMETRE, MICROJOULE, MILLISECOND = ShownUnit("µm", 1e3, 1), ShownUnit("µJ/mm³", 1e3, 3), ShownUnit("ms", 1e3, 2)
_BY_UNIT = {
    "1": ShownUnit("", decimals=3),
    "mm": ShownUnit("mm", decimals=3),
    "mm2": ShownUnit("mm²"),
    "rad": ShownUnit("°", 180 / math.pi, 1),
}


@dataclass(frozen=True)
class Variable:
    """Definition of a result variable: name, dimensions, unit, meaning, and how figures show it.

    Attributes:
        name: in the data set, in tables and in records.
        dims: names of its dimensions.
        units: in UDUNITS notation; "1" if dimensionless.
        long_name: its definition.
        dtype: data type in NumPy notation.
        equation: in plain text, with the symbols of `schema.variables.SYMBOLS`.
        shown_in: the unit in which people read it; None for that which belongs to `units`.
        needs: keys of the scene without which it is not computed.
        flags: meanings of the values 0, 1, 2 ...
        unasked: whether it is computed by default, without being requested by name.
        formula, of: function of other results of the same stage, and their names, where that suffices to compute it.
        label: its name on axes and in tables; "" for the name in words.
    """

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"
    equation: str = ""
    shown_in: ShownUnit | None = None
    needs: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    unasked: bool = True
    formula: Callable[..., Any] | None = None
    of: tuple[str, ...] = ()
    label: str = ""

    @property
    def words(self) -> str:
        """Return the name of the variable in words, for axes and tables."""
        if self.label:
            return self.label
        name = self.name.removesuffix("_px").replace("_", " ")
        return f"standard deviation of {name.removesuffix(' std')}" if name.endswith(" std") else name

    @property
    def shown_unit(self) -> ShownUnit:
        """Return the unit in which figures, reports, pages and exported tables show the variable."""
        unit = self.shown_in or _BY_UNIT.get(self.units) or ShownUnit(self.units)
        return unit.percent if unit.percent and os.environ.get(IN_PERCENT) == "1" else unit

    @property
    def axis_label(self) -> str:
        """Return an axis label with the shown unit, such as "median divergence (µm/mm)"."""
        return self.shown_unit.heading(self.words)

    def shown_values(self, values: Any) -> Any:
        """Convert values from the unit in the data set to the unit shown in figures and reports."""
        return self.shown_unit.factor * values

    def shown(self) -> dict[str, object]:
        """Return what a web page needs to show the variable: label, unit, factor, decimals, and the unit to show it in
        %.
        """
        unit = self.shown_unit
        percent = unit.percent and {"unit": unit.percent.name, "factor": unit.percent.factor}
        of_unit = {"unit": unit.name, "factor": unit.factor, "decimals": unit.decimals, "percent": percent}
        return {"label": self.words, **of_unit}

    def attributes(self) -> dict[str, object]:
        """Return the data set attributes of the variable by the CF conventions: units, definition and flag meanings."""
        flags = {"flag_values": list(range(len(self.flags))), "flag_meanings": " ".join(self.flags)}
        return {"units": self.units, "long_name": self.long_name, **(flags if self.flags else {})}


def with_deviation(variable: Variable, equation: str = "", note: str = "", **more: Any) -> tuple[Variable, Variable]:
    """Return a variable and its standard deviation, which has the same dimensions and unit, and its own equation.

    A `note` continues the definition of the deviation; `more` are its `formula` and `of`.
    """
    deviation = replace(
        variable,
        name=f"{variable.name}_std",
        long_name=f"standard deviation of the {variable.words}{note}",
        equation=equation,
        label=f"standard deviation of {variable.label}" if variable.label else "",
        **{"formula": None, "of": (), **more},
    )
    return variable, deviation
