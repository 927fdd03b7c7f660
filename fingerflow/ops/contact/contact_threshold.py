"""Contact threshold: the relative intensity loss at the edges of the ridges in contact.

The method is of this package; it starts from the threshold of Otsu 1979. Compiled twin:
`kernels/contact_threshold.cpp`.
"""

from functools import partial

import torch
from torch import Tensor

from fingerflow.kernels import contact
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.contact.apparent_contact import apparent_contact, cell_of
from fingerflow.ops.contact.cells import largest_around
from fingerflow.ops.contact.otsu import histogram, otsu_classes
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.filters.illumination import LEVELS_PER_UNIT, LOWEST_SIGNAL
from fingerflow.ops.filters.median import median_filter
from fingerflow.ops.pieces import frames_at_once, in_pieces

_compiled: Twin[Tensor] = twin("contact_threshold")
# Contact reduces the light by at least a twentieth. The two classes must be separated by at least _NOISE_RATIO standard
# deviations of the lower class, as the halves of a noise distribution are closer together.
_LEAST_INTENSITY_LOSS = 0.05
_NOISE_RATIO = 6
_LEVELS = 256
# Least cubic mean of the differences of neighbouring pixels in a contact with ridges, relative to the difference of
# Otsu's classes. Ridges 14 px apart have 0.2 to 0.3, blurred ones 28 px apart 0.1. Noise of 4 grey levels has 0.05.
_LEAST_STEEPNESS = 0.08
_OWN_WINDOWS = 3  # px, least step from which medians are computed window by window


def contact_threshold(
    frames: Tensor,
    light: Tensor,
    black: Tensor,
    gain: Tensor | None = None,
    *,
    median_px: int = 3,
    radius: int = 8,
    stride_px: int = 1,
) -> Tensor:
    """Compute the contact threshold of each frame: the intensity loss, relative to the light of the empty glass, at
    the edges of the ridges in the apparent contact.

    Otsu's threshold of the median-filtered intensity loss, in 256 levels, first segments the apparent contact
    (`apparent_contact`). It is no threshold itself: most pixels outside are empty glass, which is brighter than the
    skin between ridges, and it would enlarge the area by 2 %.

    The edge of a ridge lies where its blurred image changes fastest. The threshold is the mean loss of all pairs of
    neighbouring pixels, in x and in y, weighted by the cube of the difference between the two (`_edge_level`). It needs
    no pixel of full contact. Ridges of two to three pixels have none: half-way between the medians of ridges and of
    valleys, their real contact area would be 10 % too large, and that of valleys as thin 2 % too small. Cells at the
    border of the apparent contact are left out, as ridges end beside glass there, which is brighter than valleys.
    A contact without valleys has no edges inside: its threshold lies half-way between the means of Otsu's classes. On
    the shipped press the threshold stays within 0.002 from 3 mm² of contact on.

    Args:
        frames, light, black, median_px: as for `real_contact_mask`.
        gain: (B,) illumination gain of `illumination_gain`; NaN or None counts as 1.
        radius: px, of `apparent_contact`.
        stride_px: step between the lines whose pairs of pixels are taken, and step in x and y of the pixels of Otsu's
            histogram; 1 takes all. With 8 the threshold changes by 0.002 from 5 mm² of contact on.

    Returns:
        (B,) in the dtype of `light`, between 0.05 and 1. NaN without contact: where no two classes are separated.
    """
    if _compiled.serves(frames, light, black, gain) and median_px <= contact.LARGEST_MAJORITY:
        table, gains = contact.table_of(median_px), light.new_ones(len(frames)) if gain is None else gain
        sizes = median_px, None if table is None else torch.from_numpy(table), radius, cell_of(radius), stride_px
        return _compiled(frames, light, black, gains, *sizes)
    compute = partial(_threshold, median_px, radius, stride_px)
    return in_pieces(compute, frames_at_once(frames), frames, light, black, gain)


def _threshold(
    median_px: int, radius: int, stride_px: int, frames: Tensor, light: Tensor, black: Tensor, gain: Tensor | None
) -> Tensor:
    dtype, lit = light.dtype, light > 0
    low, scale = LOWEST_SIGNAL, LEVELS_PER_UNIT
    lost = (1 - low) * scale - (frames.to(dtype) - black) * (scale / torch.where(lit, light, 1.0))
    if frames.is_floating_point():
        lit = lit & (lost.abs() < torch.inf)
    levels = torch.where(lit, lost, -low * scale).clamp(0, _LEVELS - 1).round()
    if not torch.compiler.is_exporting():  # some ONNX execution providers cannot compute a minimum of bytes
        levels = levels.to(torch.uint8)
    smooth = _median_at(levels, median_px, stride_px)
    counted = lit[..., ::stride_px, ::stride_px].expand(smooth.shape)
    brightness = lost.new_ones(frames.shape[0]) if gain is None else torch.where(gain.abs() < torch.inf, gain, 1.0)

    def share(level: Tensor) -> Tensor:
        """Return the relative intensity loss at a quantised level, corrected for the illumination gain."""
        return 1 - (1 - (level / scale + low)) / brightness

    otsu, lower, upper, deviation = otsu_classes(histogram(smooth, counted, _LEVELS, (-1.0, _LEVELS - 1.0)).to(dtype))
    least = (_NOISE_RATIO * deviation / scale).clamp_min(_LEAST_INTENSITY_LOSS)
    contrast = upper - lower
    distinct = (share(upper) > _LEAST_INTENSITY_LOSS) & (contrast > least * scale)
    start = torch.where(distinct, otsu, torch.nan)
    # Levels are rounded, so the limit lies half a level above.
    mask = real_contact_mask(frames, light, black, 1 - ((start + 0.5) / scale + low), median_px)
    outside = (apparent_contact(mask, radius, precision=dtype).density_margin <= 0).to(dtype)
    inside = largest_around(outside) == 0
    for axis, by in ((3, 1), (2, stride_px)):  # columns first, while there are few lines
        pixels = torch.arange(0, frames.shape[axis], by, device=frames.device)
        inside = inside.index_select(axis, pixels // cell_of(radius))
    edges, steepness = _edge_level(levels, inside, lit, stride_px, dtype)
    middle = torch.where(start.abs() < torch.inf, (upper + lower) / 2, torch.nan)
    level = torch.where(steepness > (_LEAST_STEEPNESS * contrast) ** 3, edges, middle)
    threshold = share(level)
    return torch.where((threshold > _LEAST_INTENSITY_LOSS) & (threshold < 1), threshold, torch.nan)


def _median_at(levels: Tensor, size: int, step: int) -> Tensor:
    """Return the median filter of levels (B, 1, H, W) at every `step`-th pixel of every `step`-th line.

    Windows that lie far apart share no comparisons: they are gathered, and each is sorted for itself.
    """
    if size == 1 or step < _OWN_WINDOWS:
        return median_filter(levels, size)[..., ::step, ::step]
    windows = levels[:, 0]
    offsets = torch.arange(size, device=levels.device) - size // 2
    for axis in (1, 3):  # (B, h, size, W), then (B, h, size, w, size)
        middle = torch.arange(0, windows.shape[axis], step, device=levels.device)
        index = (middle[:, None] + offsets).clamp(0, windows.shape[axis] - 1)
        windows = windows.index_select(axis, index.flatten()).unflatten(axis, index.shape)
    half = size * size // 2 + 1
    return windows.transpose(2, 3).flatten(3).topk(half, dim=3).values[:, None, :, :, -1]


def _edge_level(levels: Tensor, inside: Tensor, lit: Tensor, step: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return the mean level (B,) of pairs of neighbouring pixels, weighted by the cube of the difference between the
    two, and the mean (B,) of these weights.

    A pair is a pixel of every `step`-th line, where `inside` (B, 1, h, W) is True, and its right or its lower neighbour
    if that is `lit`. Squares would give noise too much weight, fourth powers a few single pixels.
    """
    side = levels.shape[2]
    lines = torch.arange(0, side, step, device=levels.device)
    above, middle, below = (levels.index_select(2, (lines + by).clamp(0, side - 1)) for by in (-1, 0, 1))
    # A median of three pixels at right angles to the pair removes defective pixels and preserves the edge.
    upright = _median_of_three(above, middle, below)
    lit_own, lit_below = (lit.index_select(2, (lines + by).clamp(max=side - 1)) for by in (0, 1))
    pairs = (
        (upright[..., :-1], upright[..., 1:], (inside & lit_own)[..., :-1] & lit_own[..., 1:]),
        (_median_along_line(middle), _median_along_line(below), inside & lit_own & lit_below),
    )
    parts = []
    for first, second, counted in pairs:
        first, second = (level.to(dtype) * counted for level in (first, second))
        cube = (first - second).abs() ** 3
        parts.append([values.sum((1, 2, 3)) for values in ((first + second) / 2 * cube, cube, counted.to(dtype))])
    weighted, cubes, count = (left + right for left, right in zip(*parts, strict=True))
    return weighted / cubes, cubes / count


def _median_along_line(levels: Tensor) -> Tensor:
    """Return the median of each pixel and its two neighbours in the line; at its ends the end counts twice."""
    left = torch.cat((levels[..., :1], levels[..., :-1]), dim=3)
    return _median_of_three(left, levels, torch.cat((levels[..., 1:], levels[..., -1:]), dim=3))


def _median_of_three(first: Tensor, second: Tensor, third: Tensor) -> Tensor:
    return torch.maximum(torch.minimum(first, second), torch.minimum(torch.maximum(first, second), third))
