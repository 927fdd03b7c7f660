"""Exhaustive search for windows that moved too far for Lucas-Kanade registration.

Normalised cross-correlation by Fourier transforms (Lewis 1995). Compiled twin: `kernels/search.cpp`.
"""

import torch
from torch import Tensor

from fingerflow.kernels.tensors import Twin, twin
from fingerflow.kernels.tracking import SEARCHED, sizes_of
from fingerflow.kernels.tracking_limits import SEARCH_TIE
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.filters.halving import halved_image
from fingerflow.ops.filters.windows import cut_windows
from fingerflow.ops.pieces import points_at_once

_compiled: Twin[Tensor] = twin("search_windows")
_CHUNK = 128  # number of points per pass, so that the transforms stay in the cache
_FAR = 2.0**30  # px, an integer position outside every image


def search_windows(
    template_images: Tensor,
    images: Tensor,
    image_index: Tensor,
    points: Tensor,
    guess: Tensor,
    window: int,
    radius: int,
) -> Tensor:
    """Search for the windows around `points` of the template images in other images: return the positions of highest
    normalised cross-correlation within `radius` px of `guess`.

    The radius holds in x and in y. Of several positions within `SEARCH_TIE` of the highest, the one nearest to `guess`
    is returned.

    The search runs through the Fourier transform on images of half resolution and is accurate to about a pixel. Its
    result is a starting position for :func:`~fingerflow.ops.tracking.track_points.track_points`, not a replacement.

    A Lucas-Kanade pyramid would be cheaper but fails on skin. Ridges occupy a narrow frequency band, which the levels
    that could bridge 50 px do not contain. What remains there is the illumination, which does not move.

    Args:
        template_images, images: (B, 1, H, W), 8 to 16 bit or floating.
        image_index: (P,) int64, index of the image of each point.
        points: (P, 2) px in `template_images`.
        guess: (P, 2) px in `images`.
        window: side of the tracking window, px.
        radius: px.

    Returns:
        (P, 2) px; `guess` where the point or its guess is not finite, or where no position correlates positively.
    """
    coarse_templates, coarse_images = halved_image(template_images), halved_image(images)
    size, reach = sizes_of(window, radius)
    given = (coarse_templates, coarse_images, image_index, points, guess)
    if _compiled.serves(*given):
        return _compiled(*given, size, reach)
    if torch.compiler.is_exporting():
        return _search_coarse(coarse_templates, coarse_images, image_index, points, guess, size, reach)
    if not len(points):
        return guess.clone()
    at_once = points_at_once(points, _CHUNK)
    results = [
        _search_coarse(coarse_templates, coarse_images, *part, size, reach)
        for part in zip(image_index.split(at_once), points.split(at_once), guess.split(at_once), strict=True)
    ]
    return torch.cat(results)


def search_and_return(
    key: Tensor,
    current: Tensor,
    image_index: Tensor,
    start: Tensor,
    guess: Tensor,
    window: int,
    radius: int,
    forward_backward_limit: float,
) -> tuple[Tensor, Tensor]:
    """Search for windows within `radius` px of `guess` by `search_windows`; return the positions (P, 2) found, and
    whether (P,) a search back from each of them returns to the start.

    The search back is independent of the displacement found. It must end within `forward_backward_limit`, plus the
    pixel to which a search is accurate.

    Args:
        key, current: (B, 1, H, W).
        start: (P, 2) px in `key`, the `points` of `search_windows`; the other arguments as there.
        forward_backward_limit: px.
    """
    ahead = search_windows(key, current, image_index, start, guess, window, radius)
    back = search_windows(current, key, image_index, ahead, start, window, radius)
    return ahead, (back - start).square().sum(-1).sqrt() <= forward_backward_limit + SEARCHED


def _search_coarse(
    templates: Tensor, images: Tensor, image_index: Tensor, points: Tensor, guess: Tensor, size: int, reach: int
) -> Tensor:
    half = size // 2
    span = 2 * reach + 1
    finite = points.isfinite().all(-1) & guess.isfinite().all(-1)
    # Pixel i of the half-resolution image is centred at 2 i + 1/2 in the full image.
    start = torch.where(finite[:, None], (points - 0.5) / 2, 0.0).round()
    center = torch.where(finite[:, None], (guess - 0.5) / 2, 0.0).round()
    cut_at, searched_at = (position.clamp(-_FAR, _FAR).long() - half for position in (start, center))
    # Use float64: transforms round relative to the whole patch, and a window may have a thousandth of its contrast.
    template = cut_windows(templates, image_index, cut_at, size).double().nan_to_num(0.0, 0.0, 0.0)
    patch = cut_windows(images, image_index, searched_at - reach, size + span - 1)
    patch = patch.double().nan_to_num(0.0, 0.0, 0.0)
    template = template - template.mean((-1, -2), keepdim=True)
    patch = patch - patch.mean((-1, -2), keepdim=True)
    product = _correlated(patch, template, span)
    deviation = box_sum(patch.square(), size) - box_sum(patch, size).square() / size**2
    # A window without contrast correlates with nothing; the bound keeps rounding errors from selecting one.
    least = 1e-3 * deviation.amax((-1, -2), keepdim=True) + torch.finfo(torch.float32).tiny
    score = torch.where(deviation > least, product / deviation.clamp_min(least).sqrt(), -torch.inf)
    best = _nearest_of_highest(score.flatten(1), span)
    row, column = best // span, best % span
    point = torch.arange(len(best), device=best.device)
    peak = score[point, row, column]

    def beside(down: int, right: int) -> Tensor:
        return score[point, (row + down).clamp(0, span - 1), (column + right).clamp(0, span - 1)]

    vertices = _vertex(beside(0, -1), peak, beside(0, 1)), _vertex(beside(-1, 0), peak, beside(1, 0))
    moved = torch.stack((column, row), dim=-1) - reach + torch.stack(vertices, dim=-1).to(points.dtype)
    # Apply the displacement of the template's centre pixel to the point itself.
    result = points + 2 * (center + moved - start)
    return torch.where((finite & (peak > 0))[:, None], result, guess)


def _correlated(patch: Tensor, template: Tensor, span: int) -> Tensor:
    """Correlate templates (P, n, n) with patches (P, m, m): return the sums of products (P, span, span) at every shift.

    Here m = n + span - 1.
    """
    size = template.shape[-1]
    if torch.compiler.is_exporting():  # transforms of small patches take ONNX runtimes six times as long
        columns = [patch[:, :, shift : shift + size] for shift in range(span)]
        sums = [(column[:, down : down + size] * template).sum((1, 2)) for down in range(span) for column in columns]
        return torch.stack(sums, dim=1).unflatten(1, (span, span))
    shape = patch.shape[-2:]
    # `conj` is not used: torch 2.13 loses a lazy conjugation in an op that is called from compiled code.
    spectrum = torch.fft.rfft2(patch) * torch.fft.rfft2(template, s=shape).conj_physical()
    return torch.fft.irfft2(spectrum, s=shape)[:, :span, :span]


def _nearest_of_highest(score: Tensor, span: int) -> Tensor:
    """Return the flat index (P,) of the highest score in each square map; of nearly equal ones the most central.

    Scores that differ from the highest by at most the fraction `SEARCH_TIE` count as equal to it.
    """
    highest = score.amax(1, keepdim=True)
    number = torch.arange(span * span, device=score.device)
    away = (number // span - span // 2) ** 2 + (number % span - span // 2) ** 2
    order = (away * span * span + number).to(score.dtype)  # ONNX Runtime has no minimum of integers on a GPU
    return torch.where(score >= highest - SEARCH_TIE * highest.abs(), order, order.max() + 1).argmin(1)


def _vertex(before: Tensor, peak: Tensor, after: Tensor) -> Tensor:
    """Return the sub-pixel offset of the maximum of a parabola through three neighbouring scores.

    The offset from the middle score lies within -1/2 .. 1/2, and is 0 where the scores are equal to within
    `SEARCH_TIE`.
    """
    curvature = before - 2 * peak + after
    return (
        torch.where(curvature < -SEARCH_TIE * peak, (before - after) / (2 * curvature), 0.0)
        .nan_to_num(0.0)
        .clamp(-0.5, 0.5)
    )
