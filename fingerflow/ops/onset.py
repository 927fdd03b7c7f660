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


def place_of_onset(before: Tensor, first: Tensor) -> Tensor:
    """Where skin was when it came into contact: half way between the last frame without contact and the first with it.

    The contact comes at some moment between the two, any of them alike: half a frame before the second, on average.
    Counted from the second, as the papers do, skin has moved by half a frame on average that is missing in its
    displacement; what is left here is the error of the moment, uniform over a frame, without a mean.

    Args:
        before: (..., 2) where it was in the frame before, NaN where that is not known.
        first: (..., 2) where it is in the first frame with contact.

    Returns:
        (..., 2); `first` where `before` is not known.
    """
    return torch.where(torch.isfinite(before).all(-1, keepdim=True), (before + first) / 2, first)
