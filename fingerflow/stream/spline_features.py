"""The cubic B-spline around a centre: its weights at whole places as functions of the shift.

A table of the whole places -r - 1 to r + 1 serves every shift s in (-r, r). With u = max(2 - |x|, 0) and
v = max(1 - |x|, 0) the B-spline is b3(x) = (u^3 - 4 v^3) / 6; the sixth is left to the constants that it is multiplied
with.
"""

import torch
from torch import Tensor

SCALE = 6


def taps(reach: int) -> int:
    """Places of a table."""
    return 2 * reach + 3


def features(shift: Tensor, reach: int) -> Tensor:
    """SCALE b3(shift - place), (B, taps, K, N) of shifts (B, K, N)."""
    return _values(*_distances(_from_places(shift, reach)))


def features_and_slopes(shift: Tensor, reach: int) -> tuple[Tensor, Tensor]:
    """The same, and its derivatives."""
    beside = _from_places(shift, reach)
    u, v = _distances(beside)
    return _values(u, v), (3 * beside.sign()) * (4 * v * v - u * u)


def feature_bends(shift: Tensor, reach: int) -> Tensor:
    """Second derivatives."""
    u, v = _distances(_from_places(shift, reach))
    return 6 * u - 24 * v


def _from_places(shift: Tensor, reach: int) -> Tensor:
    places = torch.arange(-reach - 1, reach + 2, dtype=shift.dtype, device=shift.device)
    return shift[:, None] - places[:, None, None]


def _distances(beside: Tensor) -> tuple[Tensor, Tensor]:
    u = (2 - beside.abs()).clamp_min(0)
    return u, (u - 1).clamp_min(0)


def _values(u: Tensor, v: Tensor) -> Tensor:
    return u * u * u - 4 * v * v * v
