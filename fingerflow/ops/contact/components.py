"""Fill holes and find the largest connected component of masks, from horizontal runs of pixels.

A mask of half a million pixels has only about ten thousand horizontal runs. They are the nodes of a graph; an edge
joins two runs of neighbouring rows that touch. The components of the graph are found by hooking and pointer jumping
(after Shiloach & Vishkin 1982). Each round halves the paths, so a spiral takes a few rounds, not one for each turn.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.checks import check_mask


def fill_holes(mask: Tensor) -> Tensor:
    """Fill the holes of masks: background that no 4-connected path joins to the border of the frame.

    Args:
        mask: (B, 1, H, W) bool.

    Returns:
        (B, 1, H, W) bool. Background at the border of the frame is never a hole: a ring cut by the frame stays open.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W).
    """
    check_mask(mask)
    if mask.numel() == 0:
        return mask.clone()
    height, width = mask.shape[-2:]
    runs = _find_runs(~mask)
    part = _connected_part(runs, mask.shape, diagonal=False)
    row = runs.first // width % height
    at_border = (row == 0) | (row == height - 1) | (runs.first % width == 0) | (runs.last % width == width - 1)
    outside = torch.zeros_like(at_border)
    outside[part[at_border]] = True
    return ~_paint(runs, outside[part], mask)


def largest_component(mask: Tensor) -> Tensor:
    """Return the largest 8-connected component of each mask, or the first in reading order of equally large ones.

    Args:
        mask: (B, 1, H, W) bool.

    Returns:
        (B, 1, H, W) bool; empty for an empty mask.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W).
    """
    check_mask(mask)
    if mask.numel() == 0:
        return mask.clone()
    runs = _find_runs(mask)
    part = _connected_part(runs, mask.shape, diagonal=True)
    count = len(part)
    area = torch.zeros_like(part).index_add(0, part, runs.last - runs.first + 1)
    # Combine area and reading order in one integer for sorting. A component is labelled by its first run.
    score = area * count + (count - 1 - torch.arange(count, device=mask.device))
    frame = runs.first // (mask.shape[-2] * mask.shape[-1])
    best = score.new_zeros(len(mask)).scatter_reduce(0, frame, score, "amax")
    return _paint(runs, score[part] == best[frame], mask)


class _Runs(NamedTuple):
    """Horizontal runs of True pixels in a mask: flat indices of the first and the last pixel of each run."""

    first: Tensor
    last: Tensor


def _find_runs(mask: Tensor) -> _Runs:
    width = mask.shape[-1]
    padded = functional.pad(mask, (1, 1))
    begins, ends = mask & ~padded[..., :width], mask & ~padded[..., 2:]
    return _Runs(begins.flatten().nonzero().squeeze(1), ends.flatten().nonzero().squeeze(1))


def _paint(runs: _Runs, chosen: Tensor, like: Tensor) -> Tensor:
    """Paint the chosen runs of pixels as True into a new mask of the shape of `like`."""
    change = torch.zeros(like.numel() + 1, dtype=torch.int8, device=like.device)
    change[runs.first[chosen]] = 1
    change[runs.last[chosen] + 1] -= 1  # subtracted, since a run may begin where a run of the row above has ended
    return change[:-1].cumsum(0, dtype=torch.int8).bool().reshape(like.shape)


def _connected_part(runs: _Runs, shape: torch.Size, diagonal: bool) -> Tensor:
    """Label the runs of a mask: return, for each run, the index of the first run in the same connected component."""
    height, width = shape[-2:]
    # The runs of the next row that touch run i are consecutive in the list: from the first that does not end before run
    # i begins to the last that does not begin after run i ends.
    reach = int(diagonal)
    begin = (runs.first % width - reach).clamp(min=0)
    end = (runs.last % width + reach).clamp(max=width - 1)
    row = runs.first // width
    below = (row + 1) * width
    lowest = torch.searchsorted(runs.last, below + begin)
    beyond = torch.searchsorted(runs.first, below + end, right=True)
    touching = torch.where(row % height < height - 1, beyond - lowest, 0)
    node = torch.arange(len(row), device=row.device)
    upper = node.repeat_interleave(touching)
    before = touching.cumsum(0) - touching
    lower = torch.arange(len(upper), device=row.device) + (lowest - before)[upper]
    return _join(node, upper, lower)


def _join(node: Tensor, upper: Tensor, lower: Tensor) -> Tensor:
    """Return, for each node of a graph whose edges join the nodes `upper` and `lower`, the smallest node of the same
    connected component.

    Edge k joins nodes `upper[k]` and `lower[k]`.
    """
    root = node
    while True:
        first, second = root[upper], root[lower]
        apart = first != second
        if not apart.any():
            return root
        upper, lower, first, second = upper[apart], lower[apart], first[apart], second[apart]
        # Hook the larger root below the smallest one it touches, then shorten all paths to their root.
        root = root.scatter_reduce(0, torch.maximum(first, second), torch.minimum(first, second), "amin")
        shorter = root[root]
        while not torch.equal(shorter, root):
            root, shorter = shorter, shorter[shorter]
