"""Weighted sums over the scattered points around each query position, from which a local fit is computed."""

from typing import NamedTuple

import torch
from torch import Tensor

# Number of elements of one (batch, queries, points) matrix. About ten such matrices exist at a time, small enough to
# stay in the cache.
_CHUNK_ELEMENTS = 2**18


class WeightedMoments(NamedTuple):
    """Weighted sums (moments) over the usable points around each of Q query positions, of offsets, values and noise
    variances of the points, from which a plane fit follows.

    Here d = point - query, and the weight is w = (1 - (|d| / R)^2)^2 within the radius R, 0 beyond; v and s are the
    values and the noise of the points.
    """

    point_count: Tensor  # (B, Q) number of points within R
    mass: Tensor  # (B, Q) sum of w
    first: Tensor  # (B, Q, 2) sum of w d
    second: Tensor  # (B, Q, 3) sums of w dx dx, w dx dy, w dy dy
    data: Tensor  # (B, Q, 3, C) sums of w v, w dx v, w dy v
    noise: Tensor | None  # (B, Q, 6, V) sums of w^2 s times 1, dx, dy, dx dx, dx dy, dy dy


def weighted_moments(
    points: Tensor, queries: Tensor, usable: Tensor, values: Tensor, noise: Tensor | None, radius: float
) -> WeightedMoments:
    """Compute weighted sums of positions, values v (B, N, C) and noise variances s (B, N, V) around each query
    position.

    Points that are not `usable` (B, N) do not count. Points (B, N, 2) and queries (B, Q, 2) must be finite, and values
    and noise 0 where a point is not usable; batches may be 1. Queries are processed in pieces of bounded size.
    """
    geometries = torch.broadcast_shapes(points.shape[:1], queries.shape[:1])[0]
    shared = geometries == 1
    mask = usable[..., None].to(values.dtype)
    present = _Columns(mask, shared)
    present_and_data = _Columns(torch.cat((mask, values), dim=-1), shared)
    noise_columns = None if noise is None else _Columns(noise, shared)

    rows = max(1, _CHUNK_ELEMENTS // max(1, geometries * points.shape[1]))
    point_x, point_y = (coordinate[:, None, :].contiguous() for coordinate in points.unbind(-1))
    query_x, query_y = (coordinate[:, :, None].contiguous() for coordinate in queries.unbind(-1))
    constant, scale = points.new_ones(()), -1 / radius**2
    components, noises = values.shape[2], 0 if noise is None else noise.shape[2]
    widths = [1] * 4 + [1 + components] * 3 + [noises] * 6
    batch = torch.broadcast_shapes((geometries,), values.shape[:1])[0]
    # Write pieces into one tensor: small results kept between the large matrices would fragment the heap.
    sums = values.new_empty(batch, queries.shape[1], sum(widths))
    for start in range(0, queries.shape[1], rows):
        # Use differences to the query instead of raw moments, which lose the digits of points far from the origin.
        dx = point_x - query_x[:, start : start + rows]
        dy = point_y - query_y[:, start : start + rows]
        # Exact for whole numbers, so that points on the rim are never counted as within it.
        squared = torch.addcmul(dx * dx, dy, dy)
        closeness = torch.add(constant, squared, alpha=scale).clamp(min=0)
        weight = closeness * closeness
        weight_x, weight_y = weight * dx, weight * dy
        inside = (squared < radius**2).to(values.dtype)
        piece = [present.summed(kernel) for kernel in (inside, weight_x * dx, weight_x * dy, weight_y * dy)]
        piece += [present_and_data.summed(kernel) for kernel in (weight, weight_x, weight_y)]
        if noise_columns is not None:
            piece += [noise_columns.summed(weight * kernel) for kernel in (weight, weight_x, weight_y)]
            piece += [noise_columns.summed(weight_x * kernel) for kernel in (weight_x, weight_y)]
            piece += [noise_columns.summed(weight_y * weight_y)]
        sums[:, start : start + rows] = torch.cat(piece, dim=-1)

    count, xx, xy, yy, plain, along_x, along_y, *noisy = sums.split(widths, dim=-1)
    return WeightedMoments(
        point_count=count[..., 0],
        mass=plain[..., 0],
        first=torch.stack((along_x[..., 0], along_y[..., 0]), dim=-1),
        second=torch.cat((xx, xy, yy), dim=-1),
        data=torch.stack((plain[..., 1:], along_x[..., 1:], along_y[..., 1:]), dim=-2),
        noise=None if noise is None else torch.stack(noisy, dim=-2),
    )


class _Columns:
    """Data of N points arranged as a matrix, whose product with weights (G, Q, N) gives the weighted sums of the data
    around Q query positions.

    Data are (B, N, F), weights (G, Q, N). If one geometry serves all frames (G = 1), the frames are concatenated as
    columns of one matrix product.
    """

    def __init__(self, data: Tensor, shared: bool) -> None:
        self.batch, points, self.features = data.shape
        self.shared = shared
        self.matrix = data.transpose(0, 1).reshape(1, points, self.batch * self.features) if shared else data

    def summed(self, kernel: Tensor) -> Tensor:
        total = kernel @ self.matrix
        if not self.shared:
            return total
        return total.reshape(kernel.shape[1], self.batch, self.features).transpose(0, 1)
