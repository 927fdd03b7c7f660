"""Live values: the numbers of a frame that outputs send and conditions compare, taken from its record."""

from collections.abc import Sequence
from dataclasses import replace

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.records import RecordLayout
from fingerflow.schema.variable_record import LABELS
from fingerflow.schema.variables import FRAME, VARIABLES

_STAMPED = {"frame", "time"}  # fields of a record that are in the stamp of a message already


class LiveValues:
    """Live values of a frame (the numbers that outputs send) by name: scalars of its record, and components of vectors
    such as `ellipse_center_x`.

    Attributes:
        variables: definition of each value.
    """

    def __init__(self, layout: RecordLayout) -> None:
        self._places: dict[str, tuple[str, int | tuple[()]]] = {}
        for name in (entry["name"] for entry in layout.fields if entry["name"] not in _STAMPED):
            dims = VARIABLES[name].dims
            if dims == FRAME:
                self._places[name] = name, ()
            elif len(dims) == 2 and dims[1] in LABELS:
                self._places |= {f"{name}_{label}": (name, index) for index, label in enumerate(LABELS[dims[1]])}
        self.variables = {name: replace(VARIABLES[field], name=name) for name, (field, _) in self._places.items()}

    def value_units(self, names: Sequence[str] | None) -> dict[str, str]:
        """Return the units of the live values with these names, or of all for None, by name; raise PlayerError for an
        unknown name.
        """
        for name in names or ():
            if name not in self.variables:
                raise PlayerError(f"--values: there is no live value {name!r}; there are {', '.join(self.variables)}")
        return {name: self.variables[name].units for name in names or self.variables}

    def flatten(self, record: Array) -> dict[str, float]:
        """Return the live values of a frame by name, taken from its record: scalar results and vector components."""
        return {name: float(record[field][index]) for name, (field, index) in self._places.items()}
