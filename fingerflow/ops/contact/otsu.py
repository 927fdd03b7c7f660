"""Otsu's threshold (1979), computed from the histogram of an image."""

import functools

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.checks import check_frames

_BINS = 256
_MOST_COMPILED_BINS = 1 << 16


def histogram(
    frames: Tensor, mask: Tensor | None = None, bins: int = 256, value_range: tuple[float, float] | None = None
) -> Tensor:
    """Return the histogram (B, bins) of the pixel values of each frame, with exact counts.

    Bins are open below and closed above, (low + k w, low + (k + 1) w], so that `frames > edge` splits a frame exactly
    as the histogram does. The default for uint8, (-1, 255), gives each grey level its own bin.

    Args:
        frames: (B, 1, H, W), integers or floating.
        mask: (B or 1, 1, H, W) bool, the pixels that count; None for all.
        bins: number of bins.
        value_range: (low, high) in the units of `frames`. Pixels beyond it count in the end bins. NaN and infinities do
            not count.

    Returns:
        (B, bins) int64.

    Raises:
        ValueError: no `value_range` for a dtype other than uint8, or one whose high is not above its low.
    """
    low, high = _range(frames, value_range)
    if frames.dtype in kernels.COUNTED_DTYPES and bins <= _MOST_COMPILED_BINS and kernels.serve(frames, mask):
        default = frames.dtype == torch.uint8 and (low, high, bins) == (-1, 255, 256)
        bin_of_level = None if default else _bin_of_level(frames.dtype, bins, low, high)
        return kernels.histogram(frames, None if mask is None else mask.expand(frames.shape), bin_of_level, bins)
    index = _bin_index(frames, bins, low, high)
    if mask is not None:
        index = torch.where(mask.expand(frames.shape).flatten(1), index, bins)
    # `bincount` is not used: the host would wait for the device to learn the largest index. Products of one-hot digits
    # of every pixel are not used: they take ONNX Runtime ten times as long.
    counts = torch.zeros(frames.shape[0], bins + 1, dtype=torch.int32, device=frames.device)
    return counts.scatter_add(1, index.long(), torch.ones_like(index))[:, :bins].long()


def otsu_threshold(
    frames: Tensor, mask: Tensor | None = None, value_range: tuple[float, float] | None = None
) -> Tensor:
    """Return Otsu's threshold, which maximises the variance between two classes of a frame's pixels.

    It uses 256 fixed bins as OpenCV does, so that `frames > threshold` is OpenCV's THRESH_OTSU for uint8. If empty bins
    separate two classes, every threshold in them is equally good; the lowest is returned.

    Args:
        frames, mask: see `histogram`.
        value_range: (low, high) of the 256 bins; needed unless `frames` is uint8.

    Returns:
        (B,) float64 in the units of `frames`: the upper edge of the last bin of the lower class. NaN where fewer than
        two bins are occupied: a blank or saturated frame has no threshold, and `frames > NaN` is empty.

    Raises:
        ValueError: see `histogram`.

    Source: Otsu 1979, equation 18. Compiled twin, of the histogram: `kernels/otsu.cpp`.

    Convention:
        axes: one number per frame, whatever the order of its pixels.
        sign: `frames > threshold` is the brighter class.
        pixel centre: not used.
        dtype: float64.
        NaN: is not counted; a frame of a single level has the threshold NaN.
        border: every pixel counts alike.
    """
    low, high = _range(frames, value_range)
    counts = histogram(frames, mask, _BINS, (low, high)).double()
    level = torch.arange(256, dtype=torch.float64, device=frames.device)
    # With n pixels of sum s up to a level, and n_all of sum s_all, the variance between the classes is
    # (s n_all - s_all n)^2 / (n_all^2 n (n_all - n)) (Otsu 1979, eq. 18). Its integers are exact in float64.
    below, total = counts.cumsum(1), counts.sum(1, keepdim=True)
    moment = (counts * level).cumsum(1)
    product = below * (total - below)
    between = (moment * total - moment[:, -1:] * below).square() / product.clamp(min=1)
    best = torch.where(between == between.amax(1, keepdim=True), level, 256.0).amin(1)
    threshold = low + (best + 1) * ((high - low) / 256)
    return torch.where((product > 0).any(1), threshold, torch.nan)


def otsu_classes(counts: Tensor) -> tuple[Tensor, ...]:
    """Split histograms (B, 256) of levels 0 to 255 into the two classes of Otsu's threshold, and return (B,) each: the
    threshold, the means of the levels up to it and above it, and the standard deviation of the levels up to it.

    The threshold is NaN where only one level occurs; the others then have no meaning.

    The variance between the classes is that of Otsu 1979, equation 18; of equally good thresholds the lowest is taken.
    Results have the dtype of the counts.
    """
    centre = (_BINS - 1) / 2  # moments are taken about the middle level, so that float32 represents them
    level = torch.arange(_BINS, dtype=counts.dtype, device=counts.device) - centre
    share = counts / counts.sum(1, keepdim=True).clamp_min(1)
    below, moment = share.cumsum(1), (share * level).cumsum(1)
    square = (share * level * level).cumsum(1)
    product = below * (1 - below)
    two = product > 1e-6
    offset = moment - moment[:, -1:] * below
    between = torch.where(two, offset * offset / torch.where(two, product, 1.0), 0.0)
    best = between.argmax(1, keepdim=True)
    part = below.gather(1, best).clamp(1e-6, 1 - 1e-6)
    lower = moment.gather(1, best) / part
    upper = (moment[:, -1:] - moment.gather(1, best)) / (1 - part)
    deviation = (square.gather(1, best) / part - lower * lower).clamp_min(0).sqrt()
    threshold = torch.where(two.gather(1, best), best.to(counts.dtype), torch.nan)
    results = (threshold, lower + centre, upper + centre, deviation)
    return tuple(result.squeeze(1) for result in results)


def _range(frames: Tensor, value_range: tuple[float, float] | None) -> tuple[float, float]:
    check_frames(frames)
    if value_range is None:
        if frames.dtype != torch.uint8:
            raise ValueError(
                f"a histogram of {frames.dtype} needs value_range=(low, high): the dtype does not tell the range "
                "of the values (12-bit frames: (-1, 4095))"
            )
        return -1.0, 255.0
    low, high = value_range
    if not low < high:
        raise ValueError(f"value_range {value_range}: high must be above low")
    return float(low), float(high)


@functools.lru_cache(8)
def _bin_of_level(dtype: torch.dtype, bins: int, low: float, high: float) -> Tensor:
    """Return the lookup table, as uint16, from each level of an unsigned integer dtype to the level's histogram bin."""
    levels = torch.arange(1 << 8 * dtype.itemsize, dtype=torch.int32, device="cpu")
    return _bin_index(levels[None], bins, low, high)[0].to(torch.uint16)


def _bin_index(frames: Tensor, bins: int, low: float, high: float) -> Tensor:
    """Return the histogram bin (B, H W) int32 of every pixel; pixels that are not finite get the index `bins`."""
    values = frames.flatten(1)
    if not frames.is_floating_point() and high - low == bins and low.is_integer():  # one integer per bin
        if frames.dtype == torch.uint8 and low == -1 and bins == 256:
            return values.int()
        return (values.int() - (int(low) + 1)).clamp(0, bins - 1)
    values = values if values.dtype in (torch.float32, torch.float64) else values.double()
    counted = torch.isfinite(values)
    index = ((torch.where(counted, values, low) - low) * (bins / (high - low))).ceil() - 1
    return torch.where(counted, index.clamp(0, bins - 1), bins).int()
