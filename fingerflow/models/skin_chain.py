"""Skin chain: elements around a bone, pressed on a plate with friction (Willemet et al. 2021, supplement).

It is derived from an energy, after the section "Skin deformation model".

**Energy.** Elements i at X_i = (x, z) surround a rigid bone displaced by U; the plate is at z = 0. X_i0 is the
undeformed half-circle of radius R, u_i = X_i - X_i0, and P the bone's point in its centre.

    E = 1/2 k_m sum |u_(i+1) - u_i|^2                  links between neighbours
      + sum W(R - |X_i - P|)                           tissue along the line to the bone
      + 1/2 k_s sum exp(c_i / c_0) |u_i - U|^2         tissue in every direction
      + 1/2 k_n sum over both ends |u_i - U|^2         the nail
      + 1/2 k_c sum min(z_i, 0)^2                      the plate, a penalty

A column of tissue has the stiffness k_t along itself and k_s across, as a solid has E and E / (2 (1 + nu)). Pulp
stiffens as it is compressed: both grow with c = R - |X - P| as exp(c / c_0) (Serina 1997; Pawluk & Howe 1999), so that
W(c) = (k_t - k_s) c_0 [c_0 (exp(c / c_0) - 1) - c]. A stretched column, and one with 1 / c_0 = 0, is linear, W = (k_t -
k_s) c^2 / 2.
All motion is damped: zeta dX_i/dt = -dE/dX_i - F_i, and the bone likewise with the load on it. F_i is Dahl's friction
along x under the limit mu k_c max(-z_i, 0), see `friction`. Without load, E decreases exactly by the dissipated power
zeta |dX/dt|^2 + F dx/dt.

**Why skin spreads.** A flattened column leans outward from the bone, so its compression has a component along the
plate, (k_t - k_s) times the slope of the arc: the chord is shorter than the arc laid on it. Friction opposes the
motion of each element and prevents part of the spreading: more friction, less divergence.

**Departures from print.** The links' force is equation 4 with its first sign corrected, +k_m (U_(i-1) - 2 U_i +
U_(i+1)); as printed it is unstable. Links that resist only a change of length would fold, because the chain does not
resist bending: at the edge of the contact the skin is compressed beyond k_t / (4 k_m), more so with every refinement.
The printed tissue springs act by component with k sin(alpha), k cos(alpha). That is no spring's force and does not
couple the directions; here the forces are derivatives of E. Friction in the last version of the published script points
along the sliding velocity and adds energy; in those before it opposes motion but never saturates. The term in nu is a
sign function along the chain, which pushes the two halves apart as blocks with a jump in the middle; here nu enters k_s
alone, of the linear sets. Lateral motion is therefore that of another model. Pressure, contact length and the sign and
order of magnitude of friction's effect can be compared with the paper's curves. The profiles of displacement and
divergence along the contact cannot.

The chain is a section: divergence is that of a finger of revolution around the bone's axis, du/dx + u/x, summarised by
its median along the contact. Towards the edge, where nothing presses outward any more, u falls and du/dx is negative,
and most of an area of revolution lies there. A median by area is therefore insensitive to friction, where the
median along the contact is 48, 22 and 17 um/mm at mu = 0, 0.05 and 1 with the lab's parameters, 251 elements and 3 N.
"""

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from fingerflow.kernels.tensors.torch_op import requires_gradient
from fingerflow.models.skin_motion import Chains, Motion, advance_chains
from fingerflow.models.skin_parameters import Number, SkinParameters, parameter_set

# m, position error allowed in one step; after some 150 steps positions are accurate to about twice that.
TOLERANCE_M = 5e-8
CONTACT_N = 1e-9  # N, normal force above which an element touches the plate; rounding leaves less
REST = 2e-7  # sum of the unbalanced forces, as a share of the load, below which the chain counts as at rest


@dataclass(frozen=True)
class PressedChain:
    """State of skin chains (N elements around a bone) pressed on a plate: positions, forces, strain and contact, for
    every parameter set (...).

    The results of `follow` have a leading axis of T times.
    """

    position: Tensor  # (..., N, 2) m, x along the plate and z above it
    displacement: Tensor  # (..., N, 2) m from the undeformed chain in its initial position
    normal_force: Tensor  # (..., N) N, force of the plate on each element
    friction_force: Tensor  # (..., N) N along x, force of the plate on each element
    pressure: Tensor  # (..., N) Pa, compression positive
    traction: Tensor  # (..., N) Pa along x on the skin
    coefficient: Tensor  # (..., N) coefficient of friction
    strain: Tensor  # (..., N) du/dx, NaN outside of the contact
    divergence_field: Tensor  # (..., N) du/dx + u/x, NaN outside of the contact
    divergence: Tensor  # (...) median of the divergence along the contact, NaN without contact
    contact_length: Tensor  # (...) m
    bone: Tensor  # (..., 2) m, displacement of the bone
    balance: Tensor  # (...) N, sum of the absolute unbalanced forces on elements and bone
    time: Tensor  # (...) s, elapsed time
    steps: Tensor  # (...) int64, number of time steps

    def strips(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the load on the skin's surface under the M elements that touch the plate, as edges of surface strips,
        pressure and traction, the arguments of `half_space.stress`.

        Edges (..., M + 1) are in m, pressure and traction (..., M) in Pa. Raises ValueError if nothing touches.
        """
        touched = (self.normal_force > CONTACT_N).reshape(-1, self.normal_force.shape[-1]).any(0)
        indices = touched.nonzero().flatten()
        if not len(indices):
            raise ValueError("no element touches the plate: there is no load to look under")
        first, end = max(1, int(indices[0])), min(len(touched) - 1, int(indices[-1]) + 1)
        x = self.position[..., first - 1 : end + 1, 0]
        return (x[..., 1:] + x[..., :-1]) / 2, self.pressure[..., first:end], self.traction[..., first:end]


def press(
    friction: Number,
    parameters: str | SkinParameters = "lab",
    load_n: Number = 3.0,
    *,
    tangential_n: Number = 0.0,
    elements: int = 501,
    tolerance_m: float = TOLERANCE_M,
    longest_s: float = 2.0,
) -> PressedChain:
    """Press a skin chain, a half-circle of elements around a bone, on a plate with a sudden load on the bone, until the
    unbalanced forces are below 2e-7 of the load; return its state.

    With friction the equilibrium depends on the path: this is the equilibrium after a sudden load. There is no
    gradient: difference presses of one batch, which costs less than an adjoint and may span several elements.

    Args:
        friction: coefficient mu >= 0, a number or a tensor for many presses.
        parameters: "lab", "paper", "fitted" or `SkinParameters`, whose tensors broadcast with friction and loads.
        load_n: force that presses the bone down, N.
        tangential_n: force that pulls the bone along +x, N.
        elements: 4 or more; the parameters refer to 501 elements and are converted.
        tolerance_m: position error in one step.
        longest_s: time limit. A bone pulled beyond the friction limit slides on: the press then ends without
            equilibrium, and `balance` shows it.

    Raises:
        ValueError: a negative or unknown friction, impossible parameters, fewer than 4 elements, or an input that
            requires a gradient.
        RuntimeError: no step length meets the tolerance.
    """
    chains, start = _undeformed_chains(friction, parameters, elements, load_n, tangential_n)
    coefficient, load = _coefficient(friction, chains), _load(chains.shape, load_n, tangential_n)
    rest = REST * load.abs().sum(-1).clamp_min(1e-3)
    loads = torch.stack((load, load), -2)
    end = advance_chains(chains, start, coefficient, loads, longest_s, tolerance_m, rest)
    return _pressed_chain(chains, end, coefficient, load)


def follow(
    friction: Number,
    time: Tensor,
    load_n: Tensor | float,
    *,
    parameters: str | SkinParameters = "lab",
    tangential_n: Tensor | float = 0.0,
    elements: int = 501,
    tolerance_m: float = TOLERANCE_M,
) -> PressedChain:
    """Compute the motion of a skin chain, a half-circle of elements around a bone, on a plate under a load on the bone
    that is linear between times (T,) s; return its states at these times.

    Args as in `press`, each load (T,) or (T, ...); the chain starts undeformed. Raises ValueError as `press` does.
    """
    steps = time.double().diff()
    if time.ndim != 1 or len(time) < 2 or not (steps > 0).all():
        raise ValueError(f"time {tuple(time.shape)} must be (T,), two or more, and rise at every step")
    down, along = _trace("load_n", load_n, len(time)), _trace("tangential_n", tangential_n, len(time))
    chains, state = _undeformed_chains(friction, parameters, elements, down[0], along[0])
    before, coefficient = _load(chains.shape, down[0], along[0]), _coefficient(friction, chains)
    states = [_pressed_chain(chains, state, coefficient, before)]
    for k, step in enumerate(steps.tolist(), 1):
        after = _load(chains.shape, down[k], along[k])
        loads = torch.stack((before, after), -2)
        state = advance_chains(chains, state, coefficient, loads, step, tolerance_m, 0.0)
        before = after
        states.append(_pressed_chain(chains, state, coefficient, after))
    return PressedChain(
        *(torch.stack([getattr(pressed, field.name) for pressed in states]) for field in fields(PressedChain))
    )


def _undeformed_chains(
    friction: Number, parameters: str | SkinParameters, elements: int, *loads: Number
) -> tuple[Chains, Motion]:
    """Return the skin chains of all parameter sets, to which friction, parameters and loads broadcast, and their
    initial, undeformed state.
    """
    if elements < 4:
        raise ValueError(f"{elements} elements: give 4 or more (the paper's chain has 501)")
    of = parameter_set(parameters)
    tensors = [torch.as_tensor(value) for value in (*loads, friction, *vars(of).values())]
    if requires_gradient(*tensors):
        raise ValueError("a press has no gradient: detach its friction, parameters and loads, and difference presses")
    chains = Chains.build(of, elements, torch.broadcast_shapes(*(value.shape for value in tensors)))
    return chains, chains.undeformed()


def _load(shape: torch.Size, down: Number, along: Number) -> Tensor:
    """Return the load (..., 2) on the bone along x and z, N, from the force `down` towards the plate and the force
    `along` it.
    """
    x, z = (torch.as_tensor(value, dtype=torch.float64).expand(shape) for value in (along, down))
    if not (x.isfinite().all() and z.isfinite().all()):
        raise ValueError("a load is not finite: cut the trace where forces are not known")
    return torch.stack((x, -z), -1)


def _trace(name: str, value: Number, count: int) -> Tensor:
    """Return a load, given as a number or as a trace over `count` times, as a trace (T, ...); `name` appears in the
    error message.
    """
    trace = torch.as_tensor(value, dtype=torch.float64)
    if trace.ndim and len(trace) != count:
        raise ValueError(f"{name} is {tuple(trace.shape)} beside {count} times: give a number, (T,) or (T, ...)")
    return trace if trace.ndim else trace.expand(count)


def _coefficient(friction: Number, chains: Chains) -> Tensor:
    """Check a friction coefficient, and return it for each element of all chains (..., N)."""
    coefficient = torch.as_tensor(friction, dtype=torch.float64)
    valid = (coefficient >= 0) & (coefficient < math.inf)
    if not valid.all():
        raise ValueError(f"friction {float(coefficient[~valid].flatten()[0])}: a coefficient is 0 or more")
    return coefficient[..., None].expand(*chains.shape, chains.reference.shape[-2])


def _pressed_chain(chains: Chains, at: Motion, coefficient: Tensor, load: Tensor) -> PressedChain:
    """Return the complete state of chains (forces, pressure, strain, divergence, contact, balance) for a state of
    motion `at`, friction coefficients (..., N), and a load (..., 2) on the bone, N.
    """
    x, z = at.position.unbind(-1)
    reference = chains.reference
    displacement = at.position - reference
    force = chains.contact[..., None] * (-z).clamp_min(0)
    touching = force > CONTACT_N
    (length,) = torch.gradient(x, dim=-1)
    area = torch.where(touching, length, 1.0) * chains.width[..., None]
    moved, spacing = torch.gradient(torch.stack((displacement[..., 0], reference[..., 0])), dim=-1)[0]
    slope = moved / spacing
    # Hoop strain u / x: the odd part of u about the axis, divided by the distance from it; on the axis it is the slope.
    across = reference[..., 0] - reference[..., 0].flip(-1)
    opposite = displacement[..., 0] - displacement[..., 0].flip(-1)
    middle = across == 0
    hoop = torch.where(middle, slope, opposite / torch.where(middle, 1.0, across))
    on_plate = _share_on_plate(force, touching) * x.diff(dim=-1)
    weight = (torch.nn.functional.pad(on_plate, (1, 0)) + torch.nn.functional.pad(on_plate, (0, 1))) / 2
    return PressedChain(
        position=at.position,
        displacement=displacement,
        normal_force=force,
        friction_force=-at.rubbed,
        pressure=force / area,
        traction=torch.where(touching, -at.rubbed / area, 0.0),
        coefficient=coefficient,
        strain=torch.where(touching, slope, torch.nan),
        divergence_field=torch.where(touching, slope + hoop, torch.nan),
        divergence=weighted_median(slope + hoop, weight),
        contact_length=on_plate.sum(-1),
        bone=at.bone,
        balance=chains.unbalanced(at, load),
        time=at.time,
        steps=at.steps,
    )


def _share_on_plate(force: Tensor, touching: Tensor) -> Tensor:
    """Return the fraction (..., N - 1), 0 to 1, of each link between neighbouring elements that lies on the plate, from
    each element's normal force and the mask `touching`, (..., N) both.

    Beyond the last touching element the forces of the last two elements are extrapolated to 0, so that the contact
    length has no jumps.
    """
    padded = torch.nn.functional.pad(force, (1, 1))
    before, here, after = padded[..., :-3], force[..., :-1], force[..., 1:]
    behind = padded[..., 3:]

    def beyond(last: Tensor, inside: Tensor) -> Tensor:
        falls = inside > last
        return torch.where(falls, last / torch.where(falls, inside - last, 1.0), 0.5).clamp(max=1)

    left, right = touching[..., :-1], touching[..., 1:]
    partial = torch.where(left, beyond(here, before), beyond(after, behind))
    return torch.where(left & right, 1.0, torch.where(left | right, partial, 0.0))


def weighted_median(values: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted median (...) over the last dimension, interpolated linearly; NaN if all weights are 0."""
    order = torch.where(weights > 0, values, torch.inf).argsort(-1)
    values, weights = values.gather(-1, order), weights.gather(-1, order)
    reached = (weights.cumsum(-1) - weights / 2) / weights.sum(-1, keepdim=True)
    after = (reached < 0.5).sum(-1, keepdim=True).clamp(1, values.shape[-1] - 1)
    low, high = reached.gather(-1, after - 1), reached.gather(-1, after)
    share = (0.5 - low) / torch.where(high > low, high - low, 1.0)
    first, second = values.gather(-1, after - 1), values.gather(-1, after)
    # With a single weighted value no value lies below or above it.
    share = torch.where(low > 0.5, 0.0, share.clamp(0, 1))
    return torch.where(weights.sum(-1) > 0, (first + share * (second - first))[..., 0], torch.nan)
