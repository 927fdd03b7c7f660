"""Dictionary of outputs: every variable with its unit, definition, equation and stage."""

from typing import Any

from fingerflow.pipeline.stages import all_stages
from fingerflow.schema.variables import STREAM


def dictionary() -> list[dict[str, Any]]:
    """Return a row for each result variable, in the order of the stages that compute them.

    `units` are those of the data set, `shown_unit` that of figures, reports and pages, "" if dimensionless; `stage` is
    "stream" for variables that only a stream has; `unasked` is True for what is computed without being requested by
    name; `needs` are the keys that the scene must have for it; `flags` the meanings of the values 0, 1, 2 ...
    """
    stages = [(stage.name, stage.gives, stage.needs) for stage in all_stages()]
    return [
        {
            **{"name": variable.name, "units": variable.units, "shown_unit": variable.shown_unit.name},
            **{"dimensions": variable.dims, "stage": stage, "definition": variable.long_name},
            **{"equation": variable.equation, "unasked": variable.unasked},
            **{"needs": tuple(dict.fromkeys((*keys, *variable.needs))), "flags": variable.flags},
        }
        for stage, variables, keys in (*stages, ("stream", STREAM, ()))
        for variable in variables
    ]


def unit_note(row: dict[str, Any]) -> str:
    """Return ", shown in" and the unit of figures where that is not the unit of the data set; "" where it is."""
    return "" if row["shown_unit"] in ("", row["units"]) else f", shown in {row['shown_unit']}"


def as_text(row: dict[str, Any]) -> str:
    """Return a description of a variable in three or four lines of plain text."""
    unit, dimensions = f"{row['units']}{unit_note(row)}", ", ".join(row["dimensions"])
    note = "" if row["unasked"] else ", only where it is named"
    flags = ", ".join(f"{value} {meaning}" for value, meaning in enumerate(row["flags"]))
    first = f"{row['name']}  [{unit}]  ({dimensions})  stage {row['stage']}{note}"
    return "\n    ".join(filter(None, (first, row["definition"], row["equation"], flags)))
