"""How far frames are from those before them, whatever moves in them and however the lamp flickers."""

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

#: Frames in a row, at most, after which a picture that comes back counts as the one before.
LONGEST = 3
# Blocks are wider than ridges, which would seem to stand still, or to jump and return, where they move by half of their
# distance from frame to frame. A tear, or lines that were lost, lie in a few rows of blocks.
_BLOCK_PX, _BLOCKS = 24, 16
_SAMPLES = (128, 160)  # rows and columns that are read, at most twice as many
# Least distances that count: below the first lies noise, and light that changes by less is what `light_gain` is for.
_LEAST, _LEAST_LIGHT = 3e-3, 0.055


def block_means(frames: Tensor) -> Tensor:
    """Means of blocks of 24 px or more, up to 16 x 16 of them, (n, rows, columns) float32, of frames (n, 1, H, W).

    Some 20,000 pixels of a frame are read.
    """
    height, width = frames.shape[2:]
    down, along = (max(1, side // samples) for side, samples in zip((height, width), _SAMPLES, strict=True))
    # Lines first, as they are in memory: of the whole frame it takes half as long again.
    sampled = frames[..., down // 2 :: down, :].contiguous()[..., along // 2 :: along].float()
    rows, columns = (
        min(max(1, side // _BLOCK_PX), _BLOCKS, read)
        for side, read in zip((height, width), sampled.shape[2:], strict=True)
    )
    return adaptive_avg_pool2d(sampled, (rows, columns))[:, 0]


def block_distances(blocks: Tensor, before: Tensor) -> Tensor:
    """How far each frame is from the `LONGEST` + 1 before it: in rows of blocks, and in its light.

    Args:
        blocks: (n, rows, columns) of `block_means`.
        before: (m, rows, columns) those of the frames before, as far as there are any.

    Returns:
        (n, LONGEST + 1, rows + 1): mean absolute differences of blocks over the mean of their frame, so that a lamp
        that flickers changes none, in units of what counts at least; and the last, that of the logarithms of the means,
        likewise. NaN where there is no such frame.
    """
    every = torch.cat([before, blocks])
    mean = every.mean((1, 2), keepdim=True).clamp_min(torch.finfo(every.dtype).tiny)
    even, light = every / mean, mean.log().flatten()
    result = even.new_full((len(blocks), LONGEST + 1, every.shape[1] + 1), torch.nan)
    for gap in range(1, LONGEST + 2):
        first = max(gap - len(before), 0)  # of `blocks`
        if first >= len(blocks):
            break
        later, earlier = slice(len(before) + first, None), slice(len(before) + first - gap, len(every) - gap)
        result[first:, gap - 1, :-1] = (even[later] - even[earlier]).abs().mean(2) / _LEAST
        result[first:, gap - 1, -1] = (light[later] - light[earlier]).abs() / _LEAST_LIGHT
    return result
