"""Contact threshold: the relative intensity loss half-way between ridges in contact and the valleys beside them."""

from functools import partial

import torch
from torch import Tensor

from fingerflow.kernels import contact_frames
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.ops.contact.apparent_contact import apparent_contact, cell_of
from fingerflow.ops.contact.otsu import Classes, histogram, otsu_classes
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.filters.illumination import LEVELS_PER_UNIT, LOWEST_SIGNAL
from fingerflow.ops.filters.quantile import median_of_counts
from fingerflow.ops.filters.strided_median import median_at
from fingerflow.ops.pieces import frames_at_once, in_pieces

# Contact reduces the light by at least a twentieth. The two classes must be separated by at least _NOISE_RATIO standard
# deviations of the lower class, as the halves of a noise distribution are closer together.
_LEAST_INTENSITY_LOSS = 0.05
_NOISE_RATIO = 6
_ROUNDS = 2
_LEVELS = 256


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
    """Compute the contact threshold of each frame: the intensity loss, relative to the light of the empty glass,
    half-way between the median losses of ridges and of valleys in the apparent contact.

    Otsu's threshold of the median-filtered intensity loss, in 256 levels, first segments the apparent contact
    (`apparent_contact`). Most pixels outside are empty glass, which is brighter than the skin between ridges; it lowers
    Otsu's threshold and enlarges the area by 2 %. The value half-way between the medians of the two classes inside the
    region is the true position of a ridge's blurred edge. A second round with this value makes the result independent
    of the visible area of glass. On the shipped press it stays within 0.0015 from 2 mm² of contact on.

    Args:
        frames, light, black, median_px: as for `real_contact_mask`.
        gain: (B,) illumination gain of `illumination_gain`; NaN or None counts as 1.
        radius: px, of `apparent_contact`.
        stride_px: sampling step in x and y of the pixels that are counted; 1 gives the exact medians. With 8 the
            threshold changes by about 0.002 from 5 mm² of contact on.

    Returns:
        (B,) in the dtype of `light`, between 0.05 and 1. NaN without contact: where no two classes are separated.
    """
    kind = light.dtype
    if (
        frames.dtype in kernels.FRAME_KINDS
        and kind == black.dtype == torch.float32
        and (gain is None or gain.dtype == torch.float32)
        and median_px <= kernels.LARGEST_MAJORITY
        and kernels.serve(frames, light, black, gain)
    ):
        return compiled_threshold(frames, light, black, gain, median_px, radius, stride_px)
    compute = partial(_threshold, median_px, radius, stride_px)
    result: Tensor = in_pieces(compute, frames_at_once(frames), frames, light, black, gain)
    return result


def _threshold(
    median_px: int, radius: int, stride_px: int, frames: Tensor, light: Tensor, black: Tensor, gain: Tensor | None
) -> Tensor:
    kind, lit = light.dtype, light > 0
    low, scale = LOWEST_SIGNAL, LEVELS_PER_UNIT
    lost = (1 - low) * scale - (frames.to(kind) - black) * (scale / torch.where(lit, light, 1.0))
    if frames.is_floating_point():
        lit = lit & (lost.abs() < torch.inf)
    levels = torch.where(lit, lost, -low * scale).clamp(0, _LEVELS - 1).round()
    if not torch.compiler.is_exporting():  # some ONNX execution providers cannot compute a minimum of bytes
        levels = levels.to(torch.uint8)
    smooth = median_at(levels, median_px, stride_px)
    counted = lit[..., ::stride_px, ::stride_px].expand(smooth.shape)
    brightness = lost.new_ones(len(frames)) if gain is None else torch.where(gain.abs() < torch.inf, gain, 1.0)

    def share(level: Tensor) -> Tensor:
        """Return the relative intensity loss at a quantised level, corrected for the illumination gain."""
        return 1 - (1 - (level / scale + low)) / brightness

    classes = otsu_classes(_counts(smooth, counted).to(kind))
    least = (_NOISE_RATIO * classes.deviation / scale).clamp_min(_LEAST_INTENSITY_LOSS)
    apart = (share(classes.upper) > _LEAST_INTENSITY_LOSS) & (classes.upper - classes.lower > least * scale)
    level = torch.where(apart, classes.threshold, torch.nan)
    for _ in range(_ROUNDS):
        # Levels are rounded, so the limit lies half a level above.
        limit = 1 - ((level + 0.5) / scale + low)
        density_margin = apparent_contact(
            real_contact_mask(frames, light, black, limit, median_px), radius, precision=kind
        ).density_margin
        inside = _at_pixels(density_margin > 0, cell_of(radius), stride_px, frames.shape[2:])
        level = _half_way(_counts(smooth, counted & inside).to(kind), level, classes)
    threshold = share(level)
    return torch.where((threshold > _LEAST_INTENSITY_LOSS) & (threshold < 1), threshold, torch.nan)


def _one_a_frame(frames: Tensor, light: Tensor, *others: object) -> Tensor:
    return light.new_empty(len(frames))


@torch_op(shapes=_one_a_frame)
def compiled_threshold(
    frames: Tensor, light: Tensor, black: Tensor, gain: Tensor | None, median_px: int, radius: int, stride_px: int
) -> Tensor:
    """Compute `contact_threshold` in one call of the compiled library."""
    arrays = (None if one is None else one.detach().resolve_neg().numpy() for one in (frames, light, black, gain))
    sizes = {"median_px": median_px, "radius": radius, "stride_px": stride_px}
    return torch.from_numpy(contact_frames.contact_threshold(*arrays, **sizes))  # type: ignore[arg-type]


def _counts(smooth: Tensor, mask: Tensor) -> Tensor:
    return histogram(smooth, mask, _LEVELS, (-1.0, _LEVELS - 1.0))


def _half_way(counts: Tensor, level: Tensor, classes: Classes) -> Tensor:
    """Return the level (B,) half-way between two medians of a histogram (B, 256): that of the counts above `level`
    (ridges), and that of the other counts (valleys).

    The histograms are (B, 256). `level` is (B,). The result is NaN where no count lies above. Without counts up to the
    level, the lower class replaces their median.
    """
    place = torch.arange(_LEVELS, dtype=counts.dtype, device=counts.device)
    above = (place > level[:, None]).to(counts.dtype)
    ridges, valleys = median_of_counts(counts * above), median_of_counts(counts * (1 - above))
    # Contact without gaps has no valleys: use the lower class of the frame (empty glass) instead.
    valleys = torch.where(valleys.abs() < torch.inf, valleys, classes.lower)
    return (ridges + valleys) / 2


def _at_pixels(cells: Tensor, cell: int, step: int, shape: torch.Size) -> Tensor:
    """Return the values, at every `step`-th pixel of every `step`-th line of a frame of `shape` (height, width), of the
    cells (B, 1, h, w) of `cell` px in which the pixels lie.
    """
    # Select columns first, while there are few lines, then whole lines.
    for axis, side in ((3, shape[1]), (2, shape[0])):
        cells = cells.index_select(axis, torch.arange(0, side, step, device=cells.device) // cell)
    return cells
