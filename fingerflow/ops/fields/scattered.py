"""Input checks and dtypes shared by all operations on scattered points."""

import math
from functools import reduce

import torch
from torch import Tensor


def check_scattered(points: Tensor, values: Tensor) -> None:
    """Raise TypeError or ValueError unless points (B, N, 2) and values (B, N, C) are floating point and equal in
    number.

    Either batch may be 1 and then serves all items of the other: reference positions are often the same for all frames.
    """
    for name, tensor in (("points", points), ("values", values)):
        if not tensor.is_floating_point():
            raise TypeError(f"{name} must be floating, found {tensor.dtype}: convert with .float() or .double()")
    if points.dim() != 3 or points.shape[-1] != 2:
        raise ValueError(f"points must have shape (B, N, 2), x and y last, found {tuple(points.shape)}")
    if values.dim() != 3 or values.shape[1] != points.shape[1]:
        raise ValueError(f"values must have shape (B, {points.shape[1]}, C) as points, found {tuple(values.shape)}")
    check_batches(points=points, values=values)


def check_batches(**tensors: Tensor) -> None:
    """Raise ValueError unless the batch sizes (first dimensions) of all tensors are equal or 1."""
    sizes = {name: tensor.shape[0] for name, tensor in tensors.items()}
    batches = [size for size in sizes.values() if size != 1]  # no set, whose hashes would fix an exported batch
    if any(size != batches[0] for size in batches):
        found = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ValueError(f"batches must be equal, or 1 to serve all; found {found}")


def check_gauge_length(gauge_length: float) -> None:
    """Raise ValueError unless a gauge length is positive and finite."""
    if not (math.isfinite(gauge_length) and gauge_length > 0):
        raise ValueError(f"gauge_length must be a positive length in the unit of the points, found {gauge_length}")


def working_dtype(*tensors: Tensor) -> torch.dtype:
    """Return the dtype for computations with tensors: the widest of the tensors' dtypes, but at least float32.

    Differences of half-precision positions would lose the strain.
    """
    return torch.promote_types(torch.float32, result_dtype(*tensors))


def result_dtype(*tensors: Tensor) -> torch.dtype:
    """Return the dtype of a result: the widest of the tensors' dtypes."""
    return reduce(torch.promote_types, (tensor.dtype for tensor in tensors))
