"""Preparation of templates of points in a key frame of the topography view."""

from typing import ClassVar

from torch import Tensor, nn

from fingerflow.ops.tracking.templates import Templates, prepare_templates


class KeyGraph(nn.Module):
    """Module that prepares the templates of points in a key frame, with the settings of `prepare_templates`."""

    point_axes: ClassVar = {"points": 1, "warp": 1}

    def __init__(self, window: int = 25, gain_offset: bool = True) -> None:
        super().__init__()
        self.window = window
        self.gain_offset = gain_offset

    def forward(
        self, view: Tensor, points: Tensor, noise: Tensor | None = None, warp: Tensor | None = None
    ) -> Templates:
        """Prepare the templates of points (B, N, 2) px in a key frame (B, 1, H, W) of the topography view.

        `noise` (B,) is the standard deviation of the view's noise in grey levels, estimated by default. `warp`
        (B, N, 2, 2) is the deformation gradient since the key frame.
        """
        return prepare_templates(view, points, self.window, warp, gain_offset=self.gain_offset, noise=noise)
