"""Printed markers: dark or bright blobs of one size, found to a part of a pixel at their own scale."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.ops.contact.cells import widest
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.tracking.corners import choose_apart

_SMALLEST = 1.5  # px, the finest scale: a disc of 4 px across
_STEPS = 4  # scales an octave
_COARSEST = 16  # of the shorter side of the picture: larger ones are no markers but the picture's own shading
_LOCAL = 2.0  # times the scale: what the contrast is taken against
_REACH = 4.0  # standard deviations of a Gaussian that are summed
_FEWEST = 4
_ABOVE_NOISE = 8.0  # times the deviation of what noise leaves: the strongest of 100,000 places reaches 4.5
#: Share of the usual contrast that a marker must keep: light that changes, shear and blur take some of it.
LEAST_CONTRAST = 0.3
_COARSER = 1.25  # times the scale, by which a place is checked; finer ones see a disc as a ring
_APART = 1.5  # scales between two markers at least: a disc has a radius of sqrt(2) scales


class MarkerLook(NamedTuple):
    """What the markers of a recording look like: their scale in px, a disc's radius over sqrt(2); 1 for dark and -1 for
    bright ones; and their usual response (`detect_markers`).
    """

    scale: float
    polarity: int
    response: float

    @property
    def radius(self) -> float:
        """Of the disc whose scale this is, px."""
        return math.sqrt(2) * self.scale


class Markers(NamedTuple):
    """Markers of B pictures, strongest first; NaN behind the last.

    Attributes:
        points: (B, N, 2) px, N the most that one of the pictures has.
        response: (B, N) scale-normalised Laplacian over the local brightness.
        covariance: (B, N, 2, 2) px^2 of `points`, by the white noise of the picture.
        disagreement: (B, N) px from there to the middle that a coarser scale finds. Shadows and folds beside a marker
            draw both aside, and not by the same.
    """

    points: Tensor
    response: Tensor
    covariance: Tensor
    disagreement: Tensor


def measure_markers(frame: Tensor) -> MarkerLook | None:
    """The look of the markers in one picture (1, 1, H, W); None where there are none.

    Blobs are the extrema over place and scale of the scale-normalised Laplacian of Gaussian (Lindeberg 1998), over the
    local brightness, so that the light's gain cancels. Markers are the polarity with the larger sum of cubes: they are
    few and strong, and what lies between them is weak. Otsu's threshold parts them from the rest; the scale is the
    median of theirs.

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
        around = torch.maximum(widest(signed[:, 1:-1]), torch.maximum(widest(signed[:, :-2]), widest(signed[:, 2:])))
        _, k, y, x = ((signed[:, 1:-1] == around) & (signed[:, 1:-1] > 0)).nonzero().unbind(1)
        strength = signed[0, k + 1, y, x]
        score = float(strength.pow(3).sum())
        if best is None or score > best[0]:
            before, after = signed[0, k, y, x], signed[0, k + 2, y, x]
            step = (before - after) / (2 * (before - 2 * strength + after)).clamp_max(-1e-12)
            best = score, polarity, strength, k + 1 + step.clamp(-0.5, 0.5)
    assert best is not None
    _, polarity, strength, octave = best
    strong = strength > _between(strength)
    if int(strong.sum()) < _FEWEST:
        return None
    scale = _SMALLEST * 2 ** (float(octave[strong].median()) / _STEPS)
    response = float(strength[strong].median())
    # White noise of variance 1 leaves 1 / (2 pi scale^2) in the response.
    noise = float(_noise(frame)[0]) / (math.sqrt(2 * math.pi) * scale * max(float(image.mean()), 1.0))
    return MarkerLook(scale, polarity, response) if response > _ABOVE_NOISE * noise else None


def detect_markers(frames: Tensor, look: MarkerLook, count: int = 4000) -> Markers:
    """Markers of that look in pictures (B, 1, H, W), 8 to 16 bit or floating; at most `count`.

    Maxima of the Laplacian of Gaussian at the markers' scale, at least `LEAST_CONTRAST` of the usual one, to a part of
    a pixel by Newton's step to the summit of the quadratic through the 3 x 3 pixels around. Beyond the border the
    nearest pixel counts: a marker that the border cuts is found too, beside its middle.

    Noise of standard deviation s moves the summit by H^-1 times the gradient of the filtered noise, each of whose
    components has the variance 3 s^2 / (4 pi scale^4).
    """
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")
    image = frames.to(torch.float32)
    padded = look.polarity * _response(image, look.scale, margin=1)[:, 0]
    response = padded[:, None, 1:-1, 1:-1].contiguous()
    candidate = (response == widest(response)) & (response > LEAST_CONTRAST * look.response)
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
    """Summits (B, N, 2) px of the coarser response, of the highest pixel within a scale of places (B, N)."""
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
    """scale^2 times the Laplacian of the blurred picture, over the brightness around: positive where it is darker.

    With a margin of pixels beyond the border on each side.
    """
    # The Laplacian needs one pixel more: a kink at the border would be a blob.
    blurred = blur(image, scale, margin + 1)
    middle = blurred[..., 1:-1, 1:-1]
    sides = blurred[..., 1:-1, :-2] + blurred[..., 1:-1, 2:] + blurred[..., :-2, 1:-1] + blurred[..., 2:, 1:-1]
    return scale**2 * (sides - 4 * middle) / blur(image, _LOCAL * scale, margin).clamp_min(1.0)


def blur(image: Tensor, scale: float, margin: int = 0) -> Tensor:
    """By a Gaussian; beyond the border the nearest pixel counts.

    Two products with matrices: torch's convolution of one channel takes ten times as long at these sizes.
    """
    height, width = image.shape[-2:]
    down, across = (_gaussian(size, scale, margin, image) for size in (height, width))
    return down @ image @ across.T


def _gaussian(size: int, scale: float, margin: int, like: Tensor) -> Tensor:
    """(size + 2 margin, size) weights of a Gaussian by which a line of pixels is blurred."""
    half = math.ceil(_REACH * scale)
    offsets = torch.arange(-half, half + 1, device=like.device)
    weights = torch.exp(-offsets.to(torch.float64).square() / (2 * scale**2))
    weights = (weights / weights.sum()).to(like.dtype)
    rows = torch.arange(-margin, size + margin, device=like.device)[:, None]
    columns = (rows + offsets).clamp(0, size - 1)
    matrix = torch.zeros(size + 2 * margin, size, dtype=like.dtype, device=like.device)
    return matrix.scatter_add(1, columns, weights.expand(columns.shape))


def _summit(near: Tensor) -> tuple[Tensor, Tensor]:
    """Step (..., 2) from the middle of 3 x 3 values (9, ...) to the summit of their quadratic, at most half a pixel
    each way, and the inverse (..., 2, 2) of its curvature.
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
    """Standard deviation (B,) of a pixel, grey levels, with that of rounding."""
    return (estimate_noise(frames).square() + (0.0 if frames.is_floating_point() else 1 / 12)).sqrt()


def _between(strength: Tensor) -> float:
    """Otsu's threshold of some numbers: the cut with the largest variance between the two sides."""
    ordered = strength.double().sort().values
    count = len(ordered)
    if count < 2:
        return -math.inf
    below = torch.arange(1, count, dtype=torch.float64, device=strength.device)
    total = ordered.cumsum(0)
    left, right = total[:-1] / below, (total[-1] - total[:-1]) / (count - below)
    cut = int((below * (count - below) * (right - left).square()).argmax())
    return float(ordered[cut] + ordered[cut + 1]) / 2
