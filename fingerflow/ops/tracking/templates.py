"""Templates of points, prepared once in a key frame and registered in later frames by Lucas-Kanade steps.

A template is the spline of the key frame on the window of a point, deformed as the skin has been since. With the
deformation gradient F, its sample at the offset w in a frame is S_key(p + F^-1 w). The point lies at the y that solves
sum_w g(w) (S(y + w) - T(w)) = 0, with the gradient g of T (Lucas & Kanade 1981). If gain and offset are free, the
components of g along a constant and along T are removed; then the equation holds for any gain and offset.

*A step.* The window M is sampled at the predicted position. Its slopes are approximated by the gain a times those of
the template. A step then only needs sum g g', known from the key frame (Baker & Matthews, "Lucas-Kanade 20 years on",
IJCV 2004). It misses the root by 1 % of its length (window 25) to 2.4 % (window 11) at a noise of 2 grey levels. A step
shorter than 0.1 px ends the search; the remaining error is at most a fifteenth of a standard deviation. After a longer
step, another one starts from its end.

*Backward check.* The same equation from the found position back to the template has the slopes of the frame, grad M = a
grad T + grad D, with the residual D = M - a T - b. Linearised, and since a root satisfies sum D grad T = 0, the two
directions differ by the sum of D grad D. Over a window this is half the difference of D^2 between opposite edges.

A step has a fixed cost and no data-dependent branch, so this portable form is the one that is exported.

Compiled twin: `kernels/templates.cpp`.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.result_records import TrackedPoints
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.kernels.tracking_limits import ROUNDING, ROUNDS, Number, TrackStatus
from fingerflow.ops.checks import check_frames, check_pixels
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.filters.windows import sample_windows
from fingerflow.ops.tensors import components_first, finite, scalar_products, sum_rows
from fingerflow.ops.tracking.spline_windows import (
    along_x,
    along_y,
    cut_patches,
    cut_windows,
    onto_pixels,
    taps_and_slopes,
)

_TINY = 1e-20
_prepare: Twin[tuple[Tensor, ...]] = twin("prepare_templates")


class Templates(NamedTuple):
    """Templates of B x N points: grey levels and slopes in a window of n x n px around each point of the key frame, and
    statistics, which registration in later frames needs.

    Attributes:
        start: (B, N, 2) px in the key frame, NaN where there is no point.
        samples: (B, N, 3, n n): values minus their mean, grey levels; then gx and gy, grey levels per px.
        numbers: (B, N, 32) template statistics, see :class:`~fingerflow.kernels.tracking_limits.Number`.
    """

    start: Tensor
    samples: Tensor
    numbers: Tensor

    @property
    def window(self) -> int:
        """Return the side n of the template windows, px."""
        return round(self.samples.shape[-1] ** 0.5)

    def of(self, chosen: Tensor) -> "Templates":
        """Return the templates of the points with indices `chosen` (B, L), int64."""
        return Templates._make(take_rows(values, chosen) for values in self)


def prepare_templates(
    image: Tensor,
    points: Tensor,
    window: int = 21,
    warp: Tensor | None = None,
    *,
    gain_offset: bool = True,
    noise: Tensor | None = None,
) -> Templates:
    """Prepare the templates of points in a key frame, the grey levels and slopes in a window around each, for
    registration in later frames.

    Args:
        image: (B, 1, H, W), 8 to 16 bit or floating.
        points: (B, N, 2) (x, y) px; the template of a non-finite point matches nothing.
        window: odd side of the square window, px.
        warp: (B, N, 2, 2) deformation gradient F since the key frame: an offset w there is F w in later frames.
        gain_offset: leave gain and offset of the illumination free in every window. If False, three grey levels more
            light move a point by 0.1 px on ridges.
        noise: (B,) standard deviation of white noise, grey levels; estimated by default.

    Raises:
        ValueError: shapes do not match, or the window is even or too small.
    """
    check_points(image, points, window, warp)
    dtype = torch.float64 if image.dtype == torch.float64 else torch.float32
    variance = (estimate_noise(image) if noise is None else noise).to(dtype).square()
    rounding = rounding_variance(image)
    given = points.to(dtype)
    inverse = None if warp is None else inverse_2x2(warp.to(dtype))
    if _prepare.serves(image, given, inverse, variance):
        return Templates(*_prepare(image, given, inverse, variance, window, int(gain_offset), rounding))
    if inverse is not None:
        spline = spline_coefficients(image)
        return _sample_templates(
            spline, given, inverse, window, gain_offset=gain_offset, variance=variance, rounding=rounding
        )
    valid = finite(given).all(-1, keepdim=True)
    position = torch.where(valid, given, 0.0)
    sampled = _sample_straight(image, position, window)
    return _assemble(sampled, position, valid, image, gain_offset=gain_offset, variance=variance, rounding=rounding)


def renew_templates(
    coefficients: Tensor, noise: Tensor, points: Tensor, window: int, warp: Tensor, *, gain_offset: bool = True
) -> Templates:
    """Prepare the templates of points in a key frame again, for a new deformation `warp` (template update), from the
    spline coefficients and the noise of the key frame.

    This is the exported form of `prepare_templates`, for key frames with integer grey levels.

    Args:
        coefficients: (B, 1, H, W) of the key frame (`spline_coefficients`).
        noise: (B,) standard deviation of white noise, grey levels.
        points, window, warp, gain_offset: as for `prepare_templates`.
    """
    dtype = coefficients.dtype
    inverse, variance = inverse_2x2(warp.to(dtype)), noise.to(dtype).square()
    given = coefficients, points.to(dtype), inverse, window
    return _sample_templates(*given, gain_offset=gain_offset, variance=variance, rounding=ROUNDING)


def _sample_templates(coefficients: Tensor, points: Tensor, inverse: Tensor, window: int, **settings: Any) -> Templates:
    """Compute the templates of points `points` (B, N, 2) by sampling the spline of the key frame on windows deformed by
    the inverse deformation gradients `inverse` (B, N, 2, 2).

    The template of a point or deformation that is not finite is a placeholder.
    """
    valid = finite(points).all(-1, keepdim=True) & finite(inverse).flatten(2).all(-1, keepdim=True)
    inverse = torch.where(valid[..., None], inverse, torch.eye(2, dtype=points.dtype, device=points.device))
    position = torch.where(valid, points, 0.0)
    batch, count = position.shape[:2]
    image_index = torch.arange(batch, device=position.device)[:, None].expand(batch, count).flatten()
    sampled = sample_windows(coefficients, image_index, position.flatten(0, 1), window, inverse.flatten(0, 1))
    return _assemble(sampled, position, valid, coefficients, **settings)


def _assemble(
    sampled: tuple[Tensor, Tensor],
    position: Tensor,
    valid: Tensor,
    image: Tensor,
    *,
    gain_offset: bool,
    variance: Tensor,
    rounding: float,
) -> Templates:
    """Compute the templates of points at `position` (B, N, 2) from the grey levels (P, n, n) and slopes (P, 2, n, n)
    `sampled` in their windows, P = B N.

    `valid` is False for positions that are placeholders.
    """
    samples, slope = sampled[0].flatten(1), sampled[1].flatten(2)
    batched, window = position.shape[:2], sampled[0].shape[-1]
    level = samples.mean(1, keepdim=True)
    samples = samples - level
    gradient = without_gain_and_offset(samples, slope) if gain_offset else slope
    numbers = _numbers(
        samples, slope, gradient, level.flatten(), variance.repeat_interleave(batched[1]), rounding, gain_offset
    )
    numbers[:, Number.INSIDE] = contains(position.flatten(0, 1), image, window).to(samples.dtype)
    return Templates(
        torch.where(valid, position, torch.nan),
        torch.cat((samples[:, None], gradient), dim=1).unflatten(0, batched),
        numbers.unflatten(0, batched),
    )


def find_templates(
    templates: Templates,
    current: Tensor,
    prediction: Tensor,
    *,
    rounds: int = ROUNDS,
    forward_backward_limit: float = 1.0,
    mismatch_limit: float = limits.MISMATCH_SHARE,
    noise: Tensor | None = None,
) -> TrackedPoints:
    """Register templates in a frame, each near the predicted position of a point.

    The covariance is H^-1 (sum w w') H^-1 (sigma^2 / a^2 + sigma_key^2). H = sum g g', w are the weights of the pixels
    in sum g S, and a is the gain. The noise of both images is estimated together from the residual; for equal
    noise and a gain of 1, half of it is that of the template.

    Args:
        templates: from :func:`prepare_templates`.
        current: (B, 1, H, W).
        prediction: (B, N, 2) px.
        rounds: maximum number of steps, each at most a pixel in x and in y. More than one depends on data and cannot be
            exported.
        forward_backward_limit: px; a point whose forward-backward distance exceeds it is flagged.
        mismatch_limit: largest share of the template's variance, without the noise, that the match may leave
            unexplained.
        noise: (B,) standard deviation of white noise in the frame, grey levels; that of the key frame by default.
    """
    dtype = templates.samples.dtype
    variance = None if noise is None else noise.to(dtype).square()
    guess = prediction.to(dtype)
    settings = (rounding_variance(current), forward_backward_limit, mismatch_limit)
    if (
        kernels.serve(current, guess, variance, *templates)
        and current.dtype in kernels.FRAME_KINDS
        and dtype == torch.float32
    ):
        followed = kernels.find_templates(list(templates), current, guess, None, variance, rounds, *settings)
        return TrackedPoints(*[values[0] for values in followed[:5]])

    def step(part: Templates, near: Tensor) -> TrackedPoints:
        return _step(part, current, near, variance, *settings)

    tracks = step(templates, guess)
    for _ in range(rounds - 1):  # depends on data, and cannot be exported
        lost = tracks.status == TrackStatus.NOT_CONVERGED
        if not lost.any():
            break
        chosen = first_rows(lost)
        again = step(templates.of(chosen), take_rows(tracks.estimate, chosen))
        tracks = replaced(tracks, again, chosen, lost)
    return tracks


def first_rows(mask: Tensor) -> Tensor:
    """Return the indices (B, L) of points marked in `mask` (B, N), then others, so that each frame has L indices.

    L is the smallest power of 2 that holds them (at most N), so that compiled code sees few sizes.
    """
    size = 1 << (int(mask.sum(1).max()) - 1).bit_length()
    return mask.to(torch.uint8).argsort(dim=1, descending=True, stable=True)[:, :size]


def take_rows(tensor: Tensor, chosen: Tensor) -> Tensor:
    """Return the rows (B, L, ...) of a tensor (B, N, ...) with indices `chosen` (B, L), int64."""
    batch, count = tensor.shape[:2]
    index = chosen + torch.arange(batch, device=chosen.device)[:, None] * count
    # Copying whole rows is many times as fast as gathering their elements.
    return tensor.flatten(0, 1).index_select(0, index.flatten()).unflatten(0, chosen.shape)


def replaced(tracks: TrackedPoints, again: TrackedPoints, chosen: Tensor, mask: Tensor) -> TrackedPoints:
    """Return `tracks` (B, N) with the results `again` of points `chosen` (B, L) inserted where `mask` (B, N)."""
    return TrackedPoints(*[inserted(whole, part, chosen, mask) for whole, part in zip(tracks, again, strict=True)])


def inserted(whole: Tensor, part: Tensor, chosen: Tensor, mask: Tensor) -> Tensor:
    """Return `whole` (B, N, ...) with the rows `part` (B, L, ...) of points `chosen` inserted where `mask` (B, N)."""
    extra = [1] * (whole.ndim - 2)
    index = chosen.reshape(*chosen.shape, *extra).expand_as(part)
    return torch.where(mask.reshape(*mask.shape, *extra), whole.scatter(1, index, part), whole)


def check_points(image: Tensor, points: Tensor, window: int, warp: Tensor | None) -> None:
    """Raise ValueError if the image, the points, the window or the deformation cannot be used for tracking."""
    check_frames(image)
    check_pixels(image, 4)
    if points.ndim != 3 or points.shape[0] != image.shape[0] or points.shape[2] != 2:
        raise ValueError(f"points must be (B, N, 2) with B = {image.shape[0]}, not {tuple(points.shape)}")
    if not points.is_floating_point():
        raise ValueError(f"points must be floating point, not {points.dtype}: use points.float()")
    if window < 5 or window % 2 == 0:
        raise ValueError(f"window must be odd and at least 5 px, not {window}")
    if warp is not None and warp.shape != (*points.shape, 2):
        raise ValueError(f"warp {tuple(warp.shape)} must be {(*points.shape, 2)}: one 2 x 2 matrix a point")


def contains(points: Tensor, image: Tensor, window: int) -> Tensor:
    """Return a mask of the points (..., 2) whose whole window lies in the image, with a tolerance of `SLACK` px."""
    height, width = image.shape[-2:]
    half = window // 2
    least = half - limits.SLACK
    x, y = points.unbind(-1)
    return (x >= least) & (y >= least) & (x <= width - 1 - least) & (y <= height - 1 - least)


def inverse_2x2(matrix: Tensor) -> Tensor:
    """Return the inverses of matrices (..., 2, 2); not finite where a matrix is singular."""
    a, b, c, d = matrix.flatten(-2).unbind(-1)
    return torch.stack((d, -b, -c, a), dim=-1).unflatten(-1, (2, 2)) / (a * d - b * c)[..., None, None]


def _sample_straight(image: Tensor, position: Tensor, wide: int) -> tuple[Tensor, Tensor]:
    """Sample the spline of an image, and the spline's slopes, on undeformed windows of `wide` x `wide` px around points
    (B, N, 2) px.
    """
    transposed = position.transpose(1, 2)
    center = transposed.round()
    patches = cut_patches(image, center, wide, position.dtype)
    # Minus the mean, so that a constant patch has zero slope in any precision.
    base = patches.mean((1, 2), keepdim=True)
    weights, slopes = taps_and_slopes((transposed - center).transpose(1, 2).flatten(0, 1))  # (P, 2, 5)
    lines, bent = along_y(weights[:, 1], wide) @ (patches - base), along_y(slopes[:, 1], wide) @ (patches - base)
    across = along_x(weights[:, 0], wide)
    along = torch.stack((lines @ along_x(slopes[:, 0], wide), bent @ across), dim=1)
    return lines @ across + base, along


def without_gain_and_offset(value: Tensor, slope: Tensor) -> Tensor:
    """Remove from slopes (P, 2, samples) the components that a change of illumination gain or offset would also cause.

    These are the components along the values (P, samples) and along a constant. The values sum to 0.
    """
    centred = slope - slope.mean(2, keepdim=True)
    share = (centred @ value[..., None]) / (value * value).sum(1).clamp_min(_TINY)[:, None, None]
    return centred - share * value[:, None]


def _numbers(
    value: Tensor, slope: Tensor, gradient: Tensor, level: Tensor, variance: Tensor, rounding: float, gain_offset: bool
) -> Tensor:
    samples = value.shape[1]
    xx, xy, yy = ((gradient[:, i] * gradient[:, j]).sum(1) for i, j in ((0, 0), (0, 1), (1, 1)))
    determinant = xx * yy - xy * xy
    regular = determinant > _TINY
    safe = torch.where(regular, determinant, 1.0)
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    smaller = mean - (half * half + xy * xy).sqrt()
    floor = variance.clamp_min(rounding) * (limits.TEXTURE_TO_NOISE * samples * limits.GRADIENT_NOISE)
    textured = regular & (smaller > torch.maximum(floor, limits.LEAST_TEXTURE * mean))
    inverse = torch.stack((yy, -xy, -xy, xx), dim=1).unflatten(1, (2, 2)) / safe[:, None, None]
    inverse = torch.where(regular[:, None, None], inverse, 0.0)
    side = round(samples**0.5)
    offset = torch.arange(side, dtype=value.dtype, device=value.device) - side // 2
    right, down = offset.repeat(side), offset.repeat_interleave(side)
    # Indexed by i and m: a deformation E_im changes the window by slope_i w_m. A shift absorbs H^-1 sum g_j slope_i w_m
    # of it, gain and offset another part; the rest stays in the residual.
    bent = torch.stack((slope[:, 0] * right, slope[:, 0] * down, slope[:, 1] * right, slope[:, 1] * down), dim=1)
    if gain_offset:
        bent = without_gain_and_offset(value, bent)
    pushing = gradient @ bent.transpose(1, 2)
    lean = inverse @ pushing
    bending = bent @ bent.transpose(1, 2) - pushing.transpose(1, 2) @ lean
    bending = bending * (2 - torch.eye(4, dtype=bending.dtype, device=bending.device))  # each pair counts twice
    constant = (gradient @ value[..., None]).squeeze(2)
    unit = torch.ones_like(level)
    return torch.cat(
        (
            torch.stack((inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1], (value * value).sum(1), level), dim=1),
            constant,
            torch.stack((variance, textured.to(value.dtype), unit, unit * float(gain_offset)), dim=1),
            lean.flatten(1),
            _covariance_of_noise(inverse, gradient),
            *(bending[:, k, k:] for k in range(4)),
        ),
        dim=1,
    )


def _covariance_of_noise(inverse: Tensor, gradient: Tensor) -> Tensor:
    """Return the covariance xx, xy, yy (P, 3), px^2, of a registered position due to white noise of variance 1 in each
    pixel, from the inverse normal matrix and the slopes `gradient` of the window.

    It is H^-1 (sum w w') H^-1 with the weights w of the pixels in sum g S, for H^-1 (P, 2, 2) and g (P, 2, samples):
    the Cramér-Rao bound H^-1 but for the smoothing by the spline.
    """
    side = round(gradient.shape[2] ** 0.5)
    weights = onto_pixels(gradient.unflatten(2, (side, side)), side).flatten(2)
    covariance = inverse @ (weights @ weights.transpose(1, 2)) @ inverse
    return torch.stack((covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]), dim=1)


def _step(
    templates: Templates,
    current: Tensor,
    prediction: Tensor,
    variance: Tensor | None,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> TrackedPoints:
    window, dtype = templates.window, templates.samples.dtype
    # From here on components before points, (B, K, N): ONNX runtimes are slow if the last axis is short.
    start, guess = components_first(templates.start), components_first(prediction)
    known_guess = finite(start - guess)[:, :1]
    guess = torch.where(finite(guess), guess, 0.0)
    numbers = templates.numbers.transpose(1, 2)
    of = numbers[:, : Number.LEAN].split(1, dim=1)
    inverse = numbers[:, Number.INVERSE_XX : Number.INVERSE_YY + 1]
    # `.value`: the compiler does not terminate if an index is a member of an enumeration.
    free, energy, level = of[Number.GAIN.value], of[Number.ENERGY.value], of[Number.LEVEL.value]
    center = guess.round()
    patches = cut_patches(current, center, window, dtype)

    matched = cut_windows((guess - center).transpose(1, 2).flatten(0, 1), patches, window) - level.reshape(-1, 1)
    # Scalar products of a window with the grey levels and with both slopes of its template.
    products = scalar_products(templates.samples.flatten(0, 1), matched[:, None])
    tm, by_slopes = components_first(products.reshape(len(start), -1, 3)).split((1, 2), dim=1)
    m1 = matched.sum(1).reshape(known_guess.shape)
    samples = window * window
    explaining = tm * tm / energy.clamp_min(_TINY)
    gain = torch.where(free > 0, tm / energy.clamp_min(_TINY), 1.0)
    offset = torch.where(free > 0, m1 / samples, 0.0)
    squares, edges = _residual(matched, templates.samples, gain, offset, window).split((1, 2), dim=1)
    # The slopes are taken as those of the template times the gain; in a short step the difference matters little.
    missing = by_slopes - numbers[:, Number.CONSTANT_X : Number.CONSTANT_Y + 1]
    steep = torch.where(gain > 0, gain.clamp_min(limits.LEAST_GAIN), 1 / limits.MOST_GAIN)
    last = _symmetric(inverse, missing / steep)
    converged = _length(last) < limits.LAST_STEP  # a singular matrix leaves NaN: not converged
    position = guess - last

    # Squared residual at the end of the step, and the part of it that contrast alone does not explain.
    left = squares - (gain * sum_rows(last * missing))
    bb = squares + torch.where(free > 0, explaining, 2 * tm - energy - m1 * m1 / samples)
    unlike = left + (bb - explaining - squares)
    pixel = (left / ((samples - 4) * limits.VALUE_NOISE)).clamp_min(2 * rounding)
    scale = pixel / (gain * gain)
    error = _length(_symmetric(inverse, edges)) / (gain * gain)

    noise = of[Number.NOISE.value] if variance is None else variance[:, None, None]
    noise_energy = noise * (samples * limits.VALUE_NOISE)
    common = (energy - noise_energy).clamp_min(0) * (bb - noise_energy).clamp_min(0)
    explained = (bb - unlike) * energy * (tm > 0)
    ends, begins = (contains(positions.transpose(1, 2), current, window)[:, None] for positions in (position, guess))
    # A search does not end with a step out of the frame or into it.
    within = (of[Number.INSIDE.value] > 0) & (ends | (begins & ~converged))
    textured, readable = of[Number.TEXTURED.value] > 0, finite(m1 + level)
    status = torch.zeros_like(known_guess, dtype=torch.int32)  # GPU runtimes compare no bytes
    # From the last reason to the first, so that the first that applies remains.
    for reason, fine in (
        (TrackStatus.FORWARD_BACKWARD, error <= forward_backward_limit),
        (TrackStatus.MISMATCH, common * (1 - mismatch_limit) <= explained),
        (TrackStatus.NOT_CONVERGED, converged),
        (TrackStatus.NO_TEXTURE, textured),
        (TrackStatus.NOT_FINITE, readable),
        (TrackStatus.LEFT_FRAME, within),
        (TrackStatus.NOT_FINITE, known_guess),
    ):
        status = torch.where(fine, status, int(reason))
    lost = torch.where(status == 0, 0.0, torch.nan).to(dtype)  # added: faster in ONNX runtimes than torch.where
    spread = numbers[:, Number.COVARIANCE_XX : Number.COVARIANCE_YY + 1]
    matrix = torch.cat((spread[:, :2], spread[:, 1:]), dim=1)
    estimate = torch.where(finite(last), guess - last.clamp(-limits.REACH, limits.REACH), guess)
    return TrackedPoints(
        (position + lost).transpose(1, 2),
        torch.where(known_guess & within & readable & textured & converged, error, torch.nan).squeeze(1),
        (scale * matrix + lost).transpose(1, 2).unflatten(2, (2, 2)),
        status.squeeze(1).to(torch.uint8),
        estimate.transpose(1, 2),
    )


def _residual(matched: Tensor, samples: Tensor, gain: Tensor, offset: Tensor, size: int) -> Tensor:
    """Return three sums (B, 3, N) of the squared difference between each matched window and its template with fitted
    gain and offset: over all pixels, and half the differences of opposite edges in x and in y.

    The sums are (B, 3, N). The residual of a window M (P, samples) is D = M - a T - b. The sums are of D^2, and of D
    grad D in x and in y: half the differences of D^2 between opposite edges.
    """
    template = samples.narrow(2, 0, 1).flatten(0, 2)
    left = matched - gain.reshape(-1, 1) * template - offset.reshape(-1, 1)
    index = torch.arange(size, device=samples.device)
    edge = ((index == size - 1).to(samples.dtype) - (index == 0).to(samples.dtype)) / 2
    # The summed axis is contiguous in both factors: a third of the time in torch.
    weights = torch.stack((torch.ones_like(edge).repeat(size), edge.repeat(size), edge.repeat_interleave(size)))
    return components_first((left * left @ weights.mT).unflatten(0, samples.shape[:2]))


def _symmetric(matrix: Tensor, vectors: Tensor) -> Tensor:
    """Multiply symmetric matrices (B, 3, N), given as xx, xy, yy, by vectors (B, 2, N)."""
    return matrix[:, ::2] * vectors + matrix[:, 1:2] * vectors.flip(1)


def _length(vectors: Tensor) -> Tensor:
    """Return the lengths (B, 1, N) of vectors (B, 2, N)."""
    return sum_rows(vectors * vectors).sqrt()
