"""Windows around points as batched products: patches of pixels, and their spline at a fractional shift."""

import torch
from torch import Tensor, nn

from fingerflow.stream.spline_features import SCALE, features, taps

_SMOOTHING = (0.25, 0.5, 0.25)  # of pixels, to be coefficients of the spline (`ops.spline`)


class Windows(nn.Module):
    """Windows of `size` px a side; constants that turn functions of a shift into matrices of a band.

    A window at a shift s from a whole pixel is B_y(s) p B_x(s)^T, p its patch of pixels and B the matrix with the
    weights of s along its band: those of the spline spread by the smoothing that its coefficients ask for
    (`ops.spline`). No image of coefficients is formed.

    Args:
        size: odd side of a window, px.
        reach: px that a shift may have in x and y.
    """

    band: Tensor
    rows: Tensor
    columns: Tensor
    middle: Tensor

    def __init__(self, size: int, reach: int = 1, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.size = size
        self.reach = reach
        self.precision = precision
        self.taps = taps(reach)
        self.margin = reach + 2  # px of a patch around its window
        self.side = size + 2 * self.margin  # of a patch
        bands = torch.zeros(self.taps, size, self.side, dtype=torch.float64)
        place = torch.arange(size)
        for tap in range(self.taps):
            for offset, weight in enumerate(_SMOOTHING):
                bands[tap, place, place + tap + offset] = weight / SCALE
        at_rest = features(torch.zeros(1, 1, 1, dtype=torch.float64), reach)[0]
        # By function: pixels of a patch to those of a window, and the same flat, as products take them.
        self.register_buffer("band", bands.to(precision))
        self.register_buffer("rows", bands.flatten(0, 1).to(precision))
        self.register_buffer("columns", bands.transpose(1, 2).flatten(1).to(precision))
        self.register_buffer("middle", (bands * at_rest).sum(0).to(precision))

    def patches(self, view: Tensor, center: Tensor) -> Tensor:
        """Pixels (P, side, side) of views (B, 1, H, W) around whole pixels (B, 2, N), x first; P = B N.

        Where a patch would reach beyond the frame, the nearest one that does not is taken.
        """
        height, width = view.shape[-2:]
        first = center - (self.size // 2 + self.margin)
        column = first[:, 0].clamp(0, width - self.side)
        row = first[:, 1].clamp(0, height - self.side)
        corner = (row * width + column).to(torch.int64)  # exact: below 2^24
        steps = torch.arange(self.side, device=view.device)
        offsets = (steps[:, None] * width + steps).flatten()
        index = (corner[..., None] + offsets).flatten(1)
        # Bytes are gathered as they are, a quarter of the memory; torch gathers no uint16.
        plane = view if view.dtype == torch.uint8 else view.to(self.precision)
        pixels = plane.flatten(1).gather(1, index)
        return pixels.to(self.precision).reshape(-1, self.side, self.side)

    def along_y(self, patches: Tensor) -> Tensor:
        """Patches (P, side, side) by the functions of the shift in y: (P, taps, size * side).

        The sum over the functions, each times its value, is the spline along y; the columns are still pixels.
        """
        return (self.rows @ patches).reshape(-1, self.taps, self.size * self.side)

    def at_y(self, functions: Tensor) -> Tensor:
        """Weights (..., size, side) of the pixels of a column for functions (..., taps) of the shift in y."""
        return (functions @ self.band.flatten(1)).unflatten(-1, (self.size, self.side))

    def at_x(self, functions: Tensor) -> Tensor:
        """Weights (..., side, size) of the pixels of a line for functions (..., taps) of the shift in x."""
        return (functions @ self.columns).unflatten(-1, (self.side, self.size))

    def table_of(self, gradient: Tensor) -> Tensor:
        """(P, 2 taps, size * side) of gradients (P, 2, size, size): what `along_y` times its transpose is the table of.

        Row b, column c taps + a of the table is the coefficient of function b of the shift in y times function a of
        that in x in the sum of gradient c times the shifted window.
        """
        return (gradient[:, :, None] @ self.band).flatten(3).flatten(1, 2)

    def in_the_middle(self, weights: Tensor) -> Tensor:
        """(P, K, side, side): what weights (P, K, size, size) of a window without a shift are of its patch's pixels."""
        return self.middle.T @ weights @ self.middle
