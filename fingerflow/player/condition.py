"""Condition on a live value, such as "gross_contact_area > 20 mm2", for triggers."""

import math
import operator
import re
from collections.abc import Mapping

from fingerflow.errors import PlayerError, did_you_mean
from fingerflow.schema.variable_record import Variable

_COMPARE = {">": operator.gt, ">=": operator.ge, "<": operator.lt, "<=": operator.le}
_NUMBER = r"([\d.]+(?:[eE][-+]?\d+)?)"
_FORM = re.compile(rf"\s*(\w+)\s*(>=|<=|>|<)\s*([-+]?){_NUMBER}\s*([^\s,]*)(?:\s*,\s*margin\s+{_NUMBER})?\s*")


class Condition:
    """Comparison of one live value (a number measured in each frame) with a limit, which tells at which frames it
    becomes true.

    Args:
        text: "NAME > NUMBER UNIT" or "NAME > NUMBER UNIT, margin NUMBER"; also >=, <, <=. The name is that of a
            variable. The unit, also of the margin, is that of the data set or that of the page.
        variables: that can be compared, by name.

    Attributes:
        name, limit, margin: name of the variable; limit, and distance by which the value has to return beyond the limit
            before the condition can become true again (hysteresis), in the unit of the data set.

    Raises PlayerError for another form, an unknown variable, or a unit in which it is not measured.
    """

    def __init__(self, text: str, variables: Mapping[str, Variable]) -> None:
        parts = _FORM.fullmatch(text)
        if parts is None:
            raise PlayerError(
                f"{text!r} is no condition such as 'gross_contact_area > 20 mm2', or 'gross_contact_area > 20 mm2, "
                "margin 2'"
            )
        self.text = text
        self.name = parts[1]
        if self.name not in variables:
            remedy = f"{did_you_mean(self.name, variables)}there are {', '.join(variables)}"
            raise PlayerError(f"there is no live value {self.name!r}; {remedy}")
        self._compare = _COMPARE[parts[2]]
        factor = _factor(variables[self.name], parts[5])
        try:
            self.limit, self.margin = float(parts[3] + parts[4]) / factor, float(parts[6] or 0) / factor
        except ValueError:
            raise PlayerError(f"{text!r}: a number has one decimal point, as in 2.5") from None
        self._true = False

    def becomes_true(self, values: Mapping[str, float]) -> bool:
        """Return whether the condition holds for the values of a frame, by name, and did not hold for the last earlier
        frame whose value was known.

        Once true it holds until the value has returned beyond the limit by the margin. The first frame of a stream
        counts as preceded by one of which it was not true.
        """
        value = values[self.name]
        if math.isnan(value):
            return False
        limit = self.limit + (self.margin if self._compare(0, 1) else -self.margin) * self._true
        before, self._true = self._true, self._compare(value, limit)
        return self._true and not before


def _factor(variable: Variable, unit: str) -> float:
    """Return the factor that converts values of a variable from the unit of the data set to a unit typed by the user,
    such as "mm2"; raise PlayerError if the variable is not measured in that unit.
    """
    shown, base = variable.shown_unit, "" if variable.units == "1" else variable.units
    factors_named = {base: 1.0} | {unit.name: unit.factor for unit in (shown, shown.percent) if unit}
    factors = {_plain(name): factor for name, factor in factors_named.items()}
    if _plain(unit) not in factors:
        units = " or ".join(repr(shown_name or "no unit") for shown_name in factors_named)
        problem = f"not in {unit!r}" if unit else "and the condition gives no unit behind the number"
        raise PlayerError(f"{variable.name} is measured in {units}, {problem}")
    return factors[_plain(unit)]


def _plain(unit: str) -> str:
    """Return a unit as it is typed on any keyboard: mm2 for mm² and mm^2, um for µm, deg for °."""
    return unit.translate(str.maketrans("²³µμ", "23uu", "^")).replace("°", "deg")
