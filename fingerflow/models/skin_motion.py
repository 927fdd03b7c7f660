"""Motion of many skin chains: compiled where available, else one after the other; with its adjoint."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.models.skin_adjoint import stiffness_gradients
from fingerflow.models.skin_forces import Chain, half_circle
from fingerflow.models.skin_implicit import MOST_STEPS, Load, State, advance, net_forces
from fingerflow.models.skin_parameters import SkinParameters

# Parameters of a chain, in the order of the fields of `Chain` after `reference` and of the compiled kernel.
NUMBERS = ("radius", "membrane", "tissue", "shear", "nail", "contact", "damping", "bone_damping", "spring", "exponent")
# Differentiable parameters; the others change the shape or the path to equilibrium.
STIFFNESSES = ("membrane", "tissue", "shear", "nail", "contact", "spring")
_FIRST_STEP = 1e-6  # s


@dataclass(frozen=True)
class Motion:
    """State of chains (..., N elements) and the time and steps that led to it; float64, SI units."""

    place: Tensor  # (..., N, 2)
    bone: Tensor  # (..., 2)
    rubbed: Tensor  # (..., N) friction force, positive where it opposes motion along +x
    step: Tensor  # (...) length of the next step
    time: Tensor  # (...) since the beginning
    steps: Tensor  # (...) int64


@dataclass(frozen=True)
class Chains:
    """Chains with one number of elements and parameters of one shape (...)."""

    shape: torch.Size
    reference: Tensor  # (..., N, 2)
    numbers: Tensor  # (..., 10) of NUMBERS
    width: Tensor  # (...)

    @staticmethod
    def of(skin: SkinParameters, count: int, shape: torch.Size) -> "Chains":
        """Return chains of ``count`` elements; nail and bone damping exist once and do not depend on ``count``.

        Raises:
            ValueError: radius, damping or friction_exponent requires a gradient.
        """
        parameters = skin.for_elements(count)

        def number(name: str) -> Tensor:
            return torch.as_tensor(getattr(parameters, name), dtype=torch.float64).expand(shape)

        radius, tissue = number("radius"), number("tissue_stiffness")
        if radius.requires_grad or number("damping").requires_grad or number("friction_exponent").requires_grad:
            raise ValueError(
                "radius, damping and friction_exponent have no derivative here: detach them, or difference presses"
            )
        shear = tissue / (2 * (1 + number("poisson_ratio")))
        nail, bone_damping = (
            torch.as_tensor(once, dtype=torch.float64).expand(shape) for once in (skin.membrane_stiffness, skin.damping)
        )
        springs = (number("membrane_stiffness"), tissue - shear, shear, nail, number("contact_stiffness"))
        dampers = (number("damping"), bone_damping)
        numbers = (radius, *springs, *dampers, number("friction_stiffness"), number("friction_exponent"))
        reference = radius.detach()[..., None, None] * torch.from_numpy(half_circle(count, 1.0))
        return Chains(shape, reference, torch.stack(numbers, -1), number("width"))

    def undeformed(self) -> Motion:
        none = torch.zeros(self.shape, dtype=torch.float64)
        rubbed = torch.zeros(self.reference.shape[:-1], dtype=torch.float64)
        bone = torch.zeros(*self.shape, 2, dtype=torch.float64)
        return Motion(
            self.reference, bone, rubbed, none + _FIRST_STEP, none, torch.zeros(self.shape, dtype=torch.int64)
        )

    def single(self, index: int) -> Chain:
        """Return the chain at a flat index."""
        count = self.reference.shape[-2]
        numbers = self.numbers.detach().reshape(-1, len(NUMBERS))[index].tolist()
        return Chain(self.reference.reshape(-1, count, 2)[index].numpy(), *numbers)

    def unbalanced(self, at: Motion, load: Tensor, held: tuple[bool, bool]) -> Tensor:
        """Return the sum of the absolute unbalanced forces (...) on elements and bone, N."""
        flat = _flat(at, load)
        sums = []
        for k in range(self.shape.numel()):
            state = _state(flat[0][k], flat[1][k], flat[2][k])
            parts = net_forces(self.single(k), state, flat[3][k].numpy(), np.array(held))
            sums.append(sum(float(np.abs(part).sum()) for part in parts))
        return torch.tensor(sums, dtype=torch.float64).reshape(self.shape)


def _state(place: Tensor, bone: Tensor, rubbed: Tensor, step: float = _FIRST_STEP) -> State:
    """Return the state of one chain, without velocity."""
    return State(place.detach().numpy(), bone.detach().numpy(), rubbed.detach().numpy(), step=step)


def stiffness_of(numbers: Tensor, name: str) -> Tensor:
    """Return one of `NUMBERS` (...) from parameter sets (..., 10)."""
    return numbers[..., NUMBERS.index(name)]


def moved(
    chains: Chains,
    start: Motion,
    coefficient: Tensor,
    loads: Tensor,
    held: tuple[bool, bool],
    duration: float,
    tolerance: float,
    rest: Tensor | float,
) -> Motion:
    """Advance by ``duration`` s under loads (..., 2, 2), first and last by x and z, or until balance to ``rest`` N."""
    rests = torch.as_tensor(rest, dtype=torch.float64).expand(chains.shape)
    wanted = chains.numbers.requires_grad or coefficient.requires_grad or start.place.requires_grad
    if torch.is_grad_enabled() and wanted:
        place, bone, rubbed, step, time, steps = _Moved.apply(  # type: ignore[no-untyped-call]
            coefficient, chains.numbers, start.place, start.bone, start.rubbed, chains, start, loads, held, duration,
            tolerance, rests,
        )  # fmt: skip
    else:
        place, bone, rubbed, step, time, steps, _ = _advanced(
            chains, start, coefficient, loads, held, duration, tolerance, rests, 0
        )
    return Motion(place, bone, rubbed, step, start.time + time, start.steps + steps)


def _advanced(
    chains: Chains,
    start: Motion,
    coefficient: Tensor,
    loads: Tensor,
    held: tuple[bool, bool],
    duration: float,
    tolerance: float,
    rest: Tensor,
    record_steps: int,
) -> tuple[Tensor, ...]:
    """Return position, bone, friction, next step, elapsed time, steps, and the record as in `kernels.press_skin`."""
    count, batch = chains.reference.shape[-2], chains.shape.numel()
    place, bone, rubbed, force = (part.detach().clone() for part in _flat(start, loads.flatten(-2)))
    step = start.step.reshape(batch).clone()
    mu = coefficient.detach().reshape(batch, count).contiguous()
    if kernels.serve(place, mu):
        time, counts, record = kernels.press_skin(
            chains.reference.reshape(batch, count, 2),
            chains.numbers.detach().reshape(batch, len(NUMBERS)),
            *(mu, force.reshape(batch, 2, 2), rest.reshape(batch), place, bone, rubbed, step),
            held=held,
            most_steps=MOST_STEPS,
            tolerance=tolerance,
            duration=duration,
            record_steps=record_steps,
        )
        steps = counts[:, 0]
        _complain(time, step, steps, counts, duration)
    else:
        time, steps = torch.zeros(batch, dtype=torch.float64), torch.zeros(batch, dtype=torch.int64)
        record = torch.zeros(batch, record_steps, 2 + 2 * (3 * count + 2), dtype=torch.float64)
        for k in range(batch):
            state = _state(place[k].clone(), bone[k].clone(), rubbed[k].clone(), float(step[k]))
            load = Load(force[k, :2].numpy(), force[k, 2:].numpy(), np.array(held))
            rows: list[np.ndarray[Any, Any]] | None = [] if record_steps else None
            time[k] = advance(
                chains.single(k), state, mu[k].numpy(), load, duration, tolerance, float(rest.reshape(-1)[k]), rows
            )
            place[k], bone[k], rubbed[k] = (torch.from_numpy(x) for x in (state.place, state.bone, state.friction))
            step[k], steps[k] = state.step, state.steps
            for row, values in enumerate(rows or []):
                record[k, row] = torch.from_numpy(values)
    shaped = (part.reshape((*chains.shape, *part.shape[1:])) for part in (place, bone, rubbed, step, time, steps))
    return (*shaped, record)


def _complain(time: Tensor, step: Tensor, steps: Tensor, counts: Tensor, duration: float) -> None:
    """Raise RuntimeError for a chain that did not reach the end, as `advance` does."""
    lost = (step < 1e-13) | (counts[:, :2].sum(-1) >= MOST_STEPS)
    if bool(lost.any()):
        k = int(lost.nonzero()[0])
        raise RuntimeError(
            f"the chain stands at {time[k].item():g} of {duration:g} s after {int(steps[k])} steps, the next one "
            f"{step[k].item():g} s: raise the tolerance, or lower load, friction or stiffness"
        )


def _flat(at: Motion, load: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return position (B, N, 2), bone (B, 2), friction (B, N) and load (B, ...)."""
    count = at.place.shape[-2]
    return (
        at.place.reshape(-1, count, 2).contiguous(),
        at.bone.reshape(-1, 2).contiguous(),
        at.rubbed.reshape(-1, count).contiguous(),
        load.reshape(-1, load.shape[-1]).contiguous(),
    )


class _Moved(torch.autograd.Function):
    """Differentiable `moved`: its adjoint goes back over recorded steps.

    One forward run counts the steps, a second one records them.
    """

    @staticmethod
    def forward(ctx: Any, *given: Any) -> tuple[Tensor, ...]:
        coefficient, numbers, place, bone, rubbed, chains, start, loads, held, duration, tolerance, rest = given
        ctx.chains = replace(chains, numbers=numbers.detach())
        ctx.start = replace(start, place=place.detach(), bone=bone.detach(), rubbed=rubbed.detach())
        ctx.held = held
        arguments = (ctx.chains, ctx.start, coefficient, loads, held, duration, tolerance, rest)
        *_, steps, _ = _advanced(*arguments, 0)
        *found, ctx.record = _advanced(*arguments, int(steps.max()))
        ctx.steps = steps
        ctx.coefficient = coefficient.detach()
        ctx.loads = loads
        ctx.mark_non_differentiable(*found[3:])
        return tuple(found)

    @staticmethod
    def backward(ctx: Any, *wanted: Any) -> tuple[Tensor | None, ...]:
        chains, start, count = ctx.chains, ctx.start, ctx.chains.reference.shape[-2]
        batch = chains.shape.numel()
        place, bone, rubbed, _ = _flat(start, ctx.loads.flatten(-2))
        of_place, of_bone, of_rubbed = (
            gradient.reshape((batch, *part.shape[1:]))
            for gradient, part in zip(wanted, (place, bone, rubbed), strict=False)
        )
        mu, steps = ctx.coefficient.reshape(batch, count), ctx.steps.reshape(batch)
        if kernels.serve(place):
            wanted_flat = torch.cat((of_place.flatten(1), of_bone, of_rubbed), 1)
            numbers = chains.numbers.reshape(batch, len(NUMBERS))
            stiffness, friction, begin = kernels.press_skin_back(
                chains.reference.reshape(batch, count, 2), numbers, mu, place, bone, rubbed, ctx.record, wanted_flat,
                steps, held=ctx.held,
            )  # fmt: skip
            places, bones, rubs = begin[:, : 2 * count], begin[:, 2 * count : 2 * count + 2], begin[:, 2 * count + 2 :]
        else:
            results = []
            for k in range(batch):
                back = stiffness_gradients(
                    chains.single(k),
                    mu[k].numpy(),
                    (place[k].numpy(), bone[k].numpy(), rubbed[k].numpy()),
                    np.array(ctx.held),
                    ctx.record[k, : int(steps[k])].numpy(),
                    (of_place[k].numpy(), of_bone[k].numpy(), of_rubbed[k].numpy()),
                )
                results.append([torch.from_numpy(part) for part in back])
            stiffness, friction, places, bones, rubs = (torch.stack(parts) for parts in zip(*results, strict=True))
        of_numbers = torch.zeros(batch, len(NUMBERS), dtype=torch.float64)
        of_numbers[:, [NUMBERS.index(name) for name in STIFFNESSES]] = stiffness
        shape = chains.shape
        return (
            friction.reshape(*shape, count),
            of_numbers.reshape(*shape, len(NUMBERS)),
            places.reshape(*shape, count, 2),
            bones.reshape(*shape, 2),
            rubs.reshape(*shape, count),
            *[None] * 7,
        )
