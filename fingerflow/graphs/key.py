"""What a key frame of the topography view says about its points."""

from typing import ClassVar

from torch import Tensor, nn

from fingerflow.ops.tracking.templates import Templates, prepare_templates


class KeyGraph(nn.Module):
    """Points to their templates; settings as in `ops.prepare_templates`."""

    point_axes: ClassVar = {"points": 1, "warp": 1}

    def __init__(self, window: int = 25, gain_offset: bool = True) -> None:
        super().__init__()
        self.window = window
        self.gain_offset = gain_offset

    def forward(
        self, view: Tensor, points: Tensor, noise: Tensor | None = None, warp: Tensor | None = None
    ) -> Templates:
        """(B, 1, H, W) view, (B, N, 2) px, (B,) noise of the view, (B, N, 2, 2) deformation since the key frame."""
        return prepare_templates(view, points, self.window, warp, gain_offset=self.gain_offset, noise=noise)
