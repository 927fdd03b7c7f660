"""A flow on cells led to where the pull of the images and the smoothing of its departure from its course are even.

The fixed point is pull = J (w - w_0) + alpha L (w - M w), w_0 the flow that the pull belongs to. L (1 - M) couples
cells over the whole of the course's window, which multigrid cannot invert. A cycle of it with J + alpha L lowers what
is left over of the whole equation, and the course is taken anew before each. Where ridges run in one direction, one
warp and three cycles so bring nine tenths of the flow to within 0.0023 px of the fixed point, one cycle to 0.013.
"""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.flow.flow_course import WINDOW, course
from fingerflow.ops.flow.flow_multigrid import COARSEST_SWEEPS, DAMPING, SWEEPS, Level, laplacian, times, v_cycle


def descended(levels: list[Level], pull: Tensor, flow: Tensor, known: Tensor, cycles: int) -> Tensor:
    """The flow (B, 2, h, w) after so many cycles.

    Args:
        levels: of the multigrid, the finest that of the flow.
        pull: (B, 2, h, w) of the images at the flow that is given.
        flow: (B, 2, h, w) px; where it is not known it begins with its course.
        known: (B, 1, h, w), 1 or 0: what takes part in the course.
        cycles: at least 1.
    """
    if pull.dtype == torch.float32 and kernels.serve(pull, flow, known, *levels[0]):
        planes = [plane for level in levels for plane in level]
        return kernels.flow_descend(planes, pull, flow, known, WINDOW, cycles, SWEEPS, COARSEST_SWEEPS, DAMPING)
    own = course(flow, known)
    flow = torch.where(known > 0, flow, own)
    step = v_cycle(levels, pull - laplacian(levels[0], flow - own))
    for _ in range(cycles - 1):
        moved = flow + step
        over = laplacian(levels[0], moved - course(moved, known))
        step = step + v_cycle(levels, pull - times(levels[0].tensor, step) - over)
    return flow + step
