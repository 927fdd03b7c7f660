"""Condition on a live value, such as "gross_contact_area > 20 mm2", for triggers."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping

from fingerflow.errors import PlayerError
from fingerflow.schema.variable_record import Variable

_COMPARE: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
}
_FORM = re.compile(r"\s*([\w ]+?)\s*(>=|<=|>|<)\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S*)\s*")


class Condition:
    """Comparison of one live value (a number measured in each frame) with a limit, which tells at which frames it
    becomes true.

    Args:
        text: "NAME > NUMBER UNIT"; also >=, <, <=. The name is that of a variable, or the words by which its definition
            begins, as in "apparent_area". The unit is that of the data set or that of the page.
        variables: that can be compared, by name.

    Attributes:
        name, limit: name of the variable, and the limit in the unit of the data set.

    Raises PlayerError for another form, an unknown variable, or a unit in which it is not measured.
    """

    def __init__(self, text: str, variables: Mapping[str, Variable]) -> None:
        parts = _FORM.fullmatch(text)
        if parts is None:
            raise PlayerError(f"{text!r} is no condition such as 'gross_contact_area > 20 mm2'")
        self.text = text
        self.name = _meant(parts[1], variables)
        self._compare = _COMPARE[parts[2]]
        try:
            number = float(parts[3])
        except ValueError:
            raise PlayerError(f"{text!r}: {parts[3]!r} is no number") from None
        self.limit = number / _factor(variables[self.name], parts[4])
        self._true = False

    def becomes_true(self, values: Mapping[str, float]) -> bool:
        """Return whether the condition holds for the values of a frame, by name, and did not hold for the last earlier
        frame whose value was known.

        The first frame of a stream counts as preceded by one of which it was not true.
        """
        value = values[self.name]
        if math.isnan(value):
            return False
        before, self._true = self._true, self._compare(value, self.limit)
        return self._true and not before


def _meant(asked: str, variables: Mapping[str, Variable]) -> str:
    """Return the name of the only variable that a user's text means: its exact name, or words that occur in the name or
    at the beginning of the definition; raise PlayerError if none or several match.
    """
    if asked in variables:
        return asked
    words = set(re.findall(r"[^\W_]+", asked.lower()))
    named = {
        name: set(re.findall(r"[^\W_]+", f"{name.replace('_', ' ')} {one.long_name.split(',')[0]}".lower()))
        for name, one in variables.items()
    }
    found = [name for name, own in named.items() if words <= own]
    if len(found) == 1:
        return found[0]
    if found:
        raise PlayerError(f"{asked!r} may be any of {', '.join(found)}")
    raise PlayerError(f"there is no live value {asked!r}; there are {', '.join(variables)}")


def _factor(variable: Variable, unit: str) -> float:
    """Return the factor that converts values of a variable from the unit of the data set to a unit typed by the user,
    such as "mm2"; raise PlayerError if the variable is not measured in that unit.
    """
    shown, own = variable.shown_unit, "" if variable.units == "1" else variable.units
    known = {own: 1.0} | {one.name: one.factor for one in (shown, shown.percent) if one}
    factors = {_plain(name): factor for name, factor in known.items()}
    if _plain(unit) not in factors:
        units = " or ".join(repr(one or "no unit") for one in known)
        given = f"not in {unit!r}" if unit else "and the condition gives no unit"
        raise PlayerError(f"{variable.name} is measured in {units}, {given}")
    return factors[_plain(unit)]


def _plain(unit: str) -> str:
    """Return a unit as it is typed on any keyboard: mm2 for mm² and mm^2, um for µm, deg for °."""
    return unit.translate(str.maketrans("²³µμ", "23uu", "^")).replace("°", "deg")
