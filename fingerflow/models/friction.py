"""Dahl's friction model: stiff like a spring at first, sliding at a limit (Dahl 1968; Willemet et al. 2021, eq. 7).

F is the force on the body that carries the slider; the skin feels -F, against its motion. Over a distance x slid in the
direction s = sign(dx),

    dF/dx = sigma_0 |1 - s F / F_c|^n sign(1 - s F / F_c)

with the limit F_c = mu p. The printed time derivative has a factor "s" too many: dF/dt = (dF/dx) (dx/dt). With
u = 1 - s F / F_c, which is 0 at the limit, u^(1 - n) falls in proportion to the distance, at the rate
(1 - n) sigma_0 / F_c. A step of any length therefore has a closed form, and a sustained force does not creep with the
step length.

V = F^2 / (2 sigma_0) is an energy that is never created, for every n >= 0: dV = F dx u^n <= F dx, as F s has the sign
of 1 - u. A falling limit reduces F and V without work; a rising limit changes neither.
"""

import torch
from torch import Tensor


def dahl_step(
    force: Tensor | float,
    slid: Tensor | float,
    limit: Tensor | float,
    *,
    stiffness: Tensor | float = 500.0,
    exponent: Tensor | float = 0.7,
) -> Tensor:
    """Return the exact friction force (N) after a slide in one direction at a constant limit; all arguments broadcast.

    If the limit changed since the step before, the force is first clamped to it, so |F| <= F_c always. An infinite
    stiffness gives Coulomb friction: the limit after any slide, the previous force without one. The force is
    differentiable except where it reaches the limit (n < 1) or the direction changes.

    Args:
        force: F before, N, along +x where it resists a motion along +x.
        slid: dx, m, of either sign.
        limit: F_c = mu p during the step, N, 0 or more; at 0 the force is 0.
        stiffness: sigma_0 at F = 0, N/m, positive; the paper's is 500.
        exponent: n >= 0; the paper's is 0.7. 0 is a spring up to the limit, 1 an exponential approach.

    Raises:
        ValueError: a negative limit or exponent, a stiffness that is not positive, or NaN in any.
    """
    given = (force, slid, limit, stiffness, exponent)
    before, slide, most, spring, n = torch.broadcast_tensors(*(torch.as_tensor(x, dtype=torch.float64) for x in given))
    for name, value, allowed in (
        ("limit", most, most >= 0),
        ("stiffness", spring, spring > 0),
        ("exponent", n, n >= 0),
    ):
        if not bool(allowed.all()):
            least = "above 0" if name == "stiffness" else "0 or more"
            raise ValueError(f"{name} {value[~allowed].flatten()[0].item()}: Dahl's model needs {least}")
    before = torch.minimum(torch.maximum(before, -most), most)
    sign = slide.sign()
    moves = (slide != 0) & (most > 0)
    safe = torch.where(moves, most, 1.0)
    left = torch.where(moves, 1 - sign * before / safe, 1.0)  # u, 0 to 2
    at_limit = left <= 0
    left = torch.where(at_limit, 1.0, left)
    distance = torch.where(moves, spring * torch.where(moves, slide, 1.0).abs() / safe, 0.0) * left ** (n - 1)
    lost = share_lost(distance, n)
    after = torch.where(lost >= 1, sign * safe, before + sign * safe * left * lost)
    after = torch.where(moves & ~at_limit, after, before)
    return torch.minimum(torch.maximum(after, -most), most)  # the sum may round beyond the limit


def share_lost(distance: Tensor, exponent: Tensor) -> Tensor:
    """Return 1 - u / u_0 after a distance d in units of F_c u_0^(1 - n) / sigma_0: 1 - (1 - (1 - n) d)^(1 / (1 - n)).

    For n = 1 this is 1 - exp(-d), and it does not cancel near n = 1. It is 1 once a model with n < 1 reaches the limit.
    """
    power = 1 - exponent
    exponential = power == 0
    power = torch.where(exponential, 1.0, power)
    base = power * distance
    reached = base >= 1
    logarithm = torch.log1p(-torch.where(reached, 0.0, base)) / power
    logarithm = torch.where(exponential, -distance, logarithm)
    return torch.where(reached & ~exponential, 1.0, -torch.expm1(logarithm))
