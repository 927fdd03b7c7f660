"""Dense optical flow: the displacement of every pixel of the skin between two images (combined local-global method).

It minimises, over the pixels x of a mask,

    sum_x K * (a S_f - S_g(x + w) + b)^2 + alpha |grad (w - M w)|^2

(Bruhn, Weickert, Schnoerr, IJCV 61(3), 2005). K integrates the data term over a window (J_rho), against noise and the
aperture problem; alpha smooths beyond it. S is the spline of the tracker (`ops.filters.spline`), so that both images
pass the same low-pass filter. Departures from the paper:

- The smoothness term penalises the departure of w from its own trend M w (`trend` of `flow_cells`). M w is the plane
  that fits w best, plus planes fitted to the remainder around every position over some two periods of ridges. With
  |grad w|^2, a finger that widens evenly is flattened at the border of the mask, and a wave of 300 px loses 3 % of its
  height. Noise could then be averaged over a few pixels only. On ridges with 2 grey levels of noise the error falls
  from 0.027 to 0.019 px (0.016 to 0.012 where ridges run in all directions).
- The image is warped and linearised about the latest w with the gradient of the *first* image, which that of the warped
  one must equal. J and its pyramid thus belong to the first image and are prepared once for all later images. The fixed
  point, K * (grad S_f r) = alpha L (w - M w), does not depend on how it is reached.
- Gain a and offset b of the illumination are fitted over the mask.
- Both terms are quadratic, as written, or Charbonnier's (`ops.flow.flow_penalty`). The constant quantity is the grey
  level, as written, or the grey level and its gradient (`ops.flow.flow_constancy`). Scenes with motion boundaries are
  recognised by the residual that the quadratic form leaves: Charbonnier's penalty of both, with less smoothing, leaves
  far less of it there.
- For a cold start, images are halved only as far as texture exceeds the noise. Ridges have no energy at frequencies
  below one period in 20 px, so halving extends the reach no further. Motion of more than a quarter of a period needs
  `initial`, from the frame before, tracked points or a search.
"""

from typing import Any, NamedTuple, get_args

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.kernels.tensors.twins import Twin, twin
from fingerflow.ops.filters.halving import halved_image
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.filters.spline import spline_coefficients, spline_weights
from fingerflow.ops.flow import flow_cells, flow_penalty
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE, NOISE_OF_TENSOR, Constancy, channels
from fingerflow.ops.flow.flow_covariance import flow_covariance
from fingerflow.ops.flow.flow_multigrid import Level, descended, edges, halved_edges, pyramid
from fingerflow.ops.tensors import finite

_CYCLES = 3  # multigrid cycles after the last warp
_MARGIN = 2  # px at the border of an image, where its spline would need pixels beyond the border
_SMALLEST_SIDE = 32  # px, smallest side of a halved image
_TINY = 1e-12
_compiled_fields: Twin[tuple[Tensor, ...]] = twin("flow_template")
_compiled_residual: Twin[flow_penalty.FlowResidual] = twin("flow_left")
# Window side (px), roughness and number of warps for scenes with motion boundaries: photographs, discs that move one
# after the other, a jump.
_EDGE_BOX, _EDGE_ROUGHNESS, _EDGE_WARPS = 5, 0.15, 5
# A pixel is unlike noise if its residual exceeds this multiple of what noise leaves. The model with motion boundaries
# is tried if the share of such pixels exceeds the least share: it is 0 on skin that moves as a whole, 6 % at a jump of
# 0.5 px, 4 % on Dimetrodon. Its result is taken if it reduces this share to less than 0.4 of its value: at motion
# boundaries the share falls to 0.05 to 0.3 of its value, under dust to 0.4 or 0.5, and in light that changes from place
# to place to 0.8.
_UNLIKE_NOISE, _LEAST_SHARE, _BETTER = 2.0, 0.01, 0.4


class Flow(NamedTuple):
    """Dense displacement field of B pairs of images, with covariance and residual.

    Attributes:
        displacement: (B, 2, H, W) px as (u, v), of the skin at each pixel of the first image; NaN outside the mask, and
            where the displaced pixel lies outside the current image.
        covariance: (B, 2, 2, H, W) px^2, due to the noise of both images. NaN where the displacement is, and where
            the texture does not exceed the noise in any direction: there the displacement is that of the surroundings.
            The bias due to smoothing comes on top: negligible where ridges run in all directions, as large as the
            standard deviation where they run in one.
        residual: (B, 1, H, W) grey levels, root mean square over the window of what displacement and illumination left
            unexplained before the last step; NaN where that is. Noise alone leaves 0.42 of its standard deviation
            (0.66 with "edges").
    """

    displacement: Tensor
    covariance: Tensor
    residual: Tensor


class FlowTemplate(NamedTuple):
    """Precomputed data of a first image (B, 1, H, W), from which `find_flow` computes the flow to any later image."""

    value: Tensor  # (C B, 1, H, W) splines of the C constant quantities, at the pixels
    gradient: Tensor  # (C B, 2, H, W) gradients of the splines, 0 outside the mask
    inside: Tensor  # (B, 1, H, W), 1 in the mask, else 0
    levels: list[Level]
    # (B, 3, h, w) products of the slopes, xx, xy, yy: means over cells, J before integration over windows.
    products: Tensor
    variance: Tensor  # (B,) variance of the noise
    roughness: float
    constancy: Constancy
    # (B, 3, h, w) covariance on the cells of `levels`, from `_covariance`; None for a halved image.
    covariance: Tensor | None
    weights: list[float]  # weights of the window on cells
    # Template of the halved image, for a cold start; None if too small or without texture.
    coarser: "FlowTemplate | None"


def dense_flow(
    first: Tensor,
    current: Tensor,
    initial: Tensor | None = None,
    mask: Tensor | None = None,
    *,
    box: int = 9,
    roughness: float = 0.04,
    warps: int = 2,
    noise: Tensor | None = None,
    model: flow_penalty.FlowModel = "auto",
) -> Flow:
    """Compute the displacement, px, of every pixel of the image `first` to the image `current`, with covariance and
    residual.

    Args:
        first, current: (B, 1, H, W), 8 to 16 bit or floating.
        initial: (B, 2, H, W) px, within a quarter of a ridge's period of the truth. Non-finite values count as 0. By
            default it is computed from the halved images, starting at 0.
        mask: (B, 1, H, W) bool of the pixels of `first` that belong to the skin; all by default. Pixels outside it
            affect the result only through the support of the spline.
        box: px; the data term is integrated by two successive boxes of this side.
        roughness: expected root mean square of the gradient of the displacement's departure from its trend. Smaller is
            smoother.
        warps: number of warps of the current image, and of each halved one. A warm start needs 1, a cold start 2,
            motion of a quarter of a period 3.
        noise: (B,) standard deviation of white noise, grey levels; estimated from `first` by default.
        model: "quadratic" is for skin that moves as a whole, by `box`, `roughness` and `warps`. "charbonnier", with the
            same settings, is for objects that do not move with the skin (dust on the glass: less than half of the
            error). It takes twice the time, and needs one more warp. "edges" is for motion boundaries (photographs,
            a jump at the border of slip): Charbonnier's penalty, grey levels and their gradients constant, box 5,
            roughness 0.15 and five warps; two to four times the time, and on smooth skin twice the error. "auto"
            takes "quadratic", or "edges" for an image where that leaves a residual unlike noise in 0.4 times as many
            pixels or fewer.
            With Charbonnier's penalty the covariance is that of the weighted system, with its weights taken as fixed.

    Raises:
        ValueError: shapes do not match, or a setting is out of range.

    Source: Bruhn, Weickert, Schnoerr, IJCV 61(3), 2005; the module states the equation and what differs.
    Compiled twins: `kernels/flow_cells.cpp`, `kernels/flow_multigrid.cpp`.

    Convention:
        axes: channels are (u, v) px, u along x to the right, v along y down.
        sign: the skin at x in `first` is at x + w in `current`.
        pixel centre: values lie at the centres of the pixels of `first`.
        dtype: float32, or float64 if the frames are.
        NaN: in a pixel of `first`, leaves the displacement around it NaN.
        border: NaN where a displaced pixel lies outside the current image.
    """
    _check_choice("model", model, flow_penalty.FlowModel)
    return whole_flow(first, current, initial, mask, noise, box, roughness, warps, model)


def _like_flow(first: Tensor, *rest: Any) -> "Flow":
    batch, _, height, width = first.shape
    dtype = torch.float64 if first.dtype == torch.float64 else torch.float32
    sizes = ((2,), (2, 2), (1,))
    return Flow(*(first.new_empty((batch, *size, height, width), dtype=dtype) for size in sizes))


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
    model: str,
) -> Flow:
    """Compute `dense_flow` as one op that torch does not trace, since the number of halved images and the choice of the
    model depend on data.
    """
    if not len(first):
        return _like_flow(first)
    if model == "edges":
        return _flow_with_edges(first, current, initial, mask, noise)[0]
    template = prepare_flow(first, mask, box=box, roughness=roughness, noise=noise)
    flow = find_flow(template, current, initial, warps, "charbonnier" if model == "charbonnier" else "quadratic")
    if model != "auto":
        return flow
    share = _unlike_noise(flow, template)
    chosen = (share > _LEAST_SHARE).nonzero().squeeze(1)
    if not len(chosen):
        return flow
    selected = [None if tensor is None else tensor[chosen] for tensor in (first, current, initial, mask, noise)]
    again, left = _flow_with_edges(*selected)  # type: ignore[arg-type]  # images are given
    better = left < _BETTER * share[chosen]
    return Flow(*(tensor.index_copy(0, chosen[better], new[better]) for tensor, new in zip(flow, again, strict=True)))


def _flow_with_edges(
    first: Tensor, current: Tensor, initial: Tensor | None, mask: Tensor | None, noise: Tensor | None
) -> tuple[Flow, Tensor]:
    """Return the flow by the model for scenes with motion boundaries (robust penalty), and the share (B,) of the flow's
    pixels whose residual exceeds what image noise explains.
    """
    settings: dict[str, Any] = {"box": _EDGE_BOX, "roughness": _EDGE_ROUGHNESS, "constancy": "both"}
    template = prepare_flow(first, mask, noise=noise, **settings)
    flow = find_flow(template, current, initial, _EDGE_WARPS, "charbonnier")
    return flow, _unlike_noise(flow, template)


def _unlike_noise(flow: Flow, template: FlowTemplate) -> Tensor:
    """Return the share (B,), among the pixels with a known flow, of those whose residual exceeds what image noise
    explains.
    """
    limit = _UNLIKE_NOISE * LEFT_BY_NOISE[template.constancy] * template.variance.sqrt()[:, None, None, None]
    seen = finite(flow.residual).sum((1, 2, 3)).clamp_min(1)
    return (flow.residual > limit).sum((1, 2, 3)) / seen


def prepare_flow(
    first: Tensor,
    mask: Tensor | None = None,
    *,
    box: int = 9,
    roughness: float = 0.04,
    noise: Tensor | None = None,
    constancy: Constancy = "brightness",
) -> FlowTemplate:
    """Precompute the data of a first image that `find_flow` needs; the arguments are those of `dense_flow`.

    `constancy` is "brightness", or "both" for the grey levels and their gradients.
    """
    _check_image("first", first, first)
    if mask is not None and (mask.shape != first.shape or mask.dtype != torch.bool):
        raise ValueError(f"mask must be bool {tuple(first.shape)}, not {mask.dtype} {tuple(mask.shape)}")
    if box < 1 or box % 2 == 0 or not roughness > 0:
        raise ValueError(f"box must be odd and at least 1 px, roughness above 0, not {box} and {roughness}")
    _check_choice("constancy", constancy, Constancy)
    dtype = torch.float64 if first.dtype == torch.float64 else torch.float32
    variance = (estimate_noise(first) if noise is None else noise).to(dtype).square()
    variance = variance.nan_to_num(0.0).clamp_min(max(rounding_variance(first), _TINY))
    everywhere = torch.ones_like(first, dtype=torch.bool) if mask is None else mask
    template = _build_template(first.to(dtype), everywhere.to(dtype), variance, box, roughness, constancy)
    return template._replace(covariance=_covariance(template, template.levels[0]))


def _build_template(
    first: Tensor, mask: Tensor, variance: Tensor, box: int, roughness: float, constancy: Constancy
) -> FlowTemplate:
    """Return the flow template of an image, which includes the templates of successively halved images as long as
    texture exceeds the noise.

    The image is floating point. The covariance is left None.
    """
    values = channels(spline_coefficients(first), constancy)
    count = len(values) // len(first)
    value, gradient, inside, tensor, *cells = _fields(values, mask if count == 1 else mask.repeat(count, 1, 1, 1))
    # A pixel that is unknown in one channel is unknown in all.
    inside, textured, right, down = (_channel_minimum(field, count) for field in (inside, *cells))
    products = _sum(tensor, count)
    weights = flow_cells.window(max(box / flow_cells.CELL, 1.0))
    tensor = textured * flow_cells.integrated(products, weights)
    alpha = _smoothing(variance, roughness)
    energy = (tensor[:, 0] + tensor[:, 2]).sum((1, 2)) / textured.sum((1, 2, 3)).clamp_min(1)
    of_noise = _noise_of_tensor(variance, constancy)
    lasts = (energy > limits.TEXTURE_TO_NOISE * 2 * of_noise).all()
    coarser = None
    if min(first.shape[-2:]) >= 2 * _SMALLEST_SIDE and lasts:
        # A mean of four pixels has a fourth of the noise variance, and is unknown where one of the four is.
        all_known = (halved_image(inside) == 1).to(inside.dtype)
        coarser = _build_template(halved_image(first), all_known, variance / 4, box, roughness, constancy)
    levels = pyramid(tensor, alpha * right, alpha * down, textured)
    return FlowTemplate(
        value, gradient, inside, levels, products, variance, roughness, constancy, None, weights, coarser
    )


def _covariance(template: FlowTemplate, finest: Level) -> Tensor:
    """Return the covariance xx, xy, yy (B, 3, h, w), px^2, of the flow due to image noise, on the cells of the finest
    multigrid level, for images of equal illumination (a gain of 1).
    """
    alpha = _smoothing(template.variance, template.roughness)
    if finest is not template.levels[0]:
        alpha = alpha * flow_penalty.mean_edge_weight(finest, template.levels[0])
    of_noise = _noise_of_tensor(template.variance, template.constancy)
    return flow_covariance(
        finest.tensor, template.variance, alpha, flow_cells.window_variance(template.weights), of_noise
    )


def _channel_minimum(fields: Tensor, count: int) -> Tensor:
    """Return the minimum (B, ...) over `count` channels of fields (count B, ...), whose batch axis holds all frames of
    one channel after the other.
    """
    return fields if count == 1 else fields.unflatten(0, (count, -1)).amin(0)


def _sum(fields: Tensor, count: int) -> Tensor:
    return fields if count == 1 else fields.unflatten(0, (count, -1)).sum(0)


def _noise_of_tensor(variance: Tensor, constancy: Constancy) -> Tensor:
    """Return the eigenvalue (B,) that the structure tensor of an image without texture has from white noise of the
    given pixel `variance` (B,) alone.
    """
    return NOISE_OF_TENSOR[constancy] * limits.GRADIENT_NOISE * variance


def _smoothing(variance: Tensor, roughness: float) -> Tensor:
    """Return the weight alpha = 2 variance / roughness^2 (B, 1, 1, 1) of the smoothness term in dense flow, from the
    noise `variance` (B,) of a pixel and the `roughness`, the expected size of the flow's gradient.
    """
    return (2 * variance / roughness**2)[:, None, None, None]


def _fields(coefficients: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
    """Return what dense flow needs of a first image: its spline (B, 1, H, W) and slopes (B, 2, H, W), 0 outside the
    mask, at the pixels; the mask, 1 or 0; means over cells of 2 x 2 px of the products xx, xy, yy of the slopes (B, 3,
    h, w); the cells (B, 1, h, w) with a pixel in the mask; and the weights of the edges to the next cell of the row and
    of the column.

    The products are not yet integrated over windows. `coefficients` of the spline and `mask` are (B, 1, H, W).
    """
    if _compiled_fields.serves(coefficients, mask):
        return _compiled_fields(coefficients, mask, _MARGIN)
    usable = finite(coefficients)
    # The spline at a pixel uses the coefficients of its neighbours, so these must be known too.
    inside = -functional.max_pool2d(-usable.to(mask.dtype), 3, 1, 1) * mask
    clean = torch.where(usable, coefficients, 0.0)
    still = clean.new_zeros(len(clean), 2, *clean.shape[-2:])
    value = _sampled(clean, still)  # sampled as in `find_flow`, so that zero motion leaves no residual
    gradient = _slopes(clean) * _stays_inside(still, inside, _MARGIN)
    x, y = gradient[:, :1], gradient[:, 1:]
    tensor = flow_cells.halved(torch.cat((x * x, x * y, y * y), dim=1))
    textured = (flow_cells.halved(inside) > 0).to(inside.dtype)
    return value, gradient, inside, tensor, textured, *halved_edges(*edges(inside))


def find_flow(
    template: FlowTemplate,
    current: Tensor,
    initial: Tensor | None = None,
    warps: int = 2,
    penalty: flow_penalty.Penalty = "quadratic",
) -> Flow:
    """Compute the flow from a prepared first image to a current image; the arguments are those of `dense_flow`.

    `penalty` is that of both terms, "quadratic" or "charbonnier".
    """
    _check_image("current", current, template.inside)
    _check_choice("penalty", penalty, flow_penalty.Penalty)
    if warps < 1:
        raise ValueError(f"warps must be at least 1, not {warps}")
    shape = (len(current), 2, *current.shape[-2:])
    if initial is not None and initial.shape != shape:
        raise ValueError(f"initial must be {shape}, not {tuple(initial.shape)}")
    image = current.to(template.value.dtype)
    if initial is None:
        flow = _initial_flow(template, image, warps, penalty)
    else:
        flow = flow_cells.to_cells(initial.to(image.dtype), template.inside)
    flow, left, finest = _refined(template, image, flow, warps, penalty)
    covariance = template.covariance
    if covariance is None or penalty == "charbonnier":
        covariance = _covariance(template, finest)
    return _to_pixels(template, flow, left, covariance)


def _to_pixels(template: FlowTemplate, flow: Tensor, left: flow_penalty.FlowResidual, covariance: Tensor) -> Flow:
    """Interpolate the flow, its covariance and the image residual from cells of 2 x 2 px to the pixels of the first
    image; return them as a `Flow`.

    `left` is the residual before the last step, `covariance` that at a gain of 1.
    """
    size = template.inside.shape[-2:]
    valid = template.levels[0].inside
    # Half of the covariance is due to noise of the first image, half to the current one, whose part grows with falling
    # gain.
    _, *fields, gain = left
    covariance = covariance * ((1 + 1 / (gain * gain)) / 2)
    squares, seen = (flow_cells.integrated(field, template.weights) for field in fields)
    residual = (squares / seen.clamp_min(_TINY)).sqrt()
    deviations = torch.cat((covariance, residual), dim=1)
    displacement = flow_cells.to_pixels(flow, valid, *size)
    xx, xy, yy, residual = flow_cells.spread(deviations, valid, *size).split(1, dim=1)
    lost = torch.where(_stays_inside(displacement, template.inside) > 0, 0.0, torch.nan).to(flow.dtype)
    rows = torch.cat((xx, xy, xy, yy), dim=1) + lost
    return Flow(displacement + lost, rows.unflatten(1, (2, 2)), residual + lost)


def _initial_flow(template: FlowTemplate, current: Tensor, warps: int, penalty: flow_penalty.Penalty) -> Tensor:
    """Estimate an initial flow from successively halved images; it is 0 if the template has no halved image."""
    batch, _, height, width = template.levels[0].inside.shape
    coarser = template.coarser
    if coarser is None:
        return template.value.new_zeros(batch, 2, height, width)
    half = halved_image(current)
    coarse, _, _ = _refined(coarser, half, _initial_flow(coarser, half, warps, penalty), warps, penalty)
    # Pixels of the halved images are cells of the full ones.
    wide = 2 * flow_cells.to_pixels(coarse, coarser.levels[0].inside, *half.shape[-2:])
    return functional.pad(wide, (0, width - half.shape[-1], 0, height - half.shape[-2]), mode="replicate")


def _refined(
    template: FlowTemplate, current: Tensor, flow: Tensor, warps: int, penalty: flow_penalty.Penalty
) -> tuple[Tensor, flow_penalty.FlowResidual, Level]:
    """Refine a flow on cells by `warps` rounds: each warps the current image by the flow, and solves a linear system
    for the flow that reduces the remaining image difference.

    Also return the residual before the last warp, and the finest multigrid level that was solved.
    """
    coefficients = channels(spline_coefficients(current), template.constancy)
    for warp in range(warps):
        left = _residual(template, coefficients, flow)
        data, _, seen, _ = left
        valid, levels = (seen > 0).to(flow.dtype), template.levels
        if penalty == "charbonnier":
            of_data = flow_penalty.data_weights(left, LEFT_BY_NOISE[template.constancy] ** 2 * template.variance)
            tensor = flow_cells.integrated(of_data * template.products, template.weights)
            levels = flow_penalty.weighted_levels(levels[0], tensor, flow, valid, template.roughness)
            data = of_data * data
        pull = -levels[0].inside * flow_cells.integrated(data, template.weights)
        # Warps before the last one only bring the image close enough to be linearised.
        flow = descended(levels, pull, flow, valid, _CYCLES if warp + 1 == warps else 1)
    return flow, left, levels[0]


def _residual(template: FlowTemplate, coefficients: Tensor, flow: Tensor) -> flow_penalty.FlowResidual:
    """Compute the residual of a flow on cells of 2 x 2 px: what displacement and a change of illumination gain and
    offset do not explain of the difference between the two images.

    All channels (C B, 1, H, W) are taken together. Means over cells: of its products with the slopes, divided by the
    gain, (B, 2, h, w); of its squares, and of where it was seen, (B, 1, h, w). Also the illumination gain (B, 1, 1, 1).
    """
    count = len(coefficients) // len(flow)
    valid, inside = template.levels[0].inside, template.inside
    if count > 1:
        valid, inside, flow = (tensor.repeat(count, 1, 1, 1) for tensor in (valid, inside, flow))
    data, squares, seen, gain = _channel_residuals(coefficients, template.value, template.gradient, inside, flow, valid)
    # The slopes are those of the first image. In the current one they scale with the gain, and J with its square.
    mean_gain = gain if count == 1 else _sum(gain, count) / count
    return _sum(data / gain, count), _sum(squares, count), _channel_minimum(seen, count), mean_gain


def _channel_residuals(
    coefficients: Tensor, value: Tensor, gradient: Tensor, inside: Tensor, flow: Tensor, known: Tensor
) -> flow_penalty.FlowResidual:
    """Compute the image difference that a flow leaves (see `_residual`) separately for each channel: the grey levels
    and, if these are assumed constant too, the components of their gradient.

    As for `_residual`, but the products with the slopes are not divided by the gain.
    """
    images = coefficients, value, gradient, inside, flow, known
    if _compiled_residual.serves(*images):
        return _compiled_residual(*images, _MARGIN, limits.MOST_GAIN)
    displacement = flow_cells.to_pixels(flow, known, *coefficients.shape[-2:])
    warped = _sampled(coefficients, displacement)
    usable = finite(warped)
    seen, warped = (
        _stays_inside(displacement, inside, _MARGIN) * usable.to(inside.dtype),
        torch.where(usable, warped, 0.0),
    )
    gain, offset = _fit_gain_and_offset(value, warped, seen)
    left = seen * (warped - offset - gain * value)
    means = flow_cells.halved(torch.cat((gradient * left, left * left, seen), dim=1))
    return means[:, :2], means[:, 2:3], means[:, 3:], gain


def _slopes(coefficients: Tensor) -> Tensor:
    """Return the derivatives (B, 2, H, W) of the spline in x and y at whole pixels."""
    wide = functional.pad(coefficients, (1, 1, 1, 1), mode="replicate")
    smooth = (wide[..., :-2, :] + 4 * wide[..., 1:-1, :] + wide[..., 2:, :]) / 6
    change = (wide[..., 2:, :] - wide[..., :-2, :]) / 2
    across = (smooth[..., 2:] - smooth[..., :-2]) / 2
    down = (change[..., :-2] + 4 * change[..., 1:-1] + change[..., 2:]) / 6
    return torch.cat((across, down), dim=1)


def _sampled(coefficients: Tensor, flow: Tensor) -> Tensor:
    """Evaluate the spline of an image at displaced pixels; beyond the border the coefficients are replicated."""
    height, width = coefficients.shape[-2:]
    whole = flow.floor()
    (weights_x, _), (weights_y, _) = (spline_weights(flow[:, k : k + 1] - whole[:, k : k + 1]) for k in (0, 1))
    column = torch.arange(width, device=flow.device) + whole[:, :1].to(torch.int64)
    row = torch.arange(height, device=flow.device)[:, None] + whole[:, 1:].to(torch.int64)
    columns = [(column + k).clamp(0, width - 1) for k in range(-1, 3)]
    flat = coefficients.flatten(1)
    values = torch.zeros_like(coefficients)
    for k in range(4):
        start = (row + (k - 1)).clamp(0, height - 1) * width
        line = torch.zeros_like(coefficients)
        for weight, index in zip(weights_x, columns, strict=True):
            line = line + weight * flat.gather(1, (start + index).flatten(1)).unflatten(1, (1, height, width))
        values = values + weights_y[k] * line
    return values


def _stays_inside(flow: Tensor, inside: Tensor, margin: int = 0) -> Tensor:
    """Return 1 for the pixels of a mask (`inside`, 1 or 0) that their displacement `flow`, px, leaves at least `margin`
    px inside the frame, else 0.
    """
    height, width = flow.shape[-2:]
    x = torch.arange(width, dtype=flow.dtype, device=flow.device) + flow[:, :1]
    y = torch.arange(height, dtype=flow.dtype, device=flow.device)[:, None] + flow[:, 1:]
    within = (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
    return inside * within.to(inside.dtype)


def _fit_gain_and_offset(value: Tensor, warped: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """Fit the illumination gain and offset (B, 1, 1, 1) with which the grey levels `value` of the first image best
    reproduce those of the `warped` current image, over the pixels `seen` in both.

    The fit is by least squares.
    """
    count = seen.sum((1, 2, 3), keepdim=True).clamp_min(1)
    mean, mean_warped = ((seen * values).sum((1, 2, 3), keepdim=True) / count for values in (value, warped))
    deviation = seen * (value - mean)
    energy = (deviation * deviation).sum((1, 2, 3), keepdim=True)
    gain = (deviation * (warped - mean_warped)).sum((1, 2, 3), keepdim=True) / energy.clamp_min(_TINY)
    # An uncorrelated image could have a gain near 0 or below; such a gain is replaced by 1.
    gain = torch.where(gain > 1 / limits.MOST_GAIN, gain.clamp_max(limits.MOST_GAIN), 1.0)
    return gain, mean_warped - gain * mean


def _check_choice(name: str, choice: str, choices: Any) -> None:
    if choice not in get_args(choices):
        raise ValueError(f"{name} must be one of {get_args(choices)}, not {choice!r}")


def _check_image(name: str, image: Tensor, like: Tensor) -> None:
    if image.ndim != 4 or image.shape[1] != 1 or image.shape != like.shape:
        raise ValueError(f"{name} must be (B, 1, H, W), as large as the other image, not {tuple(image.shape)}")
    if min(image.shape[-2:]) < 8:
        raise ValueError(f"{name} must be at least 8 x 8 px, not {tuple(image.shape[-2:])}")
