"""Residual displacement after subtraction of the rigid motion of the finger: a measure of incipient slip.

Orthogonal Procrustes problem in the plane, in closed form (Schönemann 1966). No compiled twin.
"""

import torch
from torch import Tensor

from fingerflow.ops.fields.scattered import check_batches, check_scattered, result_dtype, working_dtype
from fingerflow.ops.tensors import finite


def rigid_residual(points: Tensor, displacement: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return the displacement (B, N, 2) minus the rigid motion that best fits the points of each frame.

    The motion, one rotation and one translation, minimises the weighted sum of squared residuals (Procrustes, closed
    form in the plane). A point with a non-finite position or displacement is ignored in the fit and has a residual of
    NaN. A point with a non-finite weight is ignored in the fit only. A frame with fewer than two distinct points, which
    do not determine the rotation, is NaN throughout. Computed in float32 or wider.

    Args:
        points: (B, N, 2) reference positions, any length unit L; B may be 1 for all frames.
        displacement: (B, N, 2) in L.
        weights: (B, N), not negative; equal by default. A point of weight 0 is ignored in the fit, but has a residual.

    Raises:
        TypeError, ValueError: a dtype or shape is invalid.
    """
    check_scattered(points, displacement)
    if displacement.shape[2] != 2:
        raise ValueError(f"displacement must have shape (B, N, 2), found {tuple(displacement.shape)}")
    dtype = working_dtype(points, displacement)
    # Use separate tensors for the components: torch is several times as slow if the last axis is short.
    (place_x, place_y), (moved_x, moved_y) = (values.to(dtype).unbind(-1) for values in (points, displacement))
    present = finite(place_x + place_y) & finite(moved_x + moved_y)
    components = place_x, place_y, moved_x, moved_y
    place_x, place_y, moved_x, moved_y = (torch.where(present, values, 0) for values in components)
    mass = present.to(dtype)
    if weights is not None:
        if weights.dim() != 2 or weights.shape[1] != points.shape[1]:
            raise ValueError(f"weights must have shape (B, {points.shape[1]}) as points, found {tuple(weights.shape)}")
        check_batches(points=points, displacement=displacement, weights=weights)
        mass = mass * torch.where(torch.isfinite(weights), weights, 0).to(dtype)

    # Subtract the mean twice: the first mean of coordinates far from the origin is itself rounded.
    x, y = (_centred(_centred(values, mass), mass) for values in (place_x, place_y))
    change_x, change_y = (_centred(values, mass) for values in (moved_x, moved_y))
    # Compute dot and cross product of the positions before and after; the cross product of a position with itself is 0.
    spread = _sum(mass * (x * x + y * y))
    along = spread + _sum(mass * (x * change_x + y * change_y))
    across = _sum(mass * (x * change_y - y * change_x))

    # Treat points that differ by no more than the rounding of their coordinates as one point.
    rounding = torch.finfo(dtype).eps * (place_x.abs() + place_y.abs())
    determined = (spread > _sum(mass * rounding.square())) & ((along != 0) | (across != 0))
    angle = torch.atan2(across, torch.where(determined, along, 1))
    # Compute R - I from the half angle: cos(angle) - 1 would lose the digits of a small rotation.
    less, sine = -2 * torch.sin(angle / 2).square(), torch.sin(angle)
    left = torch.stack((change_x - (less * x - sine * y), change_y - (sine * x + less * y)), dim=-1)
    valid = (present & determined)[..., None]
    return torch.where(valid, left, torch.nan).to(result_dtype(points, displacement))


def _centred(values: Tensor, mass: Tensor) -> Tensor:
    total = _sum(mass)
    return values - _sum(mass * values) / torch.where(total > 0, total, 1)


def _sum(values: Tensor) -> Tensor:
    """Return the sums (B, 1) of values (B, N) over N points."""
    return values.sum(1, keepdim=True)
