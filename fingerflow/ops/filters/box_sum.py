"""Sums over square windows by doubling: only additions, so that a NaN affects only the windows that contain it."""

from torch import Tensor


def box_sum(values: Tensor, size: int) -> Tensor:
    """Compute the sum of every `size` x `size` window: at most 4 log2(size) passes, in the dtype of `values`.

    Args:
        values: (..., H, W), H and W at least `size`.
        size: window side in pixels, odd or even.

    Returns:
        (..., H - size + 1, W - size + 1).
    """
    return _line_sum(_line_sum(values, size, -2), size, -1)


def _line_sum(values: Tensor, size: int, axis: int) -> Tensor:
    """Sum windows of `size` neighbours along an axis, from sums of 1, 2, 4 ... neighbours (binary digits of `size`)."""
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
