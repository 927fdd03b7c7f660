"""What a rigid motion of the whole finger leaves unexplained: the usual sign of incipient slip."""

import torch
from torch import Tensor

from fingerflow.ops.scattered import check_batches, check_scattered, result_dtype, working_dtype


def rigid_residual(points: Tensor, displacement: Tensor, weights: Tensor | None = None) -> Tensor:
    """Displacement (B, N, 2) minus the best rigid motion of the points, one rotation and one translation a frame.

    Args:
        points: (B, N, 2) reference positions, any length unit L; B may be 1 for all frames.
        displacement: (B, N, 2) in L.
        weights: (B, N), not negative; equal by default. A point of weight 0 has no part in the fit, but a residual.

    The motion minimises the weighted sum of squared residuals (Procrustes, closed form in the plane). A point with a
    NaN or infinite position or displacement has no part in the fit and a residual of NaN; one with such a weight has
    no part either. A frame whose points do not determine the rotation (fewer than two distinct ones) is NaN throughout.
    Computed in float32 at least. Raises TypeError or ValueError for a wrong dtype or shape.
    """
    check_scattered(points, displacement)
    if displacement.shape[2] != 2:
        raise ValueError(f"displacement must have shape (B, N, 2), found {tuple(displacement.shape)}")
    dtype = working_dtype(points, displacement)
    positions, moved = points.to(dtype), displacement.to(dtype)
    present = torch.isfinite(positions).all(-1) & torch.isfinite(moved).all(-1)
    positions = torch.where(present[..., None], positions, 0)
    moved = torch.where(present[..., None], moved, 0)
    mass = present.to(dtype)
    if weights is not None:
        if weights.dim() != 2 or weights.shape[1] != points.shape[1]:
            raise ValueError(f"weights must have shape (B, {points.shape[1]}) as points, found {tuple(weights.shape)}")
        check_batches(points=points, displacement=displacement, weights=weights)
        mass = mass * torch.where(torch.isfinite(weights), weights, 0).to(dtype)
    mass = mass[..., None]

    # Centred twice: the first mean of far coordinates is itself rounded.
    centred = _centred(_centred(positions, mass), mass)
    change = _centred(moved, mass)
    x, y = centred.unbind(-1)
    change_x, change_y = change.unbind(-1)
    weight = mass[..., 0]
    # Dot and cross product of the positions before and after; the cross product of a position with itself is left out.
    spread = (weight * (x * x + y * y)).sum(1, keepdim=True)
    along = spread + (weight * (x * change_x + y * change_y)).sum(1, keepdim=True)
    across = (weight * (x * change_y - y * change_x)).sum(1, keepdim=True)

    # Points that differ by no more than the rounding of their coordinates are one point.
    rounding = torch.finfo(dtype).eps * positions.abs().sum(-1)
    determined = (spread > (weight * rounding.square()).sum(1, keepdim=True)) & ((along != 0) | (across != 0))
    angle = torch.atan2(across, torch.where(determined, along, 1))
    # R - I by the half angle: cos(angle) - 1 would lose the digits of a small rotation.
    less, sine = -2 * torch.sin(angle / 2).square(), torch.sin(angle)
    rotated = torch.stack((less * x - sine * y, sine * x + less * y), dim=-1)
    known = (present & determined)[..., None]
    return torch.where(known, change - rotated, torch.nan).to(result_dtype(points, displacement))


def _centred(tensor: Tensor, mass: Tensor) -> Tensor:
    total = mass.sum(1, keepdim=True)
    return tensor - (mass * tensor).sum(1, keepdim=True) / torch.where(total > 0, total, 1)
