"""Kernel that fits the shifts of windows of an image from earlier windows, on NumPy arrays."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import copied
from fingerflow.kernels.checks import check_axes, check_like, checked
from fingerflow.kernels.library import entry, threads

Array = NDArray[Any]


class Shifts(NamedTuple):
    """Shifts by which most samples of N windows match those of earlier windows best.

    Attributes:
        shift: (N, 2) px; 0 for a window with a sample that is NaN or infinite.
        weight: (N, m) of the samples in the fit; 0 for samples that do not match.
        deviations: (N,) length of the shift in its own standard deviations, which are large along straight ridges.
        excluded: (N,) share of the samples that do not match.
    """

    shift: Array
    weight: Array
    deviations: Array
    excluded: Array


def shift_windows(then: Array, around: Array, now: Array, shift: Array, weight: Array, noise: float) -> Shifts:
    """Improve shifts (N, 2) px and weights (N, m) of samples, float64, as `tracker.window_match.fit_shifts`; windows
    `then` and `now` (N, m) and `around` (4, N, m) are float32.

    Raises:
        ValueError: wrong dtype, inconsistent shapes, or windows without a sample.
    """
    check_axes("then", then, 2)
    count, samples = then.shape
    if not samples:
        raise ValueError("windows have no sample: give (N, m) with m of 1 or more")
    check_like("shift", shift, "float64", (count, 2))
    check_like("weight", weight, "float64", (count, samples))
    result = Shifts(copied(shift), copied(weight), *np.empty((2, count)))
    entry("shift_windows")(
        then=checked("then", then, "float32", (count, samples)),
        now=checked("now", now, "float32", (count, samples)),
        around=checked("around", around, "float32", (4, count, samples)),
        windows=count,
        samples=samples,
        noise=noise,
        threads=threads(),
        **result._asdict(),
    )
    return result
