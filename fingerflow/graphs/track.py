"""Modules of templates: their preparation in a key frame, and their registration in later frames."""

from torch import Tensor, nn

from fingerflow.kernels.result_records import TrackedPoints
from fingerflow.ops.full_precision import without_autocast
from fingerflow.ops.tracking.templates import Templates, find_templates, prepare_templates


class KeyGraph(nn.Module):
    """Module that prepares the templates of points in a key frame, with the settings of `prepare_templates`."""

    def __init__(self, window: int = 25, gain_offset: bool = True) -> None:
        super().__init__()
        self.window = window
        self.gain_offset = gain_offset

    @without_autocast
    def forward(
        self, view: Tensor, points: Tensor, noise: Tensor | None = None, warp: Tensor | None = None
    ) -> Templates:
        """Prepare the templates of points (B, N, 2) px in a key frame (B, 1, H, W) of the topography view.

        `noise` (B,) is the standard deviation of the view's noise in grey levels, estimated by default. `warp`
        (B, N, 2, 2) is the deformation gradient since the key frame.
        """
        return prepare_templates(view, points, self.window, warp, gain_offset=self.gain_offset, noise=noise)


class TrackGraph(nn.Module):
    """Module that registers key-frame templates in a frame by one Lucas-Kanade step.

    Settings are those of `ops.tracking.templates.find_templates`.
    """

    def __init__(self, forward_backward_limit: float = 1.0) -> None:
        super().__init__()
        self.forward_backward_limit = forward_backward_limit

    @without_autocast
    def forward(self, templates: Templates, view: Tensor, prediction: Tensor) -> TrackedPoints:
        """Register the templates of (B, N) points in a view (B, 1, H, W), near predicted positions (B, N, 2) px."""
        return find_templates(templates, view, prediction, rounds=1, forward_backward_limit=self.forward_backward_limit)
