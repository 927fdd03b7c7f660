"""Tracking of points between two images by Lucas-Kanade: templates of one image are registered in the other."""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.result_records import TrackedPoints
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.kernels.tensors.torch_op import requires_gradient, torch_op
from fingerflow.kernels.tracking_limits import TrackStatus as TrackStatus
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.filters.windows import sample_windows
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.short_waves import WIDE, correct_short_waves
from fingerflow.ops.tracking.templates import (
    check_points,
    find_templates,
    first_rows,
    inserted,
    inverse_2x2,
    prepare_templates,
    replaced,
    take_rows,
    without_gain_and_offset,
)

_compiled: Twin[tuple[Tensor, ...]] = twin("find_pairs")


class Tracks(NamedTuple):
    """Points tracked from one image to another: positions in the second image, with error, covariance and status.

    Attributes:
        points: (B, N, 2) px in the current image; NaN where the status is not TRACKED.
        error: (B, N) px, forward-backward distance to first order; NaN for the statuses NOT_FINITE, LEFT_FRAME,
            NO_TEXTURE and NOT_CONVERGED.
        covariance: (B, N, 2, 2) px^2 of `points`, from the noise in the residual and the template's structure tensor;
            NaN where they are.
        status: (B, N) uint8, a :class:`TrackStatus`.
    """

    points: Tensor
    error: Tensor
    covariance: Tensor
    status: Tensor


def track_points(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    window: int = 21,
    *,
    initial: Tensor | None = None,
    warp: Tensor | None = None,
    passes: int = 2,
    gain_offset: bool = True,
    search: int = 8,
    forward_backward_limit: float = 1.0,
    mismatch_limit: float = limits.MISMATCH_SHARE,
    noise: Tensor | None = None,
) -> Tracks:
    """Track points from the image `previous` to the image `current`, with a forward-backward check.

    A pass is `prepare_templates` followed by `find_templates`. The second pass corrects points for the displacement
    gradient of the first (`ops.tracking.deformation`). Templates whose edge that gradient shifts by more than 0.1 px
    are deformed and found again, then corrected for what is left. Where points lie closer than about half a window,
    waves of the displacement down to 2.5 windows are corrected too (`ops.tracking.short_waves`). Lost points are also
    searched again, at the position that their neighbours predict.

    Gradients flow from `points` of the result to the images and to the argument `points` (implicit differentiation,
    first order); error, covariance and status have none.

    Args:
        previous: (B, 1, H, W), 8 to 16 bit or floating.
        current: the same shape.
        points: (B, N, 2) (x, y) px in `previous`; NaN stays NaN.
        window: odd side of the square window, px.
        initial: (B, N, 2) predicted positions in `current`; default `points`.
        warp: (B, N, 2, 2) deformation gradient F: an offset w in `previous` is F w in `current`. If given, it is
            kept and there is no second pass.
        passes: 2, or 1 for windows that are not deformed, which takes three quarters of the time where nothing deforms.
        gain_offset: leave gain and offset of the illumination free in each window.
        search: px. Points that are not found near the prediction are searched for exhaustively up to this distance in x
            and y; 0 disables the search. Without it the prediction must be within about a third of the texture's
            period.
        forward_backward_limit: px; a point whose forward-backward distance exceeds it is flagged.
        mismatch_limit: largest share of the template's variance, without the noise, that the match may leave
            unexplained.
        noise: (B,) standard deviation of white noise, grey levels, of the noisier image of each pair. Default: the
            larger :func:`~fingerflow.ops.filters.noise.estimate_noise` of both.

    Raises:
        ValueError: shapes do not match, the window is even or too small, or `passes` is not 1 or 2.

    Source: Lucas & Kanade 1981; Baker & Matthews, IJCV 2004 (`ops.tracking.templates`). Compiled twin:
    `kernels/templates.cpp`.

    Convention:
        axes: points are (x, y) px, x to the right, y down.
        sign: skin that moves to the right and down gets larger x and y.
        pixel centre: whole numbers; (0, 0) is the upper left pixel.
        dtype: float32, or float64 if the frames are.
        NaN: in a point, or in a pixel within 3 px of its window, makes its position NaN, with a status.
        border: a window that reaches beyond the frame makes the position NaN, with a status.
    """
    check_points(previous, points, window, warp)
    if previous.shape != current.shape:
        raise ValueError(
            f"previous {tuple(previous.shape)} and current {tuple(current.shape)} must have the same shape"
        )
    if initial is not None and initial.shape != points.shape:
        raise ValueError(f"initial {tuple(initial.shape)} must have the shape of points {tuple(points.shape)}")
    if passes not in (1, 2):
        raise ValueError(f"passes must be 1 or 2, not {passes}")
    if noise is not None and noise.shape != (len(previous),):
        raise ValueError(f"noise {tuple(noise.shape)} must be ({len(previous)},): one standard deviation an image pair")
    images = _to_float(previous), _to_float(current)
    start, guess = points.detach(), (points if initial is None else initial).detach()
    plain = images[0].detach(), images[1].detach()
    if noise is None:
        noise = torch.maximum(*(estimate_noise(image) for image in plain))
    tensors, limits_of = (*plain, start, guess, warp, noise), (forward_backward_limit, mismatch_limit)
    position, *quality, warp = in_passes(*tensors, window, passes, gain_offset, search, *limits_of)
    if requires_gradient(*images, points):
        position = _with_derivative(images, points, position, warp, window, gain_offset)
    return Tracks(position, *quality)


# Points, errors, covariances and statuses of `Tracks`; deformation (B, N, 2, 2) of the templates, or None.
_Passed = tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]


def _like_passed(*arguments: Any) -> _Passed:
    previous, _, points, _, warp, _, _, passes, *_ = arguments
    dtype = torch.float64 if previous.dtype == torch.float64 else torch.float32
    position, matrix = points.new_empty(points.shape, dtype=dtype), points.new_empty((*points.shape, 2), dtype=dtype)
    status = points.new_empty(points.shape[:2], dtype=torch.uint8)
    deformation = warp if warp is not None else matrix if passes == 2 else None
    deformation = None if deformation is None else torch.empty_like(deformation)
    return position, position.new_empty(points.shape[:2]), matrix, status, deformation


@torch_op(shapes=_like_passed)
def in_passes(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    guess: Tensor,
    warp: Tensor | None,
    noise: Tensor,
    window: int,
    passes: int,
    gain_offset: bool,
    search: int,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> _Passed:
    """Track points from one image to another in one pass, or in two, of which the second corrects for the deformation
    that the first measured; the arguments are those of `track_points`.

    The result has no derivatives. This is one operator for the compiler, since the number of passes and searches
    depends on data.
    """
    dtype = torch.float64 if previous.dtype == torch.float64 else torch.float32
    start, guess, noise = points.to(dtype), guess.to(dtype), noise.to(dtype)

    def find(points: Tensor, warp: Tensor | None, near: Tensor) -> tuple[TrackedPoints, Tensor]:
        """Register points (B, N, 2) of the image `previous` in the image `current`, near predicted positions `near`;
        also return the statistics of the points' templates.
        """
        inverse, variance = None if warp is None else inverse_2x2(warp.to(points.dtype)), noise.square()
        if _compiled.serves(previous, current, points, inverse, variance, near) and previous.dtype == current.dtype:
            *_, numbers, tracked, error, covariance, status, estimate = _compiled(
                *(previous, current, points, inverse, variance, window, int(gain_offset), limits.ROUNDS, near, None),
                *(rounding_variance(previous), forward_backward_limit, mismatch_limit),
            )
            return TrackedPoints(tracked, error, covariance, status, estimate), numbers
        templates = prepare_templates(previous, points, window, warp, gain_offset=gain_offset, noise=noise)
        shares: dict[str, Any] = {"forward_backward_limit": forward_backward_limit, "mismatch_limit": mismatch_limit}
        return find_templates(templates, current, near, noise=noise, **shares), templates.numbers

    def one_pass(positions: Tensor, deformation: Tensor | None, near: Tensor) -> tuple[TrackedPoints, Tensor]:
        track, numbers = find(positions, deformation, near)
        if search:
            images, limits_of_search = (previous, current), (window, search, forward_backward_limit)
            track = _search_lost(find, images, positions, deformation, track, near, *limits_of_search)
        return track, numbers

    with torch.no_grad():
        track, numbers = one_pass(start, warp, guess)
        if warp is not None:
            warp = warp.clone()  # a result shares no memory with an argument
        elif passes == 2:
            inverse = torch.eye(2, dtype=dtype, device=start.device).expand(*start.shape, 2)
            inputs = start, track.points, track.covariance, numbers, inverse
            corrected = correct_points(*inputs, window, WIDE * window)
            warp = corrected.warp.contiguous()  # as `_like_passed` declares
            lost = track.status >= TrackStatus.NOT_CONVERGED
            renewed = lost | ((track.status == TrackStatus.TRACKED) & (corrected.shift > limits.UPDATE_PX))
            if renewed.any():
                chosen = first_rows(renewed)
                near = torch.where(lost[..., None] & corrected.expected.isfinite(), corrected.expected, track.estimate)
                again, other_numbers = one_pass(*(take_rows(tensor, chosen) for tensor in (start, warp, near)))
                track = replaced(track, again, chosen, renewed)
                numbers = inserted(numbers, other_numbers, chosen, renewed)
                inverse = torch.where(renewed[..., None, None], inverse_2x2(warp), inverse)
                inputs = start, track.points, track.covariance, numbers, inverse
                corrected = correct_points(*inputs, window, WIDE * window)
            corrected = correct_short_waves(corrected, *inputs, window)
            track = track._replace(points=corrected.points, covariance=corrected.covariance)
    return *track[:4], warp


def _search_lost(
    find: Callable[[Tensor, Tensor | None, Tensor], tuple[TrackedPoints, Tensor]],
    images: tuple[Tensor, Tensor],
    start: Tensor,
    warp: Tensor | None,
    tracks: TrackedPoints,
    guess: Tensor,
    window: int,
    radius: int,
    forward_backward_limit: float,
) -> TrackedPoints:
    """Search exhaustively for points that registration lost, within `radius` px of `guess` (B, N, 2), and return
    `tracks` with the results of the search inserted.

    A search back from the match is independent of the displacement found. If it misses the start by more than the limit
    plus the accuracy of a search, the point gets the status FORWARD_BACKWARD.

    Args:
        find: registration of points, given their deformation and predictions (`in_passes`).
    """
    lost = tracks.status >= TrackStatus.NOT_CONVERGED
    if not lost.any():
        return tracks
    image, point = lost.nonzero(as_tuple=True)
    inputs = image, start[image, point], guess[image, point]
    ahead, returns = search_and_return(*images, *inputs, window, radius, forward_backward_limit)
    everywhere = torch.full_like(start, torch.nan)
    everywhere[image, point] = ahead
    chosen = first_rows(lost)
    near, selected = take_rows(everywhere, chosen), take_rows(start, chosen)
    again, _ = find(selected, None if warp is None else take_rows(warp, chosen), near)
    result = replaced(tracks, again, chosen, lost)
    elsewhere = torch.zeros_like(lost)
    elsewhere[image, point] = ~returns
    wrong = elsewhere & (result.status == TrackStatus.TRACKED)
    return TrackedPoints(
        torch.where(wrong[..., None], torch.nan, result.points),
        result.error,
        torch.where(wrong[..., None, None], torch.nan, result.covariance),
        torch.where(wrong, int(TrackStatus.FORWARD_BACKWARD), result.status),
        torch.where(wrong[..., None], guess, result.estimate),
    )


def _to_float(image: Tensor) -> Tensor:
    """Convert an image to float32, unless it is float64 or of a dtype that the kernels support."""
    return image if image.dtype in kernels.FRAME_KINDS or image.dtype == torch.float64 else image.float()


def _with_derivative(
    images: tuple[Tensor, Tensor], points: Tensor, position: Tensor, warp: Tensor | None, window: int, gain_offset: bool
) -> Tensor:
    """Return the positions `position` with unchanged values, but differentiable with respect to images and points.

    The derivative is that of a Newton step from the root. At the root b(y; images, p) = sum g (S(y + w) - T(w)) = 0,
    hence dy = -(db/dy)^-1 db; the Jacobian itself needs no derivative.
    """
    batch, count = points.shape[:2]
    image_index = torch.arange(batch, device=points.device).repeat_interleave(count)
    start, flat = points.to(position.dtype).reshape(-1, 2), position.reshape(-1, 2)
    valid = (start.isfinite() & flat.isfinite()).all(-1, keepdim=True)
    inverse = None if warp is None else inverse_2x2(warp.to(position.dtype)).reshape(-1, 2, 2)

    def sampled(image: Tensor, position: Tensor, deformed: Tensor | None) -> tuple[Tensor, Tensor]:
        places = image_index, torch.where(valid, position, 0.0)
        values, slopes = sample_windows(spline_coefficients(image), *places, window, deformed)
        return values.flatten(1), slopes.flatten(2)

    (template, gradient), (value, slope) = sampled(images[0], start, inverse), sampled(images[1], flat, None)
    difference = value - template
    if gain_offset:
        gradient = without_gain_and_offset(template - template.mean(1, keepdim=True), gradient)
        difference = value - value.mean(1, keepdim=True)
    residual = (gradient * difference[:, None]).sum(2)
    jacobian = (gradient @ slope.transpose(1, 2)).detach()
    step = (inverse_2x2(jacobian) * (residual - residual.detach())[:, None, :]).sum(-1)
    return (flat - torch.where(valid, step, 0.0)).view(position.shape)
