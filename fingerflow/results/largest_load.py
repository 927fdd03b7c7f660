"""Frame of a result with the largest load."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def frame_of_largest(
    result: xr.Dataset,
    names: Sequence[str] = ("normal_force", "gross_contact_area"),
    among: NDArray[np.bool_] | None = None,
) -> int | None:
    """Return the index of the frame in which the first of the variables `names` that has a value above 0 is largest;
    None if none of them has.

    Args:
        result: data set of a trial.
        names: variables with one value per frame.
        among: (F,) mask of the frames that are compared; None for all.
    """
    for name in names:
        if name in result:
            values = np.nan_to_num(np.asarray(result[name].values, dtype=np.float64))
            values = values if among is None else np.where(among, values, 0.0)
            if values.max(initial=0.0) > 0:
                return int(np.argmax(values))
    return None
