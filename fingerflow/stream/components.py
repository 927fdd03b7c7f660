"""Points with their components first: ONNX Runtime is slow where the last axis is short."""

import torch
from torch import Tensor


def components_first(points: Tensor) -> Tensor:
    """(B, N, 2) to (B, 2, N), NaN in both where it is in one.

    A product, which takes the transposition into itself: alone it would be moved behind all that follows.
    """
    return torch.eye(2, dtype=points.dtype, device=points.device) @ points.transpose(1, 2)
