"""Definitions of the columns in a study's table of trials: name, unit and meaning, as listed in `variables.csv`; most
stand in `trial_columns.toml`.

Without a suffix a column is the value shown in figures; with `_at_1n`, `_at_onset` and so on it is the value at that
moment. `_std` is its standard deviation.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from fingerflow.schema.variable_record import SHOWN_UNITS, Variable
from fingerflow.schema.variables import VARIABLES

#: Moments of a trial, with their definitions in `MOMENTS`.
FORCES_N = (1.0, 2.0, 3.0)
AT_ONSET, AT_MAX = "at_onset", "at_max"
MOMENTS = {
    **{f"at_{force:g}n": f"when the normal force first reaches {force:g} N" for force in FORCES_N},
    AT_ONSET: "in the first frame with contact",
    AT_MAX: "at the largest normal force, without forces at the largest gross contact area",
}
_TRIAL = ("trial",)
_LARGEST = "the largest of the trial"


def _at_moments(
    name: str, variable: str, definition: str, has_std: bool = False, largest: bool = False, label: str = ""
) -> Iterator[Variable]:
    """Yield the columns of a quantity that the table of trials lists at several moments of a trial, one per moment; the
    first has no suffix.

    Args:
        name: of the column without a suffix.
        variable: of a result that has the same unit.
        definition: of the quantity.
        has_std: whether it has a standard deviation.
        largest: whether the column without a suffix is the largest value of the trial, else the value at the maximum.
        label: on axes and in tables; "" for the name in words.
    """
    source = VARIABLES[variable]

    def column(name: str, definition: str, label: str = "") -> Variable:
        shown_in = source.shown_in
        return Variable(name, _TRIAL, source.units, definition, shown_in=shown_in, of=(variable,), label=label)

    yield column(name, f"{definition}, {_LARGEST if largest else MOMENTS[AT_MAX]}", label)
    if has_std:
        yield column(f"{name}_std", f"standard deviation of {name}, by the errors of the points")
    for moment, when in MOMENTS.items():
        if moment == AT_MAX and not largest:
            continue
        yield column(f"{name}_{moment}", f"{definition}, {when}")
        if has_std:
            yield column(f"{name}_{moment}_std", f"standard deviation of {name}_{moment}")


_STATED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_QUANTITIES = tuple(tuple(_at_moments(name, **facts)) for name, facts in _STATED["quantities"].items())
#: Variables of a result by the names of the quantities that the table lists at several moments.
AT_MOMENTS = {columns[0].name: columns[0].of[0] for columns in _QUANTITIES}
_OF_TRIAL = tuple(
    Variable(name, _TRIAL, shown_in=SHOWN_UNITS.get(facts.pop("shown_in", "")), **facts)
    for name, facts in _STATED["trial"].items()
)
#: Areas that are also given relative to their median over the participant's trials, when the table is written.
NORMALISED = ("real_contact_area", "gross_contact_area")


#: Numeric columns of the table of trials.
NUMBERS: dict[str, Variable] = {
    column.name: column
    for column in (
        *_OF_TRIAL,
        *(column for columns in _QUANTITIES for column in columns),
        *(
            Variable(f"{name}_normalised", _TRIAL, "1", f"{name} over its median in the participant's trials")
            for name in NORMALISED
        ),
    )
}
#: Differences from the reference trial, added when the table is written, for trials that name one.
DIFFERENCE = "_difference"
DIFFERENCES: dict[str, Variable] = {
    f"{name}{DIFFERENCE}": replace(
        NUMBERS[name], name=f"{name}{DIFFERENCE}", long_name=f"{NUMBERS[name].long_name}; less that of the reference"
    )
    for name in (*(column.name for column in _OF_TRIAL), *AT_MOMENTS)
}
#: Columns of the table of trials that are not numeric.
FACTS = {name: Variable(name, _TRIAL, "1", meaning) for name, meaning in _STATED["facts"].items()}
OF_RESULTS = frozenset((*NUMBERS, *DIFFERENCES, *FACTS)) - {"recording"}
