"""Exhaustive search for points of a key frame that moved further than registration can follow."""

import torch
from torch import Tensor, nn

from fingerflow.ops.tracking.search import search_and_return


class SearchGraph(nn.Module):
    """Module that searches for points around predicted positions and verifies each match by a backward search.

    The settings are those of `ops.track_points`.
    """

    def __init__(self, window: int = 25, radius: int = 8, forward_backward_limit: float = 1.0) -> None:
        super().__init__()
        self.window = window
        self.radius = radius
        self.forward_backward_limit = forward_backward_limit

    def forward(
        self, key_view: Tensor, topography_view: Tensor, points: Tensor, prediction: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Search a view for key-frame points (B, N, 2) px around predicted positions, and verify each match.

        Views are (B, 1, H, W).

        Returns:
            Positions (B, N, 2) px, accurate to about a pixel, and (B, N) bool, True where the backward search returns
            to the point.
        """
        batch, count = points.shape[:2]
        image = torch.arange(batch, device=points.device)[:, None].expand(batch, count).flatten()
        given = (points.flatten(0, 1), prediction.flatten(0, 1), self.window, self.radius)
        places, returns = search_and_return(key_view, topography_view, image, *given, self.forward_backward_limit)
        return places.unflatten(0, (batch, count)), returns.unflatten(0, (batch, count))
