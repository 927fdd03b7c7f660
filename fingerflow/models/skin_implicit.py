"""TR-BDF2 integrator of one skin chain: trapezoidal rule to 2 - sqrt 2 of the step, then second-order backward formula.

Both stages have the same matrix, damping I + c K with c = (1 - 1 / sqrt 2) step. The method is of second order and
damps stiff modes. Its error is estimated by Hosea & Shampine (1996), equation 6, and filtered by the same matrix, as
they advise for stiff systems. Contact that begins or ends is a kink. Newton's iteration steps across it and the error
estimate keeps the step short; locating the kink brings no gain.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fingerflow.models.skin_forces import Array, Chain, elastic_forces, elastic_slopes, friction
from fingerflow.models.skin_solve import Arrow

GAMMA = 2 - np.sqrt(2.0)
C = GAMMA / 2  # of the step, in both stages
TO_LATER, TO_EARLIER = 1 / (GAMMA * (2 - GAMMA)), (1 - GAMMA) ** 2 / (GAMMA * (2 - GAMMA))
ERROR = 2 * (-3 * GAMMA**2 + 4 * GAMMA - 2) / (12 * (2 - GAMMA))
MOST_ITERATIONS = 12
NEWTON = 0.1  # convergence of Newton's iteration, as a share of the step's tolerance
MOST_STEPS = 100_000


@dataclass
class State:
    """State of one chain; changed in place."""

    place: Array  # (N, 2) m
    bone: Array  # (2,) m from its initial position
    friction: Array  # (N,) N, positive where it opposes motion along +x
    velocity: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (N, 2) m/s, set by `advance`
    bone_velocity: Array = field(default_factory=lambda: np.zeros(2))  # (2,) m/s
    step: float = 1e-6  # s, the next one
    steps: int = 0
    rejected: int = 0
    iterations: int = 0


@dataclass(frozen=True)
class Load:
    """Load on the bone over one interval, along x and z: forces in N, or displacements in m in a held direction."""

    first: Array  # (2,)
    last: Array  # (2,)
    held: NDArray[np.bool_]  # (2,)

    def at(self, share: float) -> Array:
        return self.first + share * (self.last - self.first)


def net_forces(chain: Chain, state: State, load: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the unbalanced forces (N) on elements (N, 2) and bone (2,); 0 in held directions of the bone."""
    forces, bone = elastic_forces(chain, state.place, state.bone)
    forces[:, 0] -= state.friction
    return forces, np.where(held, 0.0, bone + load)


def advance(
    chain: Chain,
    state: State,
    mu: Array,
    load: Load,
    duration: float,
    tolerance: float,
    rest: float,
    record: list[Array] | None = None,
) -> float:
    """Advance by ``duration`` s, or until forces balance to ``rest`` N; return the elapsed time (s).

    ``mu`` (N,) is each element's friction coefficient. ``tolerance`` (m) bounds the position error of one step. Each
    accepted step is appended to ``record``: time, length, then position, bone and friction of both stages.

    Raises:
        RuntimeError: the step length falls below 1e-13 s, or 100,000 steps do not reach the end.
    """
    forces, on_bone = net_forces(chain, state, load.at(0.0), load.held)
    rate = (load.last - load.first) / duration
    state.velocity = forces / chain.damping
    state.bone_velocity = np.where(load.held, rate, on_bone / chain.bone_damping)
    time = 0.0
    for _ in range(MOST_STEPS):
        left = duration - time
        step = left if state.step > 0.99 * left else state.step
        error, stages = _try(chain, state, mu, load, time / duration, step, duration, tolerance)
        growth = _growth(error)
        if growth < 1 or step == state.step:  # a last step cut short says nothing about longer ones
            state.step = step * growth
        if error <= 1:
            if record is not None:
                record.append(np.concatenate(((time, step), *(part.reshape(-1) for part in stages))))
            time += step
            state.steps += 1
            if time >= duration * (1 - 1e-12):
                return duration
            forces, on_bone = net_forces(chain, state, load.at(time / duration), load.held)
            if np.abs(forces).sum() + np.abs(on_bone).sum() <= rest:
                return time
        else:
            state.rejected += 1
        if state.step < 1e-13:
            break
    raise RuntimeError(
        f"the chain stands at {time:g} of {duration:g} s after {state.steps} steps, the next one {state.step:g} s: "
        "raise the tolerance, or lower load, friction or stiffness"
    )


def _growth(error: float) -> float:
    """Return the factor for the next step: powers of 2^(1/4), from 2^(-7/4) to 2.

    The coarse grid keeps rounding in the error from changing the step lengths.
    """
    return float(2 ** (max(-7, min(4, math.floor(4 * math.log2(0.7 * min(max(error, 1e-9), 1e9) ** (-1 / 3))))) / 4))


def _try(
    chain: Chain, state: State, mu: Array, load: Load, begin: float, step: float, duration: float, tolerance: float
) -> tuple[float, tuple[Array, ...]]:
    """Try one step and accept it if its error over the tolerance is at most 1; return that ratio and the stages.

    The ratio is infinite if Newton's iteration fails. The stages are position, bone and friction of both, empty if the
    step is rejected.
    """
    c, share = C * step, step / duration
    old, old_bone, held = state.place, state.bone, load.held
    rate = (load.last - load.first) / duration

    known = old + c * state.velocity
    known_bone = old_bone + c * state.bone_velocity
    guess = old + GAMMA * step * state.velocity, old_bone + GAMMA * step * state.bone_velocity
    first = _newton(chain, state, mu, state.friction, old, known, known_bone, guess, load.at(begin + GAMMA * share),
                    held, c, tolerance)  # fmt: skip
    if first is None:
        return np.inf, ()
    place, bone, rubbing, _ = first
    velocity = (place - known) / c
    bone_velocity = np.where(held, rate, (bone - known_bone) / c)

    known = TO_LATER * place - TO_EARLIER * old
    known_bone = TO_LATER * bone - TO_EARLIER * old_bone
    guess = place + (1 - GAMMA) * step * velocity, bone + (1 - GAMMA) * step * bone_velocity
    second = _newton(chain, state, mu, rubbing, place, known, known_bone, guess, load.at(begin + share), held, c,
                     tolerance)  # fmt: skip
    if second is None:
        return np.inf, ()
    last, last_bone, last_rubbing, arrow = second
    last_velocity = (last - known) / c
    last_bone_velocity = np.where(held, rate, (last_bone - known_bone) / c)

    def estimate(start: Array, middle: Array, end: Array) -> Array:
        return np.asarray(ERROR * step * (start / GAMMA - middle / (GAMMA * (1 - GAMMA)) + end / (1 - GAMMA)))

    of_elements = chain.damping * estimate(state.velocity, velocity, last_velocity)
    of_bone = np.where(held, 0.0, chain.bone_damping * estimate(state.bone_velocity, bone_velocity, last_bone_velocity))
    wrong, wrong_bone = arrow.solve(of_elements, of_bone)
    error = float(max(np.abs(wrong).max(), np.abs(wrong_bone).max())) / tolerance
    if not error <= 1:
        return (error if np.isfinite(error) else np.inf), ()
    state.place, state.bone, state.friction = last, last_bone, last_rubbing
    state.velocity, state.bone_velocity = last_velocity, last_bone_velocity
    return error, (place, bone, rubbing, last, last_bone, last_rubbing)


def _newton(
    chain: Chain,
    state: State,
    mu: Array,
    rubbing_before: Array,
    slid_from: Array,
    known: Array,
    known_bone: Array,
    guess: tuple[Array, Array],
    load: Array,
    held: NDArray[np.bool_],
    c: float,
    tolerance: float,
) -> tuple[Array, Array, Array, Arrow] | None:
    """Solve damping (X - known) = c forces(X) for position, bone and friction, and return the last matrix with them.

    Returns None if Newton's iteration does not converge.
    """
    place, bone = guess
    for _ in range(MOST_ITERATIONS):
        state.iterations += 1
        forces, on_bone = elastic_forces(chain, place, bone)
        rubbing = friction(chain, mu, rubbing_before, slid_from, place)
        forces[:, 0] -= rubbing.force
        arrow = Arrow(chain, elastic_slopes(chain, place, bone), rubbing, c, held)
        bone_side = chain.bone_damping * (known_bone - bone) + c * (on_bone + load)
        moved, bone_moved = arrow.solve(
            chain.damping * (known - place) + c * forces, np.where(held, load - bone, bone_side)
        )
        place, bone = place + moved, bone + bone_moved
        most = max(np.abs(moved).max(), np.abs(bone_moved).max())
        if not most < 1.0:  # m
            return None
        if most <= NEWTON * tolerance:
            return place, bone, friction(chain, mu, rubbing_before, slid_from, place).force, arrow
    return None
