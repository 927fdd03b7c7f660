"""Model curves of partial slip: load ratio T/N as a function of the stuck area share d^2.

d^2(T/N) has an infinite slope where the area vanishes. Its inverse is smooth and single-valued: a sum of known
functions of d^2 weighted by the friction coefficients.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Functions = Callable[[Values], Values]


@dataclass(frozen=True)
class CurveFamily:
    """Model curve of the load ratio T/N as a function of the stuck area share d^2, with first and second derivative.

    Each function returns one term for each of P friction coefficients.
    """

    name: str
    coefficients: tuple[str, ...]
    load: Functions
    slope: Functions
    curvature: Functions


PARTIAL_SLIP = CurveFamily(
    "partial slip",
    ("mu_s", "mu_k"),
    lambda s: np.stack([2 * s * (1 - s), (1 - s) ** 2], -1),
    lambda s: np.stack([2 - 4 * s, 2 * s - 2], -1),
    lambda s: np.stack([np.full_like(s, -4.0), np.full_like(s, 2.0)], -1),
)
EQUAL_FRICTION = CurveFamily(
    "equal friction",
    ("mu",),
    lambda s: 1 - s[..., None] ** 2,
    lambda s: -2 * s[..., None],
    lambda s: np.full_like(s, -2.0)[..., None],
)
TADA = CurveFamily(
    "Tada",
    ("mu",),
    lambda s: 1 - np.maximum(s, 0)[..., None] ** 1.5,
    lambda s: -1.5 * np.sqrt(np.maximum(s, 0))[..., None],
    # The curvature is infinite where the area vanishes. It is bounded by its value at 0.05, where noise hides the area
    # anyway.
    lambda s: -0.75 / np.sqrt(np.maximum(s, 0.05))[..., None],
)
