"""Displacement gradients, areas and shape quality of triangles between tracked points."""

import torch
from torch import Tensor

from fingerflow.ops.fields.scattered import check_scattered, result_dtype, working_dtype

MINIMUM_QUALITY = 0.1


def triangle_gradients(
    points: Tensor, triangles: Tensor, values: Tensor, *, minimum_quality: float = MINIMUM_QUALITY
) -> Tensor:
    """Return the gradient (B, M, C, 2), on each of M triangles, of values (B, N, C) at points, interpolated linearly
    between the triangle's corners (the constant-strain triangle).

    Computed in float32 or wider, from edge vectors only, so that only the rounding of the positions depends on the
    distance from the origin.

    Args:
        points: (B, N, 2) REFERENCE positions (x, y), any length unit L; B may be 1 for all frames. From current
            positions, a Green-Lagrange strain would be wrong by the strain itself.
        triangles: (M, 3) indices of points, the same for the whole batch, either orientation.
        values: (B, N, C), for a displacement (u, v) in L.
        minimum_quality: limit of `triangle_quality` in [0, 1]; flatter triangles amplify the noise of their points too
            much. 0.1 is a height of 4 % of the longest edge for an obtuse sliver.

    Returns:
        (B, M, C, 2): `[..., i, j]` is d value_i / d x_j, in value unit per L. NaN where the triangle is flatter than
        the limit, is collinear, repeats a point, has a NaN or infinite vertex or value, or has an index out of range
        (-1 pads).

    Raises:
        TypeError, ValueError: a dtype, shape or quality limit is invalid.

    Source: the constant-strain triangle, Turner et al., J. Aeronaut. Sci. 23, 1956. No compiled twin.

    Convention:
        axes: the last axis of points is (x, y); result[..., i, j] = d value_i / d x_j.
        sign: positive where the value grows along the axis, for either orientation of the triangle.
        pixel centre: not used; points have any unit and origin.
        dtype: widest of the inputs.
        NaN: in a point or its value, makes every triangle with that point NaN.
        border: none, each triangle stands alone.
    """
    check_scattered(points, values)
    if not 0 <= minimum_quality <= 1:
        raise ValueError(f"minimum_quality must lie in [0, 1], found {minimum_quality}")
    dtype = working_dtype(points, values)
    first_edge, second_edge = _edges(points.to(dtype), triangles)
    first_change, second_change = _edges(values.to(dtype), triangles)
    quality = _quality(first_edge, second_edge)
    # Collinear points have quality 0 and must be excluded also with a limit of 0; NaN fails every comparison.
    usable = (quality >= minimum_quality) & (quality > 0)
    usable = usable & (torch.isfinite(first_change) & torch.isfinite(second_change)).all(-1)
    # Replace the values before the division: a NaN in the unused branch would still reach the derivative.
    first_edge, second_edge, first_change, second_change = (
        torch.where(usable[..., None], edge, 0) for edge in (first_edge, second_edge, first_change, second_change)
    )
    determinant = torch.where(usable, _cross(first_edge, second_edge), 1)[..., None]
    x1, y1 = first_edge[..., :1], first_edge[..., 1:]
    x2, y2 = second_edge[..., :1], second_edge[..., 1:]
    along_x = (first_change * y2 - second_change * y1) / determinant
    along_y = (second_change * x1 - first_change * x2) / determinant
    gradient = torch.where(usable[..., None, None], torch.stack((along_x, along_y), dim=-1), torch.nan)
    return gradient.to(result_dtype(points, values))


def triangle_slopes(points: Tensor, triangles: Tensor) -> Tensor:
    """Return the gradients (B, M, 3, 2) of the three linear shape functions of each triangle.

    A shape function is 1 on one corner and 0 on the other two. Gradients are per length unit of points (B, N, 2): with
    values u_k at the corners, `triangle_gradients` is the sum of u_k s_k'. Infinite or NaN for a collinear triangle,
    NaN where a vertex is missing.
    """
    check_scattered(points, points)
    first, second = _edges(points, triangles)
    determinant = _cross(first, second)[..., None]
    of_second = torch.stack((second[..., 1], -second[..., 0]), dim=-1) / determinant
    of_third = torch.stack((-first[..., 1], first[..., 0]), dim=-1) / determinant
    return torch.stack((-of_second - of_third, of_second, of_third), dim=-2)


def triangle_areas(points: Tensor, triangles: Tensor) -> Tensor:
    """Return the areas (B, M) of triangles (M, 3) between points (B, N, 2), in the squared unit of the points.

    They are never negative, and NaN where a vertex is missing.
    """
    check_scattered(points, points)
    return (_cross(*_edges(points.to(working_dtype(points)), triangles)).abs() / 2).to(points.dtype)


def triangle_quality(points: Tensor, triangles: Tensor) -> Tensor:
    """Return the shape quality (B, M) of triangles (M, 3) on points (B, N, 2): 4 sqrt(3) area / (sum of squared edges).

    1 for an equilateral triangle, 0.87 for half a square, 0 for a collinear one, NaN where a vertex is not finite or
    missing. It is invariant to scale, position, rotation and orientation.
    Source: Bank & Smith, SIAM J. Numer. Anal. 34 (1997) 979, their function q(t).
    """
    check_scattered(points, points)
    return _quality(*_edges(points.to(working_dtype(points)), triangles)).to(points.dtype)


def _edges(per_point: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor]:
    """Return the differences (B, M, C) of point values along two edges of each triangle, both from its first vertex.

    The values are (B, N, C). The differences are NaN where a vertex is missing.
    """
    if triangles.dim() != 2 or triangles.shape[1] != 3:
        raise ValueError(f"triangles must have shape (M, 3), found {tuple(triangles.shape)}")
    if triangles.dtype.is_floating_point or triangles.dtype == torch.bool:
        raise TypeError(f"triangles must be integer indices, found {triangles.dtype}: convert with .long()")
    # Append a NaN point that takes the place of indices out of range, so that negative indices do not wrap around.
    count = per_point.shape[1]
    absent = per_point.new_full((per_point.shape[0], 1, per_point.shape[2]), torch.nan)
    indices = triangles.long()
    indices = torch.where((indices >= 0) & (indices < count), indices, count)
    first, second, third = torch.cat((per_point, absent), dim=1)[:, indices].unbind(dim=2)
    return second - first, third - first


def _cross(first: Tensor, second: Tensor) -> Tensor:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def _quality(first: Tensor, second: Tensor) -> Tensor:
    squares = (first.square() + second.square() + (second - first).square()).sum(-1)
    quality = 2 * 3**0.5 * _cross(first, second).abs() / torch.where(squares == 0, 1, squares)
    return torch.where(torch.isfinite(quality), quality, torch.nan)
