"""Kernels of dense flow."""

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from fingerflow.kernels.checks import check_frames, check_like, empty
from fingerflow.kernels.library import entry, values_are_known
from fingerflow.kernels.torch_op import torch_op

__all__ = [
    "flow_cycles",
    "flow_warp",
]

# Of tensor, right, down, inverse and inside: channels, and rows and columns beside those of the level.
_PLANES = ((3, 0, 0), (1, 0, -1), (1, -1, 0), (3, 0, 0), (1, 0, 0))


@torch_op()
def flow_cycles(
    planes: Sequence[Tensor], right_side: Tensor, cycles: int, sweeps: int, coarsest: int, damping: float
) -> Tensor:
    """(B, 2, H, W), as `ops.flow_multigrid.solve` has it to rounding, of the planes of all levels, five of each from
    the finest on: tensor, right, down, inverse, inside, all float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    batch, _, height, width = right_side.shape
    check_like("right_side", right_side, torch.float32, (batch, 2, height, width))
    if not planes or len(planes) % len(_PLANES):
        raise ValueError(f"{len(planes)} planes: there are {len(_PLANES)} of each level")
    numbers, kept = [], []
    for first in range(0, len(planes), len(_PLANES)):
        for plane, (channels, rows, columns) in zip(planes[first:], _PLANES, strict=False):
            check_like("a level", plane, torch.float32, (batch, channels, height + rows, width + columns))
            kept.append(plane.contiguous())
        if values_are_known():
            numbers += [*(plane.data_ptr() for plane in kept[first:]), height, width]
        height, width = (height + 1) // 2, (width + 1) // 2
    right_side, solution = right_side.contiguous(), empty(torch.float32, *right_side.shape)
    levels = (ctypes.c_int64 * len(numbers))(*numbers)  # fingerflow_flow_level, one after the other
    entry("flow_cycles")(
        levels=ctypes.addressof(levels),
        right_side=right_side,
        solution=solution,
        count=len(planes) // len(_PLANES),
        batch=batch,
        cycles=cycles,
        sweeps=sweeps,
        coarsest=coarsest,
        damping=damping,
        threads=torch.get_num_threads(),
    )
    return solution


@torch_op()
def flow_warp(coefficients: Tensor, flow: Tensor) -> Tensor:
    """(B, 1, H, W), the spline of coefficients (B, 1, H, W) at pixels displaced by a finite flow (B, 2, H, W), float32.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    check_frames(coefficients, (torch.float32,))
    batch, _, height, width = coefficients.shape
    check_like("flow", flow, torch.float32, (batch, 2, height, width))
    values = empty(torch.float32, *coefficients.shape)
    entry("flow_warp")(
        coefficients=coefficients.contiguous(),
        flow=flow.contiguous(),
        values=values,
        batch=batch,
        height=height,
        width=width,
        threads=torch.get_num_threads(),
    )
    return values
