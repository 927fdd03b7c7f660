"""The part of pictures that a mask covers."""

from torch import Tensor

from fingerflow.ops.looking import looks

Range = tuple[int, int]


def mask_bounds(mask: Tensor, margin: int, least: int) -> tuple[Range, Range]:
    """First and last + 1 row, then column, of all that a mask (B, 1, H, W) covers, with a margin in px.

    Those of the whole pictures where that is nothing, not wider than two margins, or fewer than `least` pixels; and
    where no shape may depend on data: compiled, traced, exported, or on a device that would be waited for.
    """
    height, width = mask.shape[-2:]
    whole = (0, height), (0, width)
    if not looks(mask):
        return whole
    found = []
    for axis, length in ((3, height), (2, width)):
        touched = mask.any(axis).flatten(0, 1).any(0).nonzero()
        if not len(touched):
            return whole
        found.append((max(int(touched[0]) - margin, 0), min(int(touched[-1]) + 1 + margin, length)))
    rows, columns = found
    high, wide = rows[1] - rows[0], columns[1] - columns[0]
    return (rows, columns) if high * wide >= least and min(high, wide) > 2 * margin else whole
