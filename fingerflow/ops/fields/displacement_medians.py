"""Median displacement over the area of the contact, and its standard deviation."""

import torch
from torch import Tensor

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.kernels.tensors import Twin, twin

_TINY = 1e-30
_compiled: Twin[tuple[Tensor, Tensor]] = twin("displacement_medians")
_LATTICE = torch.from_numpy(limits.lattice())


def displacement_medians(
    position: Tensor, displacement: Tensor, variance: Tensor, ellipse: FrameEllipse, *, reach: float, border_std: float
) -> tuple[Tensor, Tensor]:
    """Return the medians (B, 2) of the displacements of N points over the area of the contact, by component, and their
    standard deviations (B, 2), in the length unit L of all arguments.

    Each part of the area counts with the displacement of the nearest point, up to `reach` from it, in lengths that the
    axes of the ellipse scale. A median over the points would differ, since they crowd where skin has texture. As for
    the fields (`area_medians`), a median is NaN where less than 0.85 of the area is known, and where there is no
    contact.

    The deviation is half the difference of the quantiles at 1/2 +- d, with what errors of the points near the median
    add (Tukey's biweight about the median, squared). d^2 is the sum of the squares of three ranks, as shares of the
    area: half of the rim as wide as `border_std`; (1 - s) / (2 s sqrt(3)) for a known share s, as the median of all may
    lie anywhere between; and sqrt(sqrt(N) / 6) / N for N points, 2 sqrt(N) of whose areas the line of the median
    crosses anywhere. Compiled twin: `kernels/displacement_medians.cpp`.

    Args:
        position: (B, N, 2) float64 of the points.
        displacement: (B, N, 2) float64, NaN where it is not known.
        variance: (B, N) float64 of a component of it.
        ellipse: of the apparent contact in these frames, float64.
        reach: largest distance to the nearest point.
        border_std: standard deviation of the position of the border.
    """
    center, axes, angle = ellipse
    ellipses = torch.cat((center, axes, angle.cos()[:, None], angle.sin()[:, None]), dim=1)
    points = position, displacement, variance, ellipses, _LATTICE
    if _compiled.serves(*points):
        return _compiled(*points, reach, border_std, limits.LEAST_SHARE, limits.REACH)
    frames = [_of_frame(*frame, reach, border_std) for frame in zip(*points[:4], strict=True)]
    medians, deviations = (torch.stack(values) for values in zip(*frames, strict=True))
    return medians, deviations


def _of_frame(
    position: Tensor, displacement: Tensor, variance: Tensor, ellipse: Tensor, reach: float, border_std: float
) -> tuple[Tensor, Tensor]:
    """Return the medians (2,) and deviations (2,) of one frame; `ellipse` (6,) has centre, axes, cosine and sine."""
    center, axes, (cosine, sine) = ellipse.split(2)
    unknown = torch.full((2,), torch.nan, dtype=position.dtype, device=position.device)
    known = (position.sum(1) + displacement.sum(1) + variance).isfinite()
    if not bool(ellipse.isfinite().all() and (axes > 0).all() and known.any()):
        return unknown, unknown
    displacement, variance, (right, down) = displacement[known], variance[known], (position[known] - center).T
    on_disc = torch.stack((right * cosine + down * sine, down * cosine - right * sine), dim=1) / axes
    distance, nearest = torch.cdist(_LATTICE.to(on_disc), on_disc, compute_mode="donot_use_mm_for_euclid_dist").min(1)
    area = nearest[distance < reach / axes.prod().sqrt()].bincount(minlength=len(on_disc)).to(on_disc.dtype)
    total = area.sum()
    share = total / len(nearest)
    if share < limits.LEAST_SHARE:
        return unknown, unknown
    counts = area > 0
    area, displacement, variance = area[counts, None], displacement[counts], variance[counts, None]
    rim = 1 - (axes - border_std).clamp_min(0).prod() / axes.prod()
    rank = ((rim / 2) ** 2 + ((1 - share) / (2 * share)) ** 2 / 3 + len(area) ** -1.5 / 6).sqrt()
    ordered, order = displacement.sort(dim=0)
    parts = area[order, 0]
    below = ((parts.cumsum(0) - parts / 2) / total).T.contiguous()
    ranks = (0.5 + rank * torch.arange(-1, 2, device=area.device)).expand(2, 3).contiguous()
    after = torch.searchsorted(below, ranks)
    left, right = (after - 1).clamp(0, len(area) - 1), after.clamp(max=len(area) - 1)
    (low, high), (start, end) = (
        [values.gather(1, side) for side in (left, right)] for values in (below, ordered.T.contiguous())
    )
    low, middle, high = (start + ((ranks - low) / (high - low).clamp_min(_TINY)).clamp(0, 1) * (end - start)).T
    half = (high - low) / 2
    near = (displacement - middle) ** 2 / (variance + half**2 + _TINY)
    weight = area * (1 - near / limits.REACH**2).clamp_min(0) ** 2
    noise = (weight**2 * variance).sum(0) / weight.sum(0).clamp_min(_TINY) ** 2
    return middle, (noise + half**2).sqrt()
