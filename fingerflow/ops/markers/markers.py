"""Detection of printed markers, which are dark or bright blobs of one size, to subpixel accuracy."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.ops.checks import check_frames
from fingerflow.ops.contact.cells import largest_around
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.tracking.corners import choose_apart

_SMALLEST = 1.5  # px, finest scale: that of a disc 4 px in diameter
_STEPS = 4  # scales per octave
_COARSEST = 16  # ratio of the shorter side of the image to the coarsest scale: larger blobs are shading, not markers
_LOCAL = 2.0  # scale of the Gaussian mean brightness to which the contrast is related, relative to the detection scale
_REACH = 4.0  # standard deviations at which a Gaussian is truncated
_FEWEST = 4  # least number of markers in an image
# Least response of markers, in standard deviations of the noise in the response: noise alone reaches 4.5 of them in
# 100,000 positions.
_ABOVE_NOISE = 8.0
#: Least share of the usual contrast at which a marker is detected: changing light, shear and blur reduce the contrast.
LEAST_CONTRAST = 0.3
# Ratio of the scale at which positions are checked to the detection scale; at finer scales a disc appears as a ring.
_COARSER = 1.25
_APART = 1.5  # least distance between two markers, in detection scales: a disc has a radius of sqrt(2) scales


class MarkerLook(NamedTuple):
    """Appearance of the printed markers in a recording: size, polarity and strength of response.

    Attributes:
        scale: px, the radius of a disc over sqrt(2).
        polarity: 1 for dark markers, -1 for bright ones.
        response: median response of the markers (`Markers.response`).
    """

    scale: float
    polarity: int
    response: float

    @property
    def radius(self) -> float:
        """Return the radius of a marker, px: that of the disc to which the blob filter responds most strongly."""
        return math.sqrt(2) * self.scale


class Markers(NamedTuple):
    """Detected markers of B images, strongest first, padded with NaN.

    Attributes:
        points: (B, N, 2) px, N the largest number of markers in one of the images.
        response: (B, N) scale-normalised Laplacian over the local brightness.
        covariance: (B, N, 2, 2) px^2 of `points`, due to the white noise of the image.
        disagreement: (B, N) px, distance from `points` to the centre found at a coarser scale. Shadows and folds beside
            a marker displace both centres, but by different amounts.
    """

    points: Tensor
    response: Tensor
    covariance: Tensor
    disagreement: Tensor


def measure_markers(frame: Tensor) -> MarkerLook | None:
    """Measure the appearance of the printed markers in one image (1, 1, H, W); return None if no markers are visible.

    Blobs are the extrema over position and scale of the scale-normalised Laplacian of Gaussian (Lindeberg 1998), over
    the local brightness, so that the illumination gain cancels. Markers are few and strong while the blobs between them
    are weak, so the polarity with the larger sum of cubed responses is that of the markers. Otsu's threshold separates
    them from the other blobs. Scale and response are the medians over the markers.

    Raises ValueError for another shape.
    """
    if frame.ndim != 4 or frame.shape[:2] != (1, 1):
        raise ValueError(f"frame has shape {tuple(frame.shape)}: give one picture (1, 1, H, W)")
    image = frame.to(torch.float32)
    coarsest = max(min(frame.shape[-2:]) / _COARSEST, 2 * _SMALLEST)
    count = math.floor(_STEPS * math.log2(coarsest / _SMALLEST)) + 2
    scales = [_SMALLEST * 2 ** (k / _STEPS) for k in range(count)]
    stack = torch.cat([_response(image, scale) for scale in scales], dim=1)
    best: tuple[float, int, Tensor, Tensor] | None = None
    for polarity in (1, -1):
        signed = polarity * stack
        around = torch.maximum(
            largest_around(signed[:, 1:-1]),
            torch.maximum(largest_around(signed[:, :-2]), largest_around(signed[:, 2:])),
        )
        _, k, y, x = ((signed[:, 1:-1] == around) & (signed[:, 1:-1] > 0)).nonzero().unbind(1)
        strength = signed[0, k + 1, y, x]
        score = float(strength.pow(3).sum())
        if best is None or score > best[0]:
            before, after = signed[0, k, y, x], signed[0, k + 2, y, x]
            step = (before - after) / (2 * (before - 2 * strength + after)).clamp_max(-1e-12)
            best = score, polarity, strength, k + 1 + step.clamp(-0.5, 0.5)
    assert best is not None
    _, polarity, strength, octave = best
    strong = strength > _otsu_threshold(strength)
    if int(strong.sum()) < _FEWEST:
        return None
    scale = _SMALLEST * 2 ** (float(octave[strong].median()) / _STEPS)
    response = float(strength[strong].median())
    # White noise of variance 1 gives the Laplacian response a variance of 1 / (2 pi scale^2).
    noise = float(_noise(frame)[0]) / (math.sqrt(2 * math.pi) * scale * max(float(image.mean()), 1.0))
    return MarkerLook(scale, polarity, response) if response > _ABOVE_NOISE * noise else None


def detect_markers(frames: Tensor, look: MarkerLook, count: int = 4000) -> Markers:
    """Detect at most `count` markers of a given appearance in each image of a batch (B, 1, H, W).

    Images have 8 to 16 bit or are floating point. Markers are maxima of the Laplacian of Gaussian at the markers' scale
    with at least `LEAST_CONTRAST` of their median response. A Newton step to the maximum of the quadratic through the 3
    x 3 pixels around gives the subpixel position. Beyond the border the nearest pixel counts; a marker cut by the
    border is detected, but off its true centre.

    Noise of standard deviation s moves the maximum by H^-1 times the gradient of the filtered noise, H the second
    derivatives there. Each component of that gradient has the variance 3 s^2 / (4 pi scale^4).

    Raises ValueError for another shape.
    """
    check_frames(frames)
    image = frames.to(torch.float32)
    padded = look.polarity * _response(image, look.scale, margin=1)[:, 0]
    response = padded[:, None, 1:-1, 1:-1].contiguous()
    candidate = (response == largest_around(response)) & (response > LEAST_CONTRAST * look.response)
    place = choose_apart(response, candidate, count, _APART * look.scale)
    place = place[:, : int((place >= 0).sum(1).max())]
    width = frames.shape[-1]
    found, index = place >= 0, place.clamp_min(0)
    x, y = index % width, index // width
    batch = torch.arange(len(frames), device=frames.device)[:, None]
    near = torch.stack([padded[batch, y + row, x + column] for row in range(3) for column in range(3)])
    step, inverse = _summit(near)
    brightness = blur(image, _LOCAL * look.scale).clamp_min(1.0)[batch, 0, y, x]
    relative = _noise(frames).to(brightness.dtype).square()[:, None] / brightness.square()
    covariance = (3 / (4 * math.pi * look.scale**4) * relative)[..., None, None] * (inverse @ inverse)
    points = torch.stack((x, y), dim=-1) + step
    return Markers(
        torch.where(found[..., None], points, torch.nan),
        torch.where(found, near[4], torch.nan),
        torch.where(found[..., None, None], covariance, torch.nan),
        torch.where(found, (_coarser(image, look, x, y) - points).norm(dim=-1), torch.nan),
    )


def _coarser(image: Tensor, look: MarkerLook, x: Tensor, y: Tensor) -> Tensor:
    """Return the positions (B, N, 2) px of the highest response to a blob filter coarser than the markers, each near
    one of the detected pixels x, y (B, N).

    Positions within one scale are considered.
    """
    reach = math.ceil(look.scale)
    response = look.polarity * _response(image, _COARSER * look.scale, margin=1)[:, 0]
    height, width = image.shape[-2:]
    offset = torch.arange(-reach, reach + 1, device=image.device)
    rows = (y[..., None, None] + offset[:, None]).clamp(0, height - 1)
    columns = (x[..., None, None] + offset).clamp(0, width - 1)
    batch = torch.arange(len(image), device=image.device)[:, None, None, None]
    best = response[batch, rows + 1, columns + 1].flatten(2).argmax(-1)
    row = rows.expand(*rows.shape[:3], len(offset)).flatten(2).gather(2, best[..., None])[..., 0]
    column = columns.expand(*columns.shape[:2], len(offset), len(offset)).flatten(2).gather(2, best[..., None])[..., 0]
    near = torch.stack(
        [response[batch[:, :, 0, 0], row + down, column + across] for down in range(3) for across in range(3)]
    )
    return torch.stack((column, row), dim=-1) + _summit(near)[0]


def _response(image: Tensor, scale: float, margin: int = 0) -> Tensor:
    """Compute the blob response: scale^2 times the Laplacian of the blurred image, divided by the local brightness.

    It is positive for dark blobs. The result is larger than the image by `margin` pixels on each side.
    """
    # The Laplacian needs one more pixel on each side: padding after the blur would leave a kink that is detected as a
    # blob.
    blurred = blur(image, scale, margin + 1)
    middle = blurred[..., 1:-1, 1:-1]
    sides = blurred[..., 1:-1, :-2] + blurred[..., 1:-1, 2:] + blurred[..., :-2, 1:-1] + blurred[..., 2:, 1:-1]
    return scale**2 * (sides - 4 * middle) / blur(image, _LOCAL * scale, margin).clamp_min(1.0)


def blur(image: Tensor, scale: float, margin: int = 0) -> Tensor:
    """Blur an image by a Gaussian of standard deviation `scale` px; beyond the border the nearest pixel is repeated.

    The result is larger than the image by `margin` pixels on each side. Two matrix products are used: torch's
    convolution of one channel takes ten times as long at these sizes.
    """
    height, width = image.shape[-2:]
    down, across = (_gaussian(size, scale, margin, image) for size in (height, width))
    return down @ image @ across.T


def _gaussian(size: int, scale: float, margin: int, like: Tensor) -> Tensor:
    """Return the matrix (size + 2 margin, size) that blurs a line of `size` pixels by a Gaussian."""
    half = math.ceil(_REACH * scale)
    offsets = torch.arange(-half, half + 1, device=like.device)
    weights = torch.exp(-offsets.to(torch.float64).square() / (2 * scale**2))
    weights = (weights / weights.sum()).to(like.dtype)
    rows = torch.arange(-margin, size + margin, device=like.device)[:, None]
    columns = (rows + offsets).clamp(0, size - 1)
    matrix = torch.zeros(size + 2 * margin, size, dtype=like.dtype, device=like.device)
    return matrix.scatter_add(1, columns, weights.expand(columns.shape))


def _summit(near: Tensor) -> tuple[Tensor, Tensor]:
    """Locate the summit of a quadratic surface through 3 x 3 values: return the step (..., 2) from the centre value.

    The values are (9, ...). The step is at most 0.6 px in x and y. Also return the inverse (..., 2, 2) of the second
    derivatives. Where the quadratic has no extremum, the step is 0 and the inverse NaN.
    """
    a, b, c, d, e, f, g, h, i = near
    slope = torch.stack((f - d, h - b), dim=-1) / 2
    xx, yy, xy = d - 2 * e + f, b - 2 * e + h, (a - c - g + i) / 4
    determinant = xx * yy - xy * xy
    curved = determinant > 1e-12
    safe = torch.where(curved, determinant, 1.0)
    inverse = torch.stack((yy, -xy, -xy, xx), dim=-1).unflatten(-1, (2, 2)) / safe[..., None, None]
    step = -(inverse @ slope[..., None])[..., 0].clamp(-0.6, 0.6)
    return torch.where(curved[..., None], step, 0.0), torch.where(curved[..., None, None], inverse, torch.nan)


def _noise(frames: Tensor) -> Tensor:
    """Return the noise standard deviation (B,) of a pixel in grey levels, including the rounding of integer frames."""
    return (estimate_noise(frames).square() + rounding_variance(frames)).sqrt()


def _otsu_threshold(strength: Tensor) -> float:
    """Return Otsu's threshold of a list of values, which maximises the variance between the values below and above it.

    It is -inf for fewer than two values.
    """
    ordered = strength.double().sort().values
    count = len(ordered)
    if count < 2:
        return -math.inf
    below = torch.arange(1, count, dtype=torch.float64, device=strength.device)
    total = ordered.cumsum(0)
    left, right = total[:-1] / below, (total[-1] - total[:-1]) / (count - below)
    cut = int((below * (count - below) * (right - left).square()).argmax())
    return float(ordered[cut] + ordered[cut + 1]) / 2
