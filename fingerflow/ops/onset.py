"""When a point comes into contact: the rule by which a stream and a recording count alike."""

import torch
from torch import Tensor

#: Frames in a row that the contact covers a point to count as its onset.
LASTING = 3


def touch_length(before: Tensor, covered: Tensor) -> Tensor:
    """For how many frames in a row the contact has covered points, `LASTING` once it did for so many.

    A touch of fewer frames is forgotten: whether the border grazes a point is chance, and the skin moves on until it
    comes to stay. What has come to stay counts, whatever becomes of the contact.

    Args:
        before: (...) the same in the frame before, 0 in the first.
        covered: (...) bool, or 0 and 1.

    Returns:
        (...) of the dtype of `before`; 1 where a touch begins.
    """
    return torch.where(before < LASTING, covered.to(before.dtype) * (before + 1), before)
