"""Real contact mask: pixels darker than a share of the empty glass's light, smoothed by a majority filter.

A majority filter is the median of a mask. Compiled twin: `kernels/real_contact_mask.cpp`.
"""

from functools import partial

import torch
from torch import Tensor

from fingerflow.kernels.contact import LARGEST_MAJORITY
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.checks import check_images, check_window
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.pieces import frames_at_once, in_pieces
from fingerflow.ops.tensors import bordered, count_bytes

_compiled: Twin[Tensor] = twin("real_contact_mask")


def real_contact_mask(frames: Tensor, light: Tensor, black: Tensor, limit: Tensor, median_px: int = 3) -> Tensor:
    """Return the real contact mask: lit pixels darker than black + limit * light, after a majority filter.

    The median of an odd number of pixels lies below a limit exactly where most of them do. The result therefore equals
    the comparison of the median-filtered intensity loss with the threshold 1 - limit, but no quotient is formed.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating, camera counts.
        light, black: (1 or B, 1, H, W) floating, of `ops.filters.illumination.glass_light`: counts due to the lamp (0
            where the glass is not lit) and counts without light.
        limit: (B,) share of the light, clamped to 0 to 1. With NaN no pixel lies below.
        median_px: odd side of the windows; 1 for no filter. Beyond the frame the nearest pixel counts.

    Returns:
        (B, 1, H, W) bool. A pixel that is NaN or not lit counts as not below.

    Raises:
        ValueError: shapes that do not fit, or an even side.
    """
    check_images(frames, light=light, black=black)
    check_window(median_px)
    if limit.shape != frames.shape[:1]:
        raise ValueError(f"limit has shape {tuple(limit.shape)} for {len(frames)} frames: give one number a frame")
    # At most the full light, so that a saturated pixel is never in contact.
    share = torch.where(limit == limit, limit.clamp(0, 1), -torch.inf).to(light.dtype)
    if median_px <= LARGEST_MAJORITY and _compiled.serves(frames, light, black, share):
        return _compiled(frames, light, black, share, median_px)
    compute = partial(_mask, median_px)
    return in_pieces(compute, frames_at_once(frames), frames, light, black, light.to(torch.bool), share)


def _mask(median_px: int, frames: Tensor, light: Tensor, black: Tensor, lit: Tensor, share: Tensor) -> Tensor:
    counts = share.reshape(-1, 1, 1, 1) * light + black
    if frames.dtype == torch.uint8 and not torch.compiler.is_exporting():
        # An integer lies below a limit exactly where it lies below the limit rounded up; bytes compare 20 times as
        # fast. The cast goes through int16: a direct one to bytes takes three times as long.
        below = frames < counts.ceil_().clamp_(0, 255).to(torch.int16).to(torch.uint8)
    else:
        below = frames.to(counts.dtype) < counts
    return below & lit if median_px == 1 else majority(below & lit, median_px) & lit


def majority(holds: Tensor, size: int) -> Tensor:
    """Apply a majority filter to masks (B, 1, H, W): True where over half of the `size` x `size` window is True.

    Beyond the frame the nearest pixel counts.
    """
    bits = bordered(count_bytes(holds), size // 2)
    counts, most = box_sum(bits if size < 16 else bits.to(torch.int32), size), size * size // 2
    if torch.compiler.is_exporting():  # ONNX Runtime does not compare bytes on a GPU
        return (counts.clamp_min(most) - most).to(torch.bool)
    return counts > torch.full_like(counts, most)  # two tensors of bytes compare 10 times as fast
