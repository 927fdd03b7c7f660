"""kornia's `ImageRegistrator` on a window around each point, as kornia has no tracker of points."""

from functools import partial
from typing import Any

import torch
from kornia.geometry.transform import BaseModel, HomographyWarper, ImageRegistrator
from torch import Tensor
from torch.nn import functional

from bench.trackers import Found
from fingerflow.ops.filters.windows import cut_windows

# Found by trial at a noise of 2 grey levels, 21 px: 20 steps leave 1.43 of the bound, 30 leave 1.31, 40 leave 1.30;
# Adam is at 1.5 after 20 and at 2.4 after 40, linear interpolation ends at 2.0.
_STEPS, _FIRST_STEP = 30, 0.015
_MARGIN = 2  # px of zero weight around the window, which a warped picture shows in place of its outside


def track_kornia(previous: Tensor, current: Tensor, points: Tensor, window: int = 21) -> Found:
    """Track points by registering their windows with translations, all in one call; accept every point.

    Motion is below 2 px. Rprop minimises the squared difference of the windows, summed both ways by `ImageRegistrator`.
    """
    side = window + 2 * _MARGIN
    inside = functional.pad(torch.ones(window, window), (_MARGIN,) * 4)

    def squared(one: Tensor, other: Tensor, reduction: str) -> Tensor:
        return inside * (one - other) ** 2

    model = _Translations(points.shape[1])
    warper: Any = partial(HomographyWarper, mode="bicubic")
    settings: dict[str, Any] = {"lr": _FIRST_STEP, "num_iterations": _STEPS, "tolerance": 0.0}
    registrator = ImageRegistrator(model, torch.optim.Rprop, squared, pyramid_levels=1, warper=warper, **settings)
    registrator.register(_windows(previous, points, side), _windows(current, points, side))
    moved = -model.shift.detach() * side / 2
    return Found(points + moved, torch.ones(points.shape[1], dtype=torch.bool))


class _Translations(BaseModel):
    """Translations (N, 2) of N windows, each in coordinates from -1 to 1."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.shift = torch.nn.Parameter(torch.zeros(count, 2))

    def reset_model(self) -> None:
        torch.nn.init.zeros_(self.shift)

    def forward(self) -> Tensor:
        return self._matrices(self.shift)

    def forward_inverse(self) -> Tensor:
        return self._matrices(-self.shift)

    def _matrices(self, shift: Tensor) -> Tensor:
        column = torch.cat((shift, torch.ones(len(shift), 1)), dim=1)
        return torch.cat((torch.eye(3)[:, :2].expand(len(shift), 3, 2), column[..., None]), dim=2)


def _windows(image: Tensor, points: Tensor, side: int) -> Tensor:
    """Return grey levels (N, 1, side, side) from 0 to 1 around the pixels of points (1, N, 2)."""
    corner = points[0].round().long() - side // 2
    return cut_windows(image.float(), torch.zeros_like(corner[:, 0]), corner, side)[:, None] / 255
