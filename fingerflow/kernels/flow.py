"""Kernels of dense optical flow on float32 arrays.

What does not fit the declaration of a kernel raises TypeError (wrong dtype) or ValueError.
"""

from collections.abc import Sequence

import numpy as np

from fingerflow.kernels.arrays import KINDS, Array, address, in_one_piece
from fingerflow.kernels.kernel import values_are_known
from fingerflow.kernels.library import compiled

# Channels of tensor, right, down, inverse and inside; then their numbers of rows and columns minus those of the level.
_PLANES = ((3, 0, 0), (1, 0, -1), (1, -1, 0), (3, 0, 0), (1, 0, 0))


def flow_descend(
    planes: Sequence[Array],
    pull: Array,
    flow: Array,
    known: Array,
    weights: Sequence[float],
    cycles: int,
    sweeps: int,
    coarsest: int,
    damping: float,
) -> Array:
    """Improve a dense optical flow (B, 2, H, W) by multigrid cycles on the linear system whose levels are `planes`, as
    `ops.flow.flow_multigrid.descended` up to rounding.

    `planes` are five for each level, the finest first: tensor, right, down, inverse, inside. `weights` are
    those of the window for the trend of the flow, an odd number, the same before the middle as after it.
    """
    batch, _, height, width = pull.shape
    if not planes or len(planes) % len(_PLANES):
        raise ValueError(f"{len(planes)} planes: there are {len(_PLANES)} of each level")
    if len(weights) % 2 == 0 or any(one != other for one, other in zip(weights, reversed(weights), strict=True)):
        raise ValueError(f"weights {list(weights)}: give an odd number, the same before the middle as after it")
    kept, levels = [], []  # arrays of the C structure `fingerflow_flow_level`: addresses of the planes, and the sizes
    for first in range(0, len(planes), len(_PLANES)):
        for plane, (channels, rows, columns) in zip(planes[first : first + len(_PLANES)], _PLANES, strict=True):
            if plane.shape != (batch, channels, height + rows, width + columns):
                raise ValueError(f"a level has a plane of {tuple(plane.shape)} in {height} x {width} cells")
            if KINDS[plane.dtype] != "float32":
                raise TypeError(f"a plane is {KINDS[plane.dtype]}: float32 is needed")
            kept.append(in_one_piece(plane))
        addresses = [address(plane) if values_are_known() else 0 for plane in kept[first:]]
        levels.append([*addresses, height, width])
        height, width = (height + 1) // 2, (width + 1) // 2
    return compiled("flow_descend")(
        **{"pull": pull, "flow": flow, "known": known, "cycles": cycles, "sweeps": sweeps, "coarsest": coarsest},
        **{"levels": np.array(levels, np.int64), "half": len(weights) // 2, "damping": damping},
        weights=np.array(weights[len(weights) // 2 :], np.float32),
    )
