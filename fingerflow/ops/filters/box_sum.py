"""Sums over square windows by doubling: additions only, so that a NaN spoils the windows that hold it and no other."""

from torch import Tensor


def box_sum(values: Tensor, size: int) -> Tensor:
    """Sum of every `size` x `size` window: 4 log2(size) passes at most, in the dtype of `values`.

    Args:
        values: (..., H, W), H and W at least `size`.
        size: window side in pixels, odd or even.

    Returns:
        (..., H - size + 1, W - size + 1).
    """
    return _line_sum(_line_sum(values, size, -2), size, -1)


def _line_sum(values: Tensor, size: int, axis: int) -> Tensor:
    """Sum of `size` neighbours from sums of 1, 2, 4 ... neighbours: those in the binary digits of `size`."""
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
