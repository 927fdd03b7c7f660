"""Bounding rectangle of masks.

No compiled twin.
"""

from torch import Tensor

from fingerflow.ops.branching import may_branch

Range = tuple[int, int]


def mask_bounds(mask: Tensor, margin: int, least: int) -> tuple[Range, Range]:
    """Return the smallest ranges [first, last) of rows and of columns that hold the True pixels of all masks (B, 1, H,
    W), widened by `margin` px at both ends.

    The ranges are those of the whole image if the masks are empty, or if the rectangle has fewer than `least` pixels or
    a side of at most two margins. So too where shapes must not depend on data: while torch compiles, traces or exports,
    and on a device that the host would have to wait for.
    """
    height, width = mask.shape[-2:]
    whole = (0, height), (0, width)
    if not may_branch(mask):
        return whole
    bounds = []
    for axis, length in ((3, height), (2, width)):
        touched = mask.any(axis).flatten(0, 1).any(0).nonzero()
        if not len(touched):
            return whole
        bounds.append((max(int(touched[0]) - margin, 0), min(int(touched[-1]) + 1 + margin, length)))
    rows, columns = bounds
    high, wide = rows[1] - rows[0], columns[1] - columns[0]
    return (rows, columns) if high * wide >= least and min(high, wide) > 2 * margin else whole
