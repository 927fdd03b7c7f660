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
    while 2 * span <= size:
        if size & span:
            part = values.narrow(axis, start, length)
            total = part if total is None else total + part
            start += span
        # The largest power of two is summed only where a window ends with it.
        first, reach = (start, length) if 4 * span > size else (0, values.shape[axis] - span)
        values = values.narrow(axis, first, reach) + values.narrow(axis, first + span, reach)
        span *= 2
    return values if total is None else total + values
