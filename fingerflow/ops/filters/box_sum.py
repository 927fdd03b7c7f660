"""Sums over square windows, by additions only, so that a NaN affects only the windows that contain it.

A window of n is a sum of windows of powers of two, by the binary digits of n. No compiled twin.
"""

from torch import Tensor


def box_sum(values: Tensor, size: int) -> Tensor:
    """Compute the sum over every `size` x `size` window of `values`, in at most 4 log2(size) passes.

    Args:
        values: (..., H, W), H and W at least `size`.
        size: window side in pixels, odd or even.

    Returns:
        (..., H - size + 1, W - size + 1), in the dtype of `values`.
    """
    return _line_sum(_line_sum(values, size, -2), size, -1)


def _line_sum(values: Tensor, size: int, axis: int) -> Tensor:
    """Sum windows of `size` neighbours along one axis, from sums over powers of two (the binary digits of `size`)."""
    length = values.shape[axis] - size + 1
    total, start, span = None, 0, 1
    while True:
        if size & span:
            part = values.narrow(axis, start, length)
            total = part if total is None else total + part
            start += span
        if 2 * span > size:
            assert total is not None
            return total
        reach = values.shape[axis] - span
        values = values.narrow(axis, 0, reach) + values.narrow(axis, span, reach)
        span *= 2
