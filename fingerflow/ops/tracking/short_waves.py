"""Correction of tracked points for a deformation of the skin that varies over a few windows.

`correct_points` fits the deformation over a gauge length. One of five windows keeps the noise low and averages short
waves away; one of two windows follows them, and adds noise. Of the difference between both corrections the share is
taken that is signal (Wiener filter): with E the mean square of the difference around a point, and V the variance that
noise alone gives it, that is 1 - 2 V / E, or 0 if this is negative. V follows from the covariance of the points by
Hutchinson's (1990) estimator: noise of this size and random sign is corrected as the points are. The signs are a hash
of a point's position: neither the order of the points nor the state of a random generator changes the result.

No compiled twin of its own: it calls `correct_points`.
"""

import torch
from torch import Tensor

from fingerflow.kernels.result_records import CorrectedPoints
from fingerflow.ops.fields.point_gradients import neighbour_planes
from fingerflow.ops.tensors import finite
from fingerflow.ops.tracking.deformation import correct_points

WIDE = 5.0  # windows, gauge length of the correction
_NARROW = 2.0  # windows, gauge length of the second one
_AROUND = 4.0  # windows, diameter over which mean squares are taken
# Of the hash, radians a px along x and y: two fields of random sign for u and two for v, which with the neighbours are
# about a hundred values for each variance. The factor spreads neighbouring sines.
_HASHES = ((12.9898, 78.233), (39.3467, 11.1351), (73.1561, 52.2352), (26.651, 94.6737))
_SPREAD = 43758.5453
_CAUTION = 2.0  # multiple of V that the mean square of noise around a point hardly ever exceeds


def correct_short_waves(
    wide: CorrectedPoints,
    start: Tensor,
    points: Tensor,
    covariance: Tensor,
    numbers: Tensor,
    inverse_warp: Tensor,
    window: int,
) -> CorrectedPoints:
    """Correct the positions of points with a gauge length of two windows where the displacement changes over a shorter
    distance than the `wide` correction resolves, by more than its noise.

    `wide` is the result of `correct_points` with a gauge length of `WIDE` windows and the same other arguments, one
    image pair in each of K. What is left of a short wave after the narrow correction is about as large as its step, so
    the covariance grows by the mean square of the step.
    """
    if not len(start):
        return wide
    narrow = correct_points(start, points, covariance, numbers, inverse_warp, window, _NARROW * window)
    near = finite(narrow.expected)  # others have too few neighbours
    if not near.any():
        return wide
    step = torch.where(near, narrow.points - wide.points, torch.nan)
    variance = torch.stack([_variance_of_noise(*pair, window) for pair in zip(start, covariance, numbers, strict=True)])
    means, _ = neighbour_planes(start, torch.cat((step.square(), variance), dim=2), _AROUND * window)
    seen, expected = means.split(2, dim=2)
    share = torch.where(finite(step) & (seen > 0), 1 - _CAUTION * expected / seen, 0.0).clamp(0, 1)
    left = share * (seen - expected) + share.square() * expected
    return wide._replace(
        points=wide.points + torch.where(share > 0, share * step, 0.0),
        covariance=wide.covariance + torch.diag_embed(torch.where(share > 0, left, 0.0)),
    )


def _variance_of_noise(start: Tensor, covariance: Tensor, numbers: Tensor, window: int) -> Tensor:
    """Return the variance (N, 2), px^2, of what the narrow correction adds to N points of one image pair by the noise
    of the positions alone; NaN for points that were not found.
    """
    deviation = covariance.diagonal(dim1=1, dim2=2).sqrt()
    x, y = start.double().unbind(1)
    hashed = torch.stack([(by_x * x + by_y * y).sin() * _SPREAD for by_x, by_y in _HASHES])
    signs = (hashed.frac().abs() < 0.5).unflatten(0, (-1, 2)).mT.to(start) * 2 - 1
    still = torch.eye(2, dtype=start.dtype, device=start.device).expand(1, len(start), 2, 2)
    noisy = start + signs * deviation
    inputs = start[None], noisy, covariance.expand(len(signs), *covariance.shape), numbers[None], still
    corrected = correct_points(*inputs, window, _NARROW * window)
    return (corrected.points - noisy).square().mean(0)
