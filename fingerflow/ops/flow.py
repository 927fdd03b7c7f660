"""Displacement of every pixel of the skin between two images: combined local and global flow.

It minimises, over the pixels x of a mask,

    sum_x K * (a S_f - S_g(x + w) + b)^2 + alpha |grad (w - M w)|^2

(Bruhn, Weickert, Schnoerr, IJCV 61(3), 2005): K integrates the data term over a window (J_rho), which noise and the
aperture problem ask for, alpha smooths beyond it. S is the spline of the tracker (`ops.spline`), so that both images
are seen through one low-pass. Departures from the paper:

- What is smoothed is the departure of w from its own course M w: the plane that fits it best and, beside that, planes
  fitted around every place over some two periods of ridges. With |grad w|^2 a finger that widens evenly is pulled flat
  at the border of the mask, and a wave of 300 px loses 3 % of its height; so noise could be averaged over a few pixels
  only. On ridges with 2 grey levels of noise the error falls from 0.027 to 0.016 px (0.016 to 0.011 where ridges run in
  all directions).
- The image is warped and linearised about the latest w with the gradient of the *first* image, which the warped one has
  to equal: J and its pyramid belong to the first image and are prepared once for all that follow. The fixed point,
  K * (grad S_f r) = alpha L (w - M w), does not depend on how it is reached.
- Gain a and offset b of the light are fitted over the mask.
- Images are halved for a start from nothing only as far as texture stands out of the noise. On ridges that reaches no
  further, as they have no energy below one period in 20 px: motion of more than a quarter of a period needs
  ``initial``: the frame before, tracked points, a search.
"""

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow import kernels
from fingerflow.kernels.torch_op import torch_op
from fingerflow.ops import tracking_limits as limits
from fingerflow.ops.box_sum import box_sum
from fingerflow.ops.flow_multigrid import Level, halved, laplacian, magnified, pyramid, solve
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.spline import spline_coefficients, spline_weights
from fingerflow.ops.tensors import finite

_ROUNDING = 1 / 12  # variance that whole grey levels have against the light
_RIDGE_NOISE = 0.86  # share of the variance of noise that the low-pass of the spline leaves at a period of 15 px
_COURSE_CELLS = 9
_CYCLES = 2  # of multigrid a warp
_NARROW = (
    0.01  # share of the square of the trace that the determinant of moments in a plane has at least; a disc's is 1/4
)
_MARGIN = 2  # px at the border of an image, where its spline takes pixels that are not there
_SMALLEST_SIDE = 32  # px, of a halved image
_TINY = 1e-12


class Flow(NamedTuple):
    """Displacement field of B pairs of images.

    Attributes:
        displacement: (B, 2, H, W) px as (u, v), where what stands at each pixel of the first image has moved to; NaN
            outside the mask, and where that lies outside the current image.
        covariance: (B, 2, 2, H, W) px^2, of the noise of both images; NaN as the displacement, and where the texture
            does not stand out of the noise in any direction: there the displacement is that of the surroundings. What
            smoothing takes off the motion comes on top: nothing to speak of where ridges run in all directions, once
            more the deviation where they run in one.
        residual: (B, 1, H, W) grey levels, root mean square over the window of what displacement and light left
            unexplained before the last step; NaN as the displacement. Noise alone leaves 0.42 of its deviation.
    """

    displacement: Tensor
    covariance: Tensor
    residual: Tensor


class FlowTemplate(NamedTuple):
    """What the flow needs to know of the first image (B, 1, H, W): `prepare_flow`."""

    value: Tensor  # (B, 1, H, W) spline at the pixels
    gradient: Tensor  # (B, 2, H, W), 0 outside the mask
    inside: Tensor  # (B, 1, H, W), 1 in the mask, else 0
    levels: list[Level]
    covariance: Tensor  # (B, 2, 2, H, W) for a gain of 1
    box: int
    coarser: "FlowTemplate | None"  # of the image halved, for a start from nothing; None where its texture ends


def dense_flow(
    first: Tensor,
    current: Tensor,
    initial: Tensor | None = None,
    mask: Tensor | None = None,
    *,
    box: int = 9,
    roughness: float = 0.04,
    warps: int = 3,
    noise: Tensor | None = None,
) -> Flow:
    """Displacement of every pixel from one image to another.

    Args:
        first, current: (B, 1, H, W), 8 to 16 bit or floating.
        initial: (B, 2, H, W) px, within a quarter of a ridge's period of the truth. Where it is not
            finite it counts as 0. By default it is found in the halved images, from 0.
        mask: (B, 1, H, W) bool of the pixels of ``first`` that belong to the skin; all by default. Nothing outside it
            has any influence but through the windows' spline.
        box: px; the data term is integrated by two boxes of this side, one after the other.
        roughness: expected root mean square of the gradient of what the displacement has beside its own course. Smaller
            is smoother.
        warps: how often the current image is warped; a warm start needs 1, motion of a quarter of a period 3.
        noise: (B,) standard deviation of white noise, grey levels; estimated from ``first`` by default.

    Raises:
        ValueError: shapes that do not fit, or a setting out of range.
    """
    return whole_flow(first, current, initial, mask, noise, box, roughness, warps)


def _like_flow(first: Tensor, *others: Any) -> "Flow":
    batch, _, height, width = first.shape
    kind = torch.float64 if first.dtype == torch.float64 else torch.float32
    sizes = ((2,), (2, 2), (1,))
    return Flow(*(first.new_empty((batch, *size, height, width), dtype=kind) for size in sizes))


@torch_op(shapes=_like_flow)
def whole_flow(
    first: Tensor,
    current: Tensor,
    initial: Tensor | None,
    mask: Tensor | None,
    noise: Tensor | None,
    box: int,
    roughness: float,
    warps: int,
) -> Flow:
    """`dense_flow`, whose arguments these are: how often the images are halved depends on them."""
    return find_flow(prepare_flow(first, mask, box=box, roughness=roughness, noise=noise), current, initial, warps)


def prepare_flow(
    first: Tensor, mask: Tensor | None = None, *, box: int = 9, roughness: float = 0.04, noise: Tensor | None = None
) -> FlowTemplate:
    """What `find_flow` needs to know of a first image; arguments as for `dense_flow`."""
    _check_image("first", first, first)
    if mask is not None and (mask.shape != first.shape or mask.dtype != torch.bool):
        raise ValueError(f"mask must be bool {tuple(first.shape)}, not {mask.dtype} {tuple(mask.shape)}")
    if box < 1 or box % 2 == 0 or not roughness > 0:
        raise ValueError(f"box must be odd and at least 1 px, roughness above 0, not {box} and {roughness}")
    kind = torch.float64 if first.dtype == torch.float64 else torch.float32
    variance = (estimate_noise(first) if noise is None else noise).to(kind).square()
    least = 0.0 if first.is_floating_point() else _ROUNDING
    variance = variance.nan_to_num(0.0).clamp_min(max(least, _TINY))
    everywhere = torch.ones_like(first, dtype=torch.bool) if mask is None else mask
    return _prepared(first.to(kind), everywhere.to(kind), variance, box, roughness)


def _prepared(first: Tensor, mask: Tensor, variance: Tensor, box: int, roughness: float) -> FlowTemplate:
    """Of a floating image, and of the halved ones while their texture lasts."""
    coefficients = spline_coefficients(first)
    kind = coefficients.dtype
    usable = finite(coefficients)
    known = -functional.max_pool2d(
        -usable.to(kind), 3, 1, 1
    )  # the spline at a pixel takes its neighbours' coefficients
    inside = known * mask
    coefficients = torch.where(usable, coefficients, 0.0)
    still = first.new_zeros(len(first), 2, *first.shape[-2:])
    _, value = _warped(coefficients, still, inside)  # as `find_flow` has it: what does not move leaves nothing
    gradient = _slopes(coefficients) * _arrives(still, inside, _MARGIN)
    x, y = gradient[:, :1], gradient[:, 1:]
    tensor = inside * _integrated(torch.cat((x * x, x * y, y * y), dim=1), box)
    alpha = 2 * variance / roughness**2
    energy = (tensor[:, 0] + tensor[:, 2]).sum((1, 2)) / inside.sum((1, 2, 3)).clamp_min(1)
    lasts = (energy > limits.TEXTURE_TO_NOISE * 2 * limits.GRADIENT_NOISE * variance).all()
    coarser = None
    if min(first.shape[-2:]) >= 2 * _SMALLEST_SIDE and lasts:
        # A mean of four has a fourth of the noise. Where one of the four is not known it is not either.
        half = functional.avg_pool2d(first, 2)
        coarser = _prepared(half, -functional.max_pool2d(-inside, 2), variance / 4, box, roughness)
    spread = _covariance(tensor, variance, alpha, box)
    return FlowTemplate(value, gradient, inside, pyramid(tensor, inside, alpha), spread, box, coarser)


def find_flow(template: FlowTemplate, current: Tensor, initial: Tensor | None = None, warps: int = 3) -> Flow:
    """The flow from a prepared first image to a current one; arguments as for `dense_flow`."""
    _check_image("current", current, template.value)
    if warps < 1:
        raise ValueError(f"warps must be at least 1, not {warps}")
    shape = (len(current), 2, *current.shape[-2:])
    if initial is not None and initial.shape != shape:
        raise ValueError(f"initial must be {shape}, not {tuple(initial.shape)}")
    given = current.to(template.value.dtype)
    if initial is None:
        flow = _from_nothing(template, given, warps)
    else:
        flow = torch.where(finite(initial), initial, 0.0).to(given.dtype)
    flow, left, seen, gain = _refined(template, given, flow, warps)
    # Half of it is noise of the first image, half of the current one, which counts for more where the light is less.
    spread = template.covariance * ((1 + 1 / (gain * gain)) / 2)[:, :, None]
    residual = (_integrated(left * left, template.box) / _integrated(seen, template.box).clamp_min(_TINY)).sqrt()
    lost = torch.where(_arrives(flow, template.inside) > 0, 0.0, torch.nan).to(flow.dtype)
    return Flow(flow + lost, spread + lost[:, :, None], residual + lost)


def _from_nothing(template: FlowTemplate, current: Tensor, warps: int) -> Tensor:
    """The flow in the halved images, in px of these."""
    batch, _, height, width = current.shape
    coarser = template.coarser
    if coarser is None:
        return template.value.new_zeros(batch, 2, height, width)
    half = functional.avg_pool2d(current, 2)
    found = _refined(coarser, half, _from_nothing(coarser, half, warps), warps)[0]
    # The middle of a pair of pixels is the place of the halved one: as far from both.
    wide = 2 * magnified(found, 2)
    return functional.pad(wide, (0, width % 2, 0, height % 2), mode="replicate")


def _refined(
    template: FlowTemplate, current: Tensor, flow: Tensor, warps: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The flow after so many warps, what the last but one leaves (B, 1, H, W), where that was seen, and the gain."""
    level = template.levels[0]
    coefficients = spline_coefficients(current)
    for _ in range(warps):
        seen, warped = _warped(coefficients, flow, template.inside)
        gain, offset = _light(template.value, warped, seen)
        left = seen * (warped - offset - gain * template.value)
        data = template.inside * _integrated(template.gradient * left, template.box)
        course = _course(flow, seen)
        flow = torch.where(seen > 0, flow, course)  # J, of the first image, would hold it where it is
        departure = flow - course
        # Slopes and step of the first image: in the light of the current one both count by the gain, J by its square.
        right_side = -data / gain - laplacian(level, departure)
        flow = flow + solve(template.levels, right_side, _CYCLES)
    return flow, left, seen, gain


def _integrated(fields: Tensor, box: int) -> Tensor:
    """Means over two boxes, one after the other, of (B, C, H, W); 0 beyond the border."""
    half = box // 2
    for _ in range(2):
        fields = box_sum(functional.pad(fields, (half, half, half, half)), box) / box**2
    return fields


def _slopes(coefficients: Tensor) -> Tensor:
    """(B, 2, H, W) of the spline at whole pixels."""
    wide = functional.pad(coefficients, (1, 1, 1, 1), mode="replicate")

    def smooth(cells: Tensor, dim: int) -> Tensor:
        count = cells.shape[dim] - 2
        return (cells.narrow(dim, 0, count) + 4 * cells.narrow(dim, 1, count) + cells.narrow(dim, 2, count)) / 6

    def slope(cells: Tensor, dim: int) -> Tensor:
        count = cells.shape[dim] - 2
        return (cells.narrow(dim, 2, count) - cells.narrow(dim, 0, count)) / 2

    return torch.cat((slope(smooth(wide, 2), 3), smooth(slope(wide, 2), 3)), dim=1)


def _warped(coefficients: Tensor, flow: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Which pixels of the mask arrive where the spline knows the image, and its values there (B, 1, H, W)."""
    values = _sampled(coefficients, flow)
    usable = finite(values)
    return _arrives(flow, inside, _MARGIN) * usable.to(values.dtype), torch.where(usable, values, 0.0)


def _sampled(coefficients: Tensor, flow: Tensor) -> Tensor:
    """The spline (B, 1, H, W) where the pixels have moved to; beyond the border its coefficients are repeated."""
    if coefficients.dtype == torch.float32 and kernels.serve(coefficients, flow):
        return kernels.flow_warp(coefficients, flow)
    height, width = coefficients.shape[-2:]
    whole = flow.floor()
    (weights_x, _), (weights_y, _) = (spline_weights(flow[:, k : k + 1] - whole[:, k : k + 1], 3) for k in (0, 1))
    column = torch.arange(width, device=flow.device) + whole[:, :1].to(torch.int64)
    row = torch.arange(height, device=flow.device)[:, None] + whole[:, 1:].to(torch.int64)
    columns = [(column + k).clamp(0, width - 1) for k in range(-1, 3)]
    flat = coefficients.flatten(1)
    values = torch.zeros_like(coefficients)
    for k in range(4):
        start = (row + (k - 1)).clamp(0, height - 1) * width
        line = torch.zeros_like(coefficients)
        for weight, place in zip(weights_x, columns, strict=True):
            line = line + weight * flat.gather(1, (start + place).flatten(1)).unflatten(1, (1, height, width))
        values = values + weights_y[k] * line
    return values


def _arrives(flow: Tensor, inside: Tensor, margin: int = 0) -> Tensor:
    """1 for the pixels of the mask that lie within the current image, so many px inside, else 0."""
    height, width = flow.shape[-2:]
    x = torch.arange(width, dtype=flow.dtype, device=flow.device) + flow[:, :1]
    y = torch.arange(height, dtype=flow.dtype, device=flow.device)[:, None] + flow[:, 1:]
    within = (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
    return inside * within.to(inside.dtype)


def _light(value: Tensor, warped: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """Gain and offset (B, 1, 1, 1) of the warped image against the first one: least squares over what is seen."""
    count = seen.sum((1, 2, 3), keepdim=True).clamp_min(1)
    mean, mean_warped = ((seen * one).sum((1, 2, 3), keepdim=True) / count for one in (value, warped))
    apart = seen * (value - mean)
    energy = (apart * apart).sum((1, 2, 3), keepdim=True)
    gain = (apart * (warped - mean_warped)).sum((1, 2, 3), keepdim=True) / energy.clamp_min(_TINY)
    # A picture that has nothing in common with the first one would have its sign turned: it is compared as it is.
    gain = torch.where(gain > 1 / limits.MOST_GAIN, gain.clamp_max(limits.MOST_GAIN), 1.0)
    return gain, mean_warped - gain * mean


def _course(flow: Tensor, seen: Tensor) -> Tensor:
    """(B, 2, H, W): the plane that fits the flow best where it is seen, and beside that, for the rest, planes that fit
    it around every cell of 4 px, in two boxes of `_COURSE_CELLS` cells, one after the other.
    """
    height, width = flow.shape[-2:]
    share, total = halved(halved(seen)), halved(halved(seen * flow))
    x, y = (
        (torch.arange(count, dtype=flow.dtype, device=flow.device) - (count - 1) / 2) / _COURSE_CELLS
        for count in (share.shape[-1], share.shape[-2])
    )
    whole = _planes(_moments(share, total, x, y[:, None]).sum((2, 3), keepdim=True))
    rest = total - share * _heights(whole, x, y[:, None])
    around = _planes(_integrated(_moments(share, rest, x, y[:, None]), _COURSE_CELLS))
    beside = magnified(_heights(around, x, y[:, None]), 4)
    # Pixels lie at -3/8, -1/8, 1/8 and 3/8 of a cell from its middle.
    fine_x, fine_y = (
        ((torch.arange(count, dtype=flow.dtype, device=flow.device) - 1.5) / 4 - (cells - 1) / 2) / _COURSE_CELLS
        for count, cells in ((width, share.shape[-1]), (height, share.shape[-2]))
    )
    return _heights(whole, fine_x, fine_y[:, None]) + beside[..., :height, :width]


class _Planes(NamedTuple):
    """u = height + x slope_x + y slope_y, two components (B, 2, ., .) each."""

    height: Tensor
    slope_x: Tensor
    slope_y: Tensor


def _moments(share: Tensor, field: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(B, 12, h, w) of weights (B, 1, h, w) and a weighted field (B, 2, h, w): what a plane through it asks for."""
    along, down = share * x, share * y
    return torch.cat((share, along, down, along * x, along * y, down * y, field, field * x, field * y), dim=1)


def _planes(moments: Tensor) -> _Planes:
    """Least squares; the mean where cells do not span a plane, 0 where there are none."""
    around, *sums = moments.split((1, 1, 1, 1, 1, 1, 2, 2, 2), dim=1)
    some = torch.where(around > _TINY, around, 1.0)
    mean_x, mean_y, xx, xy, yy, mean, by_x, by_y = (one / some for one in sums)
    xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
    by_x, by_y = by_x - mean_x * mean, by_y - mean_y * mean
    determinant = xx * yy - xy * xy
    spanned = (determinant > _NARROW * (xx + yy).square()) & (determinant > _TINY)
    determinant = torch.where(spanned, determinant, torch.inf)
    slope_x, slope_y = (by_x * yy - by_y * xy) / determinant, (by_y * xx - by_x * xy) / determinant
    return _Planes(mean - slope_x * mean_x - slope_y * mean_y, slope_x, slope_y)


def _heights(planes: _Planes, x: Tensor, y: Tensor) -> Tensor:
    return planes.height + planes.slope_x * x + planes.slope_y * y


def _covariance(tensor: Tensor, variance: Tensor, alpha: Tensor, box: int) -> Tensor:
    """(B, 2, 2, H, W) of the noise of both images, in the same light.

    Where J changes little within its reach, a component along which J is l has the variance of noise of density s^2
    that passed through l K(k) / (l + alpha k^2): with the two boxes as a Gaussian of variance rho^2 each way,
    s^2 / (4 pi alpha) (1 - z e^z E1(z)), z = rho^2 l / alpha.
    """
    alpha, variance = alpha[:, None, None, None], variance[:, None, None, None]
    rho_square = max(2 * (box**2 - 1) / 12, 0.25)  # a pixel is a window too
    xx, xy, yy = tensor[:, :1], tensor[:, 1:2], tensor[:, 2:]
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    apart = (half * half + xy * xy).sqrt()
    density = 2 * variance * _RIDGE_NOISE
    of_larger, of_smaller = (
        density / (4 * math.pi * alpha) * _passed(rho_square * (one / alpha).clamp_min(_TINY))
        for one in (mean + apart, (mean - apart).clamp_min(0))
    )
    # A function of a symmetric matrix: f(J) = f(smaller) + (f(larger) - f(smaller)) (J - smaller) / (larger - smaller).
    slope = (of_larger - of_smaller) / (2 * apart).clamp_min(_TINY)
    base = of_smaller - slope * (mean - apart)
    textured = mean + apart > limits.TEXTURE_TO_NOISE * limits.GRADIENT_NOISE * variance
    known = torch.where(textured, 0.0, torch.nan).to(slope.dtype)
    rows = torch.cat((slope * xx + base, slope * xy, slope * xy, slope * yy + base), dim=1) + known
    result: Tensor = rows.unflatten(1, (2, 2))
    return result


def _passed(z: Tensor) -> Tensor:
    """1 - z e^z E1(z) for z > 0, to 5e-5 (Abramowitz & Stegun, 5.1.53 and 5.1.56)."""
    small = z.clamp_max(1.0)
    series = 0.99999193 + small * (-0.24991055 + small * (0.05519968 + small * (-0.00976004 + small * 0.00107857)))
    below = small * small.exp() * (series * small - 0.57721566 - small.log())
    large = z.clamp(1.0, 1e6)
    above = (large * (large + 2.334733) + 0.250621) / (large * (large + 3.330657) + 1.681534)
    return 1 - torch.where(z < 1, below, above)


def _check_image(name: str, image: Tensor, like: Tensor) -> None:
    if image.ndim != 4 or image.shape[1] != 1 or image.shape != like.shape:
        raise ValueError(f"{name} must be (B, 1, H, W), as large as the other image, not {tuple(image.shape)}")
    if min(image.shape[-2:]) < 8:
        raise ValueError(f"{name} must be at least 8 x 8 px, not {tuple(image.shape[-2:])}")
