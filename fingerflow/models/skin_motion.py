"""Integrate the motion of many skin chains in time, one after the other."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.models.skin_forces import Chain, half_circle
from fingerflow.models.skin_implicit import MOST_STEPS, SHORTEST_S, State, advance, net_forces
from fingerflow.models.skin_parameters import SkinParameters

# Names of a chain's parameters, in the order of `Chains.numbers`.
NUMBERS = Chain._fields[1:]
_FIRST_STEP = 1e-6  # s, length of the first time step


@dataclass(frozen=True)
class Motion:
    """State of motion of many chains (...) of N elements, with elapsed time and number of steps; float64, SI units."""

    position: Tensor  # (..., N, 2) m, positions of the elements
    bone: Tensor  # (..., 2) m, displacement of the bone
    rubbed: Tensor  # (..., N) N, friction force, positive where it opposes motion along +x
    step: Tensor  # (...) s, length of the next step
    time: Tensor  # (...) s since the beginning
    steps: Tensor  # (...) int64, number of time steps

    def single(self, index: int) -> State:
        """Return a copy of the state of one chain, selected by its flat index; the velocity is left out."""
        count = self.position.shape[-2]
        position, bone = self.position.reshape(-1, count, 2)[index], self.bone.reshape(-1, 1, 2)[index]
        rubbed = self.rubbed.reshape(-1, count)[index]
        return State(torch.cat((position, bone)).numpy(), rubbed.numpy(), step=float(self.step.reshape(-1)[index]))


@dataclass(frozen=True)
class Chains:
    """Mechanical parameters and undeformed positions of a batch (...) of skin chains with the same number N of
    elements.
    """

    shape: torch.Size
    reference: Tensor  # (..., N, 2) m, undeformed positions
    numbers: Tensor  # (..., 11) parameters named in NUMBERS
    width: Tensor  # (...) m, width across the chain

    @staticmethod
    def build(skin: SkinParameters, count: int, shape: torch.Size) -> "Chains":
        """Return a batch of chains of ``count`` elements each; the parameters of ``skin`` are broadcast to the batch
        shape ``shape``.
        """
        parameters = skin.for_elements(count)

        def number(name: str, of: SkinParameters = parameters) -> Tensor:
            return torch.as_tensor(getattr(of, name), dtype=torch.float64).expand(shape)

        radius, shear = number("radius"), number("shear_stiffness")
        nail, bone_damping = number("nail_stiffness"), number("damping", skin)
        pulp = number("tissue_stiffness") - shear, shear, number("stiffening")
        springs = (number("membrane_stiffness"), *pulp, nail, number("contact_stiffness"))
        dampers = (number("damping"), bone_damping)
        numbers = (radius, *springs, *dampers, number("friction_stiffness"), number("friction_exponent"))
        reference = radius[..., None, None] * torch.from_numpy(half_circle(count, 1.0))
        return Chains(shape, reference, torch.stack(numbers, -1), number("width"))

    @property
    def contact(self) -> Tensor:
        """Return the stiffness, N/m, with which the plate resists penetration by one element, for each chain (...)."""
        return self.numbers[..., NUMBERS.index("contact")]

    def undeformed(self) -> Motion:
        none = torch.zeros(self.shape, dtype=torch.float64)
        rubbed = torch.zeros(self.reference.shape[:-1], dtype=torch.float64)
        bone = torch.zeros(*self.shape, 2, dtype=torch.float64)
        return Motion(self.reference, bone, rubbed, none + _FIRST_STEP, none, none.long())

    def single(self, index: int) -> Chain:
        """Return the parameters of one chain, selected by its index in the flattened batch."""
        count = self.reference.shape[-2]
        numbers = self.numbers.reshape(-1, len(NUMBERS))[index].tolist()
        return Chain(self.reference.reshape(-1, count, 2)[index].numpy(), *numbers)

    def unbalanced(self, at: Motion, load: Tensor) -> Tensor:
        """Return the sum of absolute unbalanced forces on elements and bone for each chain (...), N."""
        loads = load.reshape(-1, 2).numpy()
        sums = [np.abs(net_forces(self.single(k), at.single(k), loads[k])).sum() for k in range(len(loads))]
        return torch.tensor(sums, dtype=torch.float64).reshape(self.shape)


def advance_chains(
    chains: Chains,
    start: Motion,
    coefficient: Tensor,
    loads: Tensor,
    duration: float,
    tolerance: float,
    rest: Tensor | float,
) -> Motion:
    """Advance all chains from a state of motion by ``duration`` s under linearly changing loads, or until the absolute
    unbalanced forces of a chain sum to ``rest`` N; return the new state.

    The loads (..., 2, 2) along x and z are those at the first and the last time.

    Raises:
        RuntimeError: the step length of a chain falls below 1e-13 s, or 100,000 steps do not reach the end.
    """
    batch = chains.shape.numel()
    mu, force = coefficient.reshape(batch, -1).numpy(), loads.reshape(batch, 2, 2).numpy()
    rests = torch.as_tensor(rest, dtype=torch.float64).expand(chains.shape).reshape(batch).tolist()
    ends, times = [], []
    for k in range(batch):
        state, load = start.single(k), force[k]
        time = advance(chains.single(k), state, mu[k], load, duration, tolerance, rests[k])
        if state.step < SHORTEST_S or state.steps + state.rejected >= MOST_STEPS:
            raise RuntimeError(
                f"the chain stands at {time:g} of {duration:g} s after {state.steps} steps, the next one "
                f"{state.step:g} s: raise the tolerance, or lower load, friction or stiffness"
            )
        ends.append(state)
        times.append(time)

    def batched(values: Iterable[Any], dtype: torch.dtype = torch.float64) -> Tensor:
        stacked = torch.from_numpy(np.array(list(values))).to(dtype)
        return stacked.reshape((*chains.shape, *stacked.shape[1:]))

    return Motion(
        position=batched(state.nodes[:-1] for state in ends),
        bone=batched(state.nodes[-1] for state in ends),
        rubbed=batched(state.friction for state in ends),
        step=batched(state.step for state in ends),
        time=start.time + batched(times),
        steps=start.steps + batched((state.steps for state in ends), torch.int64),
    )
