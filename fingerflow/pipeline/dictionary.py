"""Dictionary of outputs: every variable with its unit, definition, equation and stage."""

from typing import NamedTuple

from fingerflow.pipeline.stages import all_stages
from fingerflow.schema.variables import STREAM


class DictionaryEntry(NamedTuple):
    """Entry of the dictionary: unit, definition, equation and stage of one result variable.

    Attributes:
        units: of the data set; ``shown_unit`` that of figures, reports and pages, "" if dimensionless.
        stage: name of the stage that computes it; "stream" for variables that only a stream has.
        unasked: True if it is computed without being requested by name.
        needs: keys that the scene must have for it.
        flags: meanings of the values 0, 1, 2 ...
    """

    name: str
    units: str
    shown_unit: str
    dimensions: tuple[str, ...]
    stage: str
    definition: str
    equation: str
    unasked: bool
    needs: tuple[str, ...]
    flags: tuple[str, ...]

    @property
    def unit_note(self) -> str:
        """Return ", shown in" and the unit of figures where that is not the unit of the data set; "" where it is."""
        return "" if self.shown_unit in ("", self.units) else f", shown in {self.shown_unit}"

    def __str__(self) -> str:
        """Return a description of the variable in three or four lines of plain text."""
        note = "" if self.unasked else ", only where it is named"
        lines = [
            f"{self.name}  [{self.units}{self.unit_note}]  ({', '.join(self.dimensions)})  stage {self.stage}{note}",
            f"    {self.definition}",
            f"    {self.equation}",
        ]
        if self.flags:
            lines.append("    " + ", ".join(f"{value} {meaning}" for value, meaning in enumerate(self.flags)))
        return "\n".join(lines)


def dictionary() -> tuple[DictionaryEntry, ...]:
    """Return the descriptions of all result variables, in the order of the stages that compute them."""
    stages = [(stage.name, stage.gives, stage.needs) for stage in all_stages()]
    entries = []
    for stage, variables, keys in (*stages, ("stream", STREAM, ())):
        for variable in variables:
            shape = variable.name, variable.units, variable.shown_unit.name, variable.dims
            needs = tuple(dict.fromkeys((*keys, *variable.needs)))
            meaning = stage, variable.long_name, variable.equation, variable.unasked
            entries.append(DictionaryEntry(*shape, *meaning, needs, variable.flags))
    return tuple(entries)
