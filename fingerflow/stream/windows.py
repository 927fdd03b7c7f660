"""Windows around points as batched products: patches of pixels, and their spline at a fractional shift."""

import torch
from torch import Tensor, nn

from fingerflow.stream.spline_features import feature_slopes, features, smoothed_spline_matrix, spline_matrix, taps


class Windows(nn.Module):
    """Windows of `size` px a side; constants that turn functions of a shift into matrices of a band.

    A window at a shift s from a whole pixel is B_y(s) p B_x(s)^T, p its patch of pixels and B the matrix with the
    weights of s along its band: those of the spline spread by the smoothing that its coefficients ask for
    (`ops.spline`). No image of coefficients is formed.

    Args:
        size: odd side of a window, px.
        reach: px that a shift may have in x and y.
    """

    band_x: Tensor
    band_y: Tensor
    spline: Tensor

    def __init__(self, size: int, reach: int = 1, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.size = size
        self.reach = reach
        self.precision = precision
        self.taps = taps(reach)
        self.margin = reach + 2  # px of a patch around its window
        self.side = size + 2 * self.margin  # of a patch
        weights = smoothed_spline_matrix(reach, torch.float64)
        bands = torch.zeros(self.taps, size, self.side, dtype=torch.float64)
        for tap, of_functions in enumerate(weights):
            bands[:, torch.arange(size), torch.arange(size) + tap] = of_functions[:, None]
        nothing = torch.zeros_like(bands)
        # Functions and their slopes to a matrix whose upper half gives values, the lower one derivatives.
        both = torch.cat((torch.cat((bands, nothing), dim=1), torch.cat((nothing, bands), dim=1)))
        self.register_buffer("band_y", both.flatten(1).to(precision))
        self.register_buffer("band_x", both.transpose(1, 2).flatten(1).to(precision))
        self.register_buffer("spline", spline_matrix(reach, precision))

    def patches(self, view: Tensor, center: Tensor) -> Tensor:
        """Pixels (P, side, side) of views (B, 1, H, W) around whole pixels (B, N, 2); P = B N.

        Where a patch would reach beyond the frame, the nearest one that does not is taken.
        """
        batch, _, height, width = view.shape
        first = center - (self.size // 2 + self.margin)
        column = first[..., 0].clamp(0, width - self.side)
        row = first[..., 1].clamp(0, height - self.side)
        corner = (row * width + column).to(torch.int64)  # exact: below 2^24
        steps = torch.arange(self.side, device=view.device)
        offsets = (steps[:, None] * width + steps).flatten()
        index = (corner[..., None] + offsets).flatten(1)
        # Bytes are gathered as they are, a quarter of the memory; torch gathers no uint16.
        plane = view if view.dtype == torch.uint8 else view.to(self.precision)
        pixels = plane.reshape(batch, -1).gather(1, index)
        return pixels.to(self.precision).reshape(-1, self.side, self.side)

    def sample(self, patches: Tensor, shift: Tensor) -> Tensor:
        """Spline of patches (P, side, side) at shifts (1, 2, P), with its derivatives.

        (P, 2 size, 2 size): values in the upper left quarter, d/dx in the upper right, d/dy in the lower left.
        """
        weights = torch.cat((features(shift, self.reach), feature_slopes(shift, self.reach)))
        band_x = (weights[:, 0].T @ self.band_x).reshape(-1, self.side, 2 * self.size)
        band_y = (weights[:, 1].T @ self.band_y).reshape(-1, 2 * self.size, self.side)
        return band_y @ patches @ band_x

    def shifted_rows(self, patches: Tensor) -> Tensor:
        """(P, taps, rows * columns) of patches (P, rows, columns + taps - 1): cut at the shifts along x."""
        width = patches.shape[2] - self.taps + 1
        cut = torch.cat([patches[:, None, :, k : k + width] for k in range(self.taps)], dim=1)
        return cut.flatten(2)

    def shifted_gradients(self, gradient: Tensor) -> Tensor:
        """(P, 2 taps, (rows + taps - 1) * columns): gradients (P, 2, rows, columns) at the shifts along y.

        Zeros are around them. Row 2 k + c is component c at shift k: its product with `shifted_rows` is the
        correlation table.
        """
        last = self.taps - 1
        return torch.cat([nn.functional.pad(gradient, (0, 0, k, last - k)) for k in range(self.taps)], 1).flatten(2)

    def smooth(self, images: Tensor) -> Tensor:
        """[1 2 1] / 4 along the last two axes, one pixel shorter at each end."""
        for axis in (-1, -2):
            length = images.shape[axis] - 2
            images = (
                images.narrow(axis, 0, length) + 2 * images.narrow(axis, 1, length) + images.narrow(axis, 2, length)
            ) / 4
        return images
