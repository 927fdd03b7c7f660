"""Types of the arrays of points, frames and pictures."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Field = NDArray[np.float32]  # (rows, columns, ...)
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]  # indices of frames, points or cells
Picture = NDArray[np.floating]  # (h, w)
Points = NDArray[np.float64]  # (..., 2)
Series = NDArray[np.float64]
