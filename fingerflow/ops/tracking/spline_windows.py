"""Windows around points as batched products: patches of pixels, and their spline at a fractional shift.

A window at a shift s from a whole pixel is B_y(s) p B_x(s)^T, p its patch of pixels and B the matrix with the weights
of s along its band: those of the cubic B-spline spread by the smoothing that its coefficients ask for
(`ops.filters.spline`). No image of coefficients is formed. The weights at the whole places -2 to 2 are functions of the
shift within (-1, 1): with u = max(2 - |x|, 0) and v = max(1 - |x|, 0) the B-spline is b3(x) = (u^3 - 4 v^3) / 6.
"""

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.filters.windows import lines_of
from fingerflow.ops.looking import looks

MARGIN = 3  # px of a patch around its window: two of the spline at the reach, one of the smoothing
TAPS = 5


def cut_patches(view: Tensor, center: Tensor, size: int, dtype: torch.dtype) -> Tensor:
    """Pixels (P, side, side) of views (B, 1, H, W) around whole pixels (B, 2, N), x first; P = B N, side = size + 6.

    Pixels beyond the border repeat the border; a window that would reach farther than they do is moved inwards.
    """
    side = size + 2 * MARGIN
    # Bytes are copied as they are, a quarter of the memory.
    border = max(MARGIN + 2, side - min(view.shape[-2:]))  # found inside, a window may stand beside a pixel outside
    exporting = torch.compiler.is_exporting()
    few = not exporting or center.shape[2] * side * side < view.shape[2] * view.shape[3]
    plane = _bordered(view if view.dtype == torch.uint8 and few else view.to(dtype), border)
    height, width = plane.shape[-2:]
    column, row = (center + (border - side // 2)).split(1, dim=1)
    # Between floats: a runtime has two nodes for what lies between whole numbers.
    first = row.clamp(0.0, float(height - side)) * width + column.clamp(0.0, float(width - side))
    # One number a window and one a pixel of it: sums of pairs of rows and columns take runtimes three times as long.
    whole = torch.int32 if exporting else torch.int64
    first = first.to(whole).transpose(1, 2)
    steps = torch.arange(side, dtype=whole, device=view.device)
    if exporting or view.requires_grad:
        index = first + (steps[:, None] * width + steps).flatten()
        pixels = plane.flatten(1).gather(1, index.flatten(1))
    else:
        own = torch.arange(len(plane), device=view.device)[:, None, None] * (height * width)
        pixels = lines_of(plane, first + own + steps * width, side)
    return pixels.to(dtype).reshape(-1, side, side)


def taps(shift: Tensor) -> Tensor:
    """b3(shift - place) at the five places, (..., 5) of shifts (...)."""
    return _values(*_distances(_from_places(shift)))


def taps_and_slopes(shift: Tensor) -> tuple[Tensor, Tensor]:
    """The same, and its derivatives."""
    beside = _from_places(shift)
    u, v = _distances(beside)
    return _values(u, v), (2 * v * v - u * u / 2) * beside.sign()


def windows_at(shift: Tensor, patches: Tensor, size: int) -> Tensor:
    """Return the spline on windows, (P, size size), at shifts (P, 2) px from the middles of patches (P, side, side)."""
    weights = taps(shift)
    if looks(patches, shift) and len(patches):
        # Torch correlates every patch with weights of its own in half the time of products, ONNX Runtime in five times.
        weights = weights @ _smoothed(weights)
        both = weights[:, 1, :, None] * weights[:, 0, None, :]
        windows = functional.conv2d(patches[None], both[:, None], groups=len(patches)).squeeze(0)
    else:
        windows = along_y(weights[:, 1], size) @ patches @ along_x(weights[:, 0], size)
    return windows.flatten(1)


def along_y(weights: Tensor, size: int) -> Tensor:
    """(..., size, side): from the pixels of a column to the spline on a window, for taps (..., 5) of the shift in y."""
    side = size + 2 * MARGIN
    # Lines of a band that are a place longer than the matrix: laid end to end, each begins a place later in its row.
    line = functional.pad(_smoothed(weights), (0, side + 1 - TAPS - 2))
    bands = line[:, None].expand(TAPS, size, side + 1).flatten(1)[:, : size * side]
    result: Tensor = (weights @ bands).unflatten(-1, (size, side))
    return result


def along_x(weights: Tensor, size: int) -> Tensor:
    """(..., side, size): the same for a line."""
    return along_y(weights, size).transpose(-1, -2)


def onto_pixels(weights: Tensor, size: int) -> Tensor:
    """(..., side, side): what weights (..., size, size) of the spline at whole pixels are of the pixels themselves."""
    middle = along_y(taps(weights.new_zeros(())), size)
    return middle.T @ weights @ middle


def _smoothed(like: Tensor) -> Tensor:
    """(5, 7): from weights of coefficients to those of pixels."""
    place = torch.arange(TAPS + 2, device=like.device) - torch.arange(TAPS, device=like.device)[:, None]
    middle, beside = (place == 1).to(like.dtype), ((place == 0) | (place == 2)).to(like.dtype)
    return middle / 2 + beside / 4


def _from_places(shift: Tensor) -> Tensor:
    return shift[..., None] - torch.arange(-2, 3, dtype=shift.dtype, device=shift.device)


def _distances(beside: Tensor) -> tuple[Tensor, Tensor]:
    u = (2 - beside.abs()).clamp_min(0)
    return u, (u - 1).clamp_min(0)


def _values(u: Tensor, v: Tensor) -> Tensor:
    return (u * u * u - 4 * v * v * v) / 6


def _bordered(view: Tensor, border: int) -> Tensor:
    """A view (B, 1, H, W) of any number type with its border repeated (B, 1, H + 2 border, W + 2 border)."""
    if torch.compiler.is_exporting():  # torch itself pads no bytes
        return functional.pad(view, (border,) * 4, mode="replicate")
    for dim in (2, 3):
        ends = view.narrow(dim, 0, 1), view.narrow(dim, view.shape[dim] - 1, 1)
        shape = [border if k == dim else -1 for k in range(4)]
        before, after = (end.expand(shape) for end in ends)
        view = torch.cat((before, view, after), dim=dim)
    return view
