"""Dahl's model of friction, which sticks like a spring and slides at a limit (Dahl 1968; Willemet et al. 2021, eq. 7).

Over a distance x slid in the direction s = sign(dx), the force F on what carries the slider (the skin feels -F, against
its motion) follows

    dF/dx = sigma_0 |1 - s F / F_c|^n sign(1 - s F / F_c)

with the limit F_c = mu p. The printed time derivative has a factor "s" too many: dF/dt = (dF/dx) (dx/dt). With
u = 1 - s F / F_c, which is 0 at the limit, u^(1 - n) falls in proportion to the distance, at the rate
(1 - n) sigma_0 / F_c: so a step of any length has a closed form, and a force that is held does not creep with the step.

V = F^2 / (2 sigma_0) is an energy that is never created, for every n >= 0: dV = F dx u^n <= F dx, as F s has the sign
of 1 - u. A limit that falls cuts F and V down without work, and one that rises changes neither.
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
    """Friction force (N) after a slide in one direction at a constant limit, exact; all arguments broadcast.

    Where the limit changed since the step before, the force is first cut to it: |F| <= F_c always. An infinite
    stiffness is Coulomb's friction: the limit after any slide, and what it was before without one. Differentiable
    where the model is: not across the arrival at the limit (n < 1) and a change of direction.

    Args:
        force: F before, N, along +x where it resists a motion along +x.
        slid: dx, m, of either sign.
        limit: F_c = mu p during the step, N, 0 or more; no force without one.
        stiffness: sigma_0 at F = 0, N/m, positive; the paper's is 500.
        exponent: n >= 0; the paper's is 0.7. 0 is a spring to the limit, 1 an exponential approach.

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
    return torch.minimum(torch.maximum(after, -most), most)  # the sum may round beyond it


def share_lost(distance: Tensor, exponent: Tensor) -> Tensor:
    """1 - u / u_0 after a distance in units of F_c u_0^(1 - n) / sigma_0: 1 - (1 - (1 - n) d)^(1 / (1 - n)).

    1 - exp(-d) for n = 1, and near it too without cancellation; 1 once an exponent below 1 has reached the limit.
    """
    power = 1 - exponent
    exponential = power == 0
    power = torch.where(exponential, 1.0, power)
    base = power * distance
    reached = base >= 1
    logarithm = torch.log1p(-torch.where(reached, 0.0, base)) / power
    logarithm = torch.where(exponential, -distance, logarithm)
    return torch.where(reached & ~exponential, 1.0, -torch.expm1(logarithm))
