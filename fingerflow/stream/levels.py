"""Thresholds and medians from a histogram of 256 levels, without branches and in the precision of the counts."""

from typing import NamedTuple

import torch
from torch import Tensor

LEVELS = 256


class Classes(NamedTuple):
    """Otsu's threshold (B,) in levels, NaN where there is one level only; the means of the levels up to it and above
    it, and the deviation of the former, of which the threshold says whether they mean anything."""

    threshold: Tensor
    lower: Tensor
    upper: Tensor
    deviation: Tensor


def otsu_classes(counts: Tensor) -> Classes:
    """Otsu's two classes (1979, eq. 18) of counts (B, 256). Of thresholds that are equally good the lowest is taken."""
    centre = (LEVELS - 1) / 2  # moments about the middle level, so that float32 holds them
    level = torch.arange(LEVELS, dtype=counts.dtype, device=counts.device) - centre
    share = counts / counts.sum(1, keepdim=True).clamp_min(1)
    below, moment = share.cumsum(1), (share * level).cumsum(1)
    square = (share * level * level).cumsum(1)
    product = below * (1 - below)
    two = product > 1e-6
    offset = moment - moment[:, -1:] * below
    between = torch.where(two, offset * offset / torch.where(two, product, 1.0), 0.0)
    best = between.argmax(1, keepdim=True)
    part = below.gather(1, best).clamp(1e-6, 1 - 1e-6)
    lower = moment.gather(1, best) / part
    upper = (moment[:, -1:] - moment.gather(1, best)) / (1 - part)
    deviation = (square.gather(1, best) / part - lower * lower).clamp_min(0).sqrt()
    threshold = torch.where(two.gather(1, best), best.to(counts.dtype), torch.nan)
    results = (threshold, lower + centre, upper + centre, deviation)
    return Classes(*(result.squeeze(1) for result in results))


def median_level(counts: Tensor) -> Tensor:
    """Median (B,) of levels spread evenly over the unit around each, from counts (B, 256) (`ops.median_of_counts`)."""
    total = counts.sum(1, keepdim=True)
    reached = counts.cumsum(1)
    place = (reached < total / 2).to(counts.dtype).sum(1, keepdim=True).clamp(max=LEVELS - 1)
    index = place.to(torch.int64)
    own = counts.gather(1, index)
    before = reached.gather(1, index) - own
    return (place - 0.5 + (total / 2 - before) / own.clamp_min(1)).squeeze(1)
