"""Values of given ranks in rows of numbers, for kernels of Triton: medians and quantiles without sorting."""

import triton
import triton.language as tl


@triton.jit
def value_of_rank(values, known, rank):
    """Return, for each row of float32 `values` (rows, n), the `known` value of a rank (rows, 1), counted from 0.

    Integers with the order of the values are compared: each of 32 comparisons finds one binary digit of the result.
    """
    bits = values.to(tl.int32, bitcast=True).to(tl.int64)
    keys = tl.where(bits < 0, -bits - 1 - (1 << 31), bits) + (1 << 31)
    keys = tl.where(known, keys, (1 << 32) - 1)
    found = tl.zeros_like(rank).to(tl.int64)
    digit = found + (1 << 31)
    for number in range(32):
        trial = found + digit
        below = tl.sum((keys < trial).to(tl.int32), 1)[:, None]
        found = tl.where(below <= rank, trial, found)
        digit = digit // 2
    ordered = found - (1 << 31)
    bits = tl.where(ordered < 0, -ordered - 1 - (1 << 31), ordered)
    return bits.to(tl.int32).to(tl.float32, bitcast=True)
