"""Which standard deviations a result states: none that follows from positions whose errors no residual shows."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fingerflow.results.store import Store
from fingerflow.schema.variables import Variable

# What later stages weight points by stays as it is, and says what it is worth.
_OF_POSITIONS = "position_std_px"
_AT_ONCE = 64  # frames


def stated(known: Mapping[str, Variable], codec: str | None) -> dict[str, Variable]:
    """The variables, of which deviations say in their names that they do not hold.

    A codec that takes frames from each other leaves errors of positions that last and that neighbours share: neither
    residuals nor scatter show them, so that a deviation can not be widened by them; on the press as H.264 22 to 34 % of
    the errors lie within one deviation, for 68 % (`tests/recordings/test_lossy_deviations.py`). What has no known
    deviation has none: NaN, so that no figure, table or test of a hypothesis takes it for one.

    Args:
        known: variables by name.
        codec: that took frames from each other (`Recording.takes_from_other_frames`); None for none.
    """
    if codec is None:
        return dict(known)
    said = {
        name: replace(known[name], long_name=f"{known[name].long_name}: NaN, not known of frames in {codec}")
        for name in _withheld(known)
    }
    position = known[_OF_POSITIONS]
    too_small = f"{position.long_name} by noise alone: 2 to 10 times too small for frames in {codec}"
    return {**known, **said, _OF_POSITIONS: replace(position, long_name=too_small)}


def withhold(store: Store, known: Mapping[str, Variable]) -> None:
    """Makes those deviations NaN; of a position it stays, for what is computed from this result later."""
    for name in _withheld(known):
        if name in store:
            values = store[name]
            for first in range(0, values.shape[0], _AT_ONCE):
                values[first : first + _AT_ONCE] = np.nan


def _withheld(known: Mapping[str, Variable]) -> list[str]:
    return [name for name in known if name.endswith("_std")]
