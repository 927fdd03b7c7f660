"""Weighted sums over the scattered points around each query position, from which a local fit is computed.

They are the sums of the normal equations of `ops.fields.local_fit`; `kernels/local_fit.cpp` contains their compiled
form.
"""

import torch
from torch import Tensor

# Number of elements of one (batch, queries, points) matrix. About ten such matrices exist at a time, small enough to
# stay in the cache.
_CHUNK_ELEMENTS = 2**18


def weighted_moments(
    points: Tensor, queries: Tensor, usable: Tensor, values: Tensor, noise: Tensor | None, radius: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor | None]:
    """Return weighted sums (moments) over the usable points around each of Q query positions, of the points' offsets d
    from the position, values v (B, N, C) and noise variances s (B, N, V), from which a plane fit follows.

    The weight is w = (1 - (|d| / R)^2)^2 within the radius R, 0 beyond. Returned are the number of points within R and
    the sum of w, (B, Q) each; w d (B, Q, 2); w dx dx, w dx dy and w dy dy (B, Q, 3); w v, w dx v and w dy v (B, Q, 3,
    C); and, with noise, w^2 s times 1, dx, dy, dx dx, dx dy and dy dy (B, Q, 6, V).

    Points that are not `usable` (B, N) do not count. Points (B, N, 2) and queries (B, Q, 2) must be finite, and values
    and noise 0 where a point is not usable; batches may be 1. Queries are processed in pieces of bounded size.
    """
    present = usable[..., None].to(values.dtype)
    present_and_data = torch.cat((present, values), dim=-1)
    rows = max(1, _CHUNK_ELEMENTS // max(1, points.shape[0] * points.shape[1], queries.shape[0] * points.shape[1]))
    point_x, point_y = (coordinate[:, None].contiguous() for coordinate in points.unbind(-1))
    query_x, query_y = (coordinate[:, :, None].contiguous() for coordinate in queries.unbind(-1))
    constant, scale = points.new_ones(()), -1 / radius**2
    components, noises = values.shape[2], 0 if noise is None else noise.shape[2]
    widths = [1] * 4 + [1 + components] * 3 + [noises] * 6
    for start in range(0, max(1, queries.shape[1]), rows):
        # Use differences to the query instead of raw moments, which lose the digits of points far from the origin.
        dx = point_x - query_x[:, start : start + rows]
        dy = point_y - query_y[:, start : start + rows]
        # Exact for whole numbers, so that points on the rim are never counted as within it.
        squared = torch.addcmul(dx * dx, dy, dy)
        closeness = torch.add(constant, squared, alpha=scale).clamp(min=0)
        weight = closeness * closeness
        weight_x, weight_y = weight * dx, weight * dy
        inside = (squared < radius**2).to(values.dtype)
        piece = [_summed(kernel, present) for kernel in (inside, weight_x * dx, weight_x * dy, weight_y * dy)]
        piece += [_summed(kernel, present_and_data) for kernel in (weight, weight_x, weight_y)]
        if noise is not None:
            piece += [_summed(weight * kernel, noise) for kernel in (weight, weight_x, weight_y)]
            piece += [_summed(weight_x * kernel, noise) for kernel in (weight_x, weight_y)]
            piece += [_summed(weight_y * weight_y, noise)]
        sums_of_piece = torch.cat(piece, dim=-1)
        if start == 0:
            # Write pieces into one tensor: small results kept between the large matrices would fragment the heap.
            sums = sums_of_piece.new_empty(sums_of_piece.shape[0], queries.shape[1], sum(widths))
        sums[:, start : start + rows] = sums_of_piece

    count, xx, xy, yy, plain, along_x, along_y, *noisy = sums.split(widths, dim=-1)
    first = torch.stack((along_x[..., 0], along_y[..., 0]), dim=-1)
    data = torch.stack((plain[..., 1:], along_x[..., 1:], along_y[..., 1:]), dim=-2)
    noise_sums = None if noise is None else torch.stack(noisy, dim=-2)
    return count[..., 0], plain[..., 0], first, torch.cat((xx, xy, yy), dim=-1), data, noise_sums


def _summed(kernel: Tensor, data: Tensor) -> Tensor:
    """Return the sums (B, Q, F) of data (B, N, F) over N points, with weights (1 or B, Q, N).

    Weights that serve all frames enter one matrix product, with the frames as columns.
    """
    return torch.einsum("qn,bnf->bqf", kernel[0], data) if kernel.shape[0] == 1 else kernel @ data
