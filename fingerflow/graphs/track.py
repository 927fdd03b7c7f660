"""Points of the topography view from one frame to another."""

from torch import Tensor, nn

from fingerflow.ops.tracking import Tracks, track_points


class TrackGraph(nn.Module):
    """Points of one frame of the topography view found in another; settings as in ``ops.track_points``."""

    def __init__(
        self, window: int = 21, forward_backward_limit: float = 1.0, search: int = 0, gain_offset: bool = False
    ) -> None:
        super().__init__()
        self.window = window
        self.forward_backward_limit = forward_backward_limit
        self.search = search
        self.gain_offset = gain_offset

    def forward(
        self,
        previous: Tensor,
        current: Tensor,
        points: Tensor,
        initial: Tensor | None = None,
        warp: Tensor | None = None,
        noise: Tensor | None = None,
    ) -> Tracks:
        """(B, 1, H, W) images, (B, N, 2) points and predictions, (B, N, 2, 2) deformation gradients, (B,) noise."""
        return track_points(
            previous,
            current,
            points,
            self.window,
            initial=initial,
            warp=warp,
            gain_offset=self.gain_offset,
            search=self.search,
            noise=noise,
            forward_backward_limit=self.forward_backward_limit,
        )
