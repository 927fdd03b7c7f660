"""Standard deviations in a result, which are set to NaN if lossy video coding hides the position errors."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fingerflow.results.store import Store
from fingerflow.schema.variable_record import Variable

# Name of the only standard deviation that is kept, since later stages weight points by it; its definition then says
# that it is too small.
_OF_POSITIONS = "position_std_px"
_AT_ONCE = 64  # number of frames overwritten at a time


def stated(variables: Mapping[str, Variable], codec: str | None) -> dict[str, Variable]:
    """Return definitions of result variables; for a lossy codec, those of standard deviations say that the
    values are NaN or too small.

    A codec that predicts frames from each other leaves position errors that persist and that neighbours share. Neither
    residuals nor scatter show them, so a deviation cannot be widened to include them. On the press as H.264, 22 to 34 %
    of the errors lie within one deviation instead of 68 % (`tests/recordings/test_lossy_deviations.py`). Unknown
    deviations are NaN, so that no figure, table or hypothesis test uses them.

    Args:
        variables: variables by name.
        codec: codec that predicts frames from each other (`Recording.takes_from_other_frames`); None for none.
    """
    if codec is None:
        return dict(variables)
    restated = {
        name: replace(variables[name], long_name=f"{variables[name].long_name}: NaN, not known of frames in {codec}")
        for name in _withheld(variables)
    }
    position = variables[_OF_POSITIONS]
    too_small = f"{position.long_name} by noise alone: 2 to 10 times too small for frames in {codec}"
    return {**variables, **restated, _OF_POSITIONS: replace(position, long_name=too_small)}


def withhold(store: Store, variables: Mapping[str, Variable]) -> None:
    """Set all standard deviations in a store of results to NaN, except that of positions, which later computations need
    as a weight.
    """
    for name in _withheld(variables):
        if name in store:
            values = store[name]
            for first in range(0, values.shape[0], _AT_ONCE):
                values[first : first + _AT_ONCE] = np.nan


def _withheld(variables: Mapping[str, Variable]) -> list[str]:
    return [name for name in variables if name.endswith("_std")]
