"""Dahl's friction model: elastic at small displacement, then sliding (Dahl 1968; Willemet et al. 2021, eq. 7).

F is the force on the body that carries the slider; the skin feels -F, against its motion. Over a distance x slid in the
direction s = sign(dx),

    dF/dx = sigma_0 |1 - s F / F_c|^n sign(1 - s F / F_c)

with the limit F_c = mu p, and dF/dt = (dF/dx) (dx/dt): the "s" before the printed derivative is most likely a line
mark of the scan. With
u = 1 - s F / F_c, which is 0 at the limit, u^(1 - n) falls in proportion to the distance, at the rate
(1 - n) sigma_0 / F_c. A step of any length therefore has a closed form, and a sustained force does not creep with the
step length.

V = F^2 / (2 sigma_0) is an energy that is never created, for every n >= 0: dV = F dx u^n <= F dx, as F s has the sign
of 1 - u. A falling limit reduces F and V without work; a rising limit changes neither.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dahl_friction(
    before: Array, old: Array, position: Array, steep: Array, stiffness: float = 500.0, exponent: float = 0.7
) -> tuple[Array, Array, Array]:
    """Compute the friction force of Dahl's model on N elements that move from positions `old` to `position` (N, 2), m,
    over a plate at z = 0, from the force `before` this movement and the friction limit per depth, `steep`; return the
    forces (N,) and their derivatives with respect to x and z of the elements.

    The closed form is taken at the mean of the limits before and after, which makes the error of a changing limit third
    order. The result is clamped to the last limit, so the force never exceeds it.

    Args:
        before: (N,) N, the force before, positive where it opposes motion along +x.
        old, position: (N, 2) m, x along the plate and z above it; the limit is F_c = steep max(-z, 0).
        steep: (N,) N/m, the friction coefficient times the plate's stiffness.
        stiffness: sigma_0 at F = 0, N/m, positive; the paper's is 500.
        exponent: n >= 0; the paper's is 0.7. 0 is a spring up to the limit, 1 an exponential approach.
    """
    last = steep * np.maximum(-position[:, 1], 0)
    limit = (last + steep * np.maximum(-old[:, 1], 0)) / 2
    on = np.flatnonzero((limit > 0) & (position[:, 1] < 0))
    slid = position[on, 0] - old[on, 0]
    force, along, above = np.zeros((3, len(position)))
    force[on], along[on], above[on] = _on_plate(before[on], slid, limit[on], last[on], steep[on], stiffness, exponent)
    return force, along, above


def _on_plate(
    before: Array, slid: Array, limit: Array, last: Array, steep: Array, stiffness: float, exponent: float
) -> tuple[Array, Array, Array]:
    """Compute the friction of `dahl_friction` for K elements on the plate that slid by `slid` (K,) m under the mean
    limit `limit` and the last limit `last`, (K,) N.
    """
    sign = np.where(slid < 0, -1.0, 1.0)
    n, power = exponent, 1 - exponent
    held = np.clip(before, -limit, limit)
    cut = held != before
    left = 1 - sign * held / limit
    done = left <= 0
    left = np.where(done, 1.0, left)
    distance = stiffness * np.abs(slid) / limit * left ** (n - 1)
    if power == 0:
        fraction, rest = np.exp(-distance), np.exp(-distance)
    else:
        base = np.maximum(1 - power * distance, 0)
        fraction = base ** (1 / power)  # u / u_0
        rest = np.where(base > 0, base ** (n / power), 0.0)  # -d(u / u_0) / d distance = (u / u_0)^n
    after = np.where(done, sign * limit, held + sign * limit * left * (1 - fraction))
    along = stiffness * left**n * rest
    # u^(1-n) = u_0^(1-n) - (1-n) sigma_0 d / F: a change of the limit changes u_0 and the scaled distance.
    of_left = np.where(cut, 0.0, sign * held / limit**2)
    of_limit = np.where(
        done, sign, sign * (1 - left * fraction) - sign * limit * (rest * of_left + left * rest * distance / limit)
    )
    over = np.abs(after) > last
    above = np.where(over, -np.where(after < 0, -1.0, 1.0) * steep, -of_limit * steep / 2)
    return np.clip(after, -last, last), np.where(done | over, 0.0, along), above
