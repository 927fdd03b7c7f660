"""Evaluation of a batch a few frames at a time, so that intermediate images fit into the processor's cache."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from fingerflow.ops.branching import may_branch

# Pixels of a piece: planes of one 512 x 640 frame stay in a processor's cache, those of a long batch do not.
_PIXELS = 1 << 19
_WINDOWS = 1 << 12  # windows of a piece: about 1 GB of intermediate results for windows of 25 px


def points_at_once(like: Tensor, in_cache: int) -> int:
    """Return how many windows to compute in one call: where the tensor `like` lies on a CPU, the number `in_cache` that
    fits into the cache, elsewhere a number that limits memory.
    """
    return in_cache if like.is_cpu else _WINDOWS


def frames_at_once(frames: Tensor) -> int:
    """Return how many frames (B, 1, H, W) to compute at once so that intermediate images fit into the cache."""
    return max(1, _PIXELS // max(1, frames.shape[1:].numel()))


def in_pieces(compute: Callable[..., Any], at_once: int, *tensors: Tensor | None) -> Any:
    """Evaluate `compute(*given)` for at most `at_once` frames of the batch at a time, and return the concatenated
    results.

    It returns a tensor, or a tuple of tensors, with one row per frame. While a graph is traced and on devices
    other than the CPU the whole batch is computed in one call.

    Args:
        compute: function that treats frames independently.
        at_once: frames per piece; values below 1 count as 1.
        tensors: tensors of B frames, tensors of one frame shared by all, or None.
    """
    at_once = max(1, at_once)
    if not may_branch(*tensors) or (frames := max(len(tensor) for tensor in tensors if tensor is not None)) <= at_once:
        return compute(*tensors)
    pieces = [
        compute(*(part if part is None or len(part) == 1 else part[start : start + at_once] for part in tensors))
        for start in range(0, frames, at_once)
    ]
    if isinstance(pieces[0], Tensor):
        return torch.cat(pieces)
    return tuple(None if parts[0] is None else torch.cat(parts) for parts in zip(*pieces, strict=True))
