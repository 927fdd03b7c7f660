"""TR-BDF2 time integrator of one skin chain: a trapezoidal rule over 2 - sqrt 2 of each step, then a backward formula.

The second stage is the second-order backward differentiation formula (BDF2).

Both stages have the same matrix, damping I + c K with c = (1 - 1 / sqrt 2) step. The method is of second order and
damps stiff modes. Its error is estimated by Hosea & Shampine (1996), equation 6, and filtered by the same matrix, as
they advise for stiff systems. Contact that begins or ends is a kink. Newton's iteration steps across it and the error
estimate keeps the step short; locating the kink brings no gain.
"""

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.linalg.lapack import dgbtrf, dgbtrs

from fingerflow.models.friction import dahl_friction
from fingerflow.models.skin_forces import Array, Chain, Columns

GAMMA = 2 - np.sqrt(2.0)
C = GAMMA / 2  # weight of the unknown forces in both stages, as a share of the step
TO_LATER, TO_EARLIER = 1 / (GAMMA * (2 - GAMMA)), (1 - GAMMA) ** 2 / (GAMMA * (2 - GAMMA))
ERROR = 2 * (-3 * GAMMA**2 + 4 * GAMMA - 2) / (12 * (2 - GAMMA))
MOST_ITERATIONS = 12
NEWTON = 0.1  # convergence of Newton's iteration, as a share of the step's tolerance
MOST_STEPS = 100_000
SHORTEST_S = 1e-13  # s, shortest step: a shorter one will not meet the tolerance either


@dataclass
class State:
    """State of motion of one skin chain (positions, friction forces, velocities and time step), which `advance` changes
    in place.
    """

    nodes: Array  # (N + 1, 2) m, elements and bone as in `skin_forces`
    friction: Array  # (N,) N, friction force, positive where it opposes motion along +x
    velocity: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (N + 1, 2) m/s, velocity, set by `advance`
    step: float = 1e-6  # s, length of the next step
    steps: int = 0
    rejected: int = 0


class Arrow:
    """Arrow-shaped matrix D + c K of an implicit step of a skin chain, with damping D and stiffness K (the negative
    derivative of forces), factored on construction.

    Each element couples to its neighbours in 2 x 2 blocks, which makes a band of two diagonals on either side. The bone
    has dense rows and columns and is solved by a 2 x 2 Schur complement. Dahl's force is a function of the slide and no
    unknown.
    """

    def __init__(self, columns: Columns, along: Array, above: Array, c: float) -> None:
        chain, count = columns.chain, len(columns.moved)
        xx, xz, zz = (c * slope for slope in columns.slopes())
        link = c * chain.membrane
        links = np.full(count, chain.damping + 2 * link)
        links[[0, -1]] -= link
        band = np.zeros((7, 2 * count), order="F")  # as LAPACK has it: row 4 + i - j, column j
        band[2, 2:] = band[6, :-2] = -link
        band[4, ::2] = xx + links + c * along
        band[4, 1::2] = zz + links + c * chain.contact * (columns.depth > 0)
        band[3, 1::2] = xz + c * above
        band[5, ::2] = xz
        self._factors = dgbtrf(band, 2, 2, overwrite_ab=1)[:2]
        # Columns of the bone; its rows are their transpose, since the springs' matrices are symmetric.
        self._column = -np.stack((xx, xz, xz, zz), -1).reshape(2 * count, 2)
        self._solved_column = self._banded(self._column)
        bone = np.array([[xx.sum(), xz.sum()], [xz.sum(), zz.sum()]]) + chain.bone_damping * np.eye(2)
        self._bone = bone - self._column.T @ self._solved_column

    def solve(self, sides: Array) -> Array:
        """Solve the linear system of the matrix for a right-hand side (N + 1, 2); return the solution (N + 1, 2), for
        instance displacements of N elements and the bone.
        """
        elements = self._banded(sides[:-1].reshape(-1, 1))[:, 0]
        bone = np.linalg.solve(self._bone, sides[-1] - elements @ self._column)
        return np.concatenate((elements - self._solved_column @ bone, bone)).reshape(-1, 2)

    def _banded(self, sides: Array) -> Array:
        return dgbtrs(self._factors[0], 2, 2, sides, self._factors[1])[0]


def net_forces(chain: Chain, state: State, load: Array) -> Array:
    """Return the unbalanced forces (N + 1, 2), N, on elements and bone of a chain: the sum of elastic forces, friction
    and the load (2,) on the bone, which vanishes at equilibrium.
    """
    return Columns(chain, state.nodes).forces(state.friction, load)


def advance(
    chain: Chain, state: State, mu: Array, load: Array, duration: float, tolerance: float, rest: float
) -> float:
    """Advance the state of one chain in place by ``duration`` s, or until the absolute unbalanced forces sum to
    ``rest`` N; return the elapsed time (s).

    ``mu`` (N,) is each element's friction coefficient. ``load`` (2, 2) is the force, N, along x and z on the bone at
    the start and at the end of ``duration``; it changes linearly. ``tolerance`` (m) bounds the position error of one
    step. It ends early where the step length falls below 1e-13 s or 100,000 steps do not reach the end.
    """
    state.velocity = net_forces(chain, state, _interpolate_load(load, 0.0)) / chain.dampers
    time = 0.0
    for _ in range(MOST_STEPS):
        left = duration - time
        step = left if state.step > 0.99 * left else state.step
        error = _try_step(chain, state, mu, load, time / duration, step, duration, tolerance)
        growth = _step_factor(error)
        if growth < 1 or step == state.step:  # a last step that was cut short does not bound longer steps
            state.step = step * growth
        if error <= 1:
            time += step
            state.steps += 1
            if time >= duration * (1 - 1e-12):
                return duration
            if rest and np.abs(net_forces(chain, state, _interpolate_load(load, time / duration))).sum() <= rest:
                return time
        else:
            state.rejected += 1
        if state.step < SHORTEST_S:
            break
    return time


def _interpolate_load(load: Array, share: float) -> Array:
    return load[0] + share * (load[1] - load[0])


def _step_factor(error: float) -> float:
    """Return the factor by which to multiply the time step, given the error of the last step as a multiple of the
    tolerance.

    It is a power of 2^(1/4), from 2^(-7/4) to 2. The coarse grid keeps rounding in the error from changing the step
    lengths.
    """
    return float(2 ** (max(-7, min(4, math.floor(4 * math.log2(0.7 * min(max(error, 1e-9), 1e9) ** (-1 / 3))))) / 4))


def _try_step(
    chain: Chain, state: State, mu: Array, load: Array, begin: float, step: float, duration: float, tolerance: float
) -> float:
    """Try one time step of `step` s and keep the new state if its position error is within the tolerance, m; return the
    ratio of error to tolerance.

    The ratio is infinite if Newton's iteration fails.
    """
    c, share, start = C * step, step / duration, state.nodes

    solve = partial(_newton, chain, mu, c, tolerance)
    base = start + c * state.velocity
    later = _interpolate_load(load, begin + GAMMA * share)
    first = solve(state.friction, start, base, start + GAMMA * step * state.velocity, later)
    if first is None:
        return np.inf
    middle, rubbing, _ = first
    velocity = (middle - base) / c
    base = TO_LATER * middle - TO_EARLIER * start
    guess = middle + (1 - GAMMA) * step * velocity
    second = solve(rubbing, middle, base, guess, _interpolate_load(load, begin + share))
    if second is None:
        return np.inf
    end, last_rubbing, arrow = second
    last_velocity = (end - base) / c
    curved = state.velocity / GAMMA - velocity / (GAMMA * (1 - GAMMA)) + last_velocity / (1 - GAMMA)
    error = float(np.abs(arrow.solve(chain.dampers * (ERROR * step * curved))).max()) / tolerance
    if error <= 1:
        state.nodes, state.friction, state.velocity = end, last_rubbing, last_velocity
    return error if np.isfinite(error) else np.inf


def _newton(
    chain: Chain, mu: Array, c: float, tolerance: float,
    rubbed: Array, origin: Array, base: Array, guess: Array, load: Array,
) -> tuple[Array, Array, Arrow] | None:  # fmt: skip
    """Solve an implicit step, damping (X - base) = c forces(X), for the positions X (N + 1, 2) of elements and bone by
    Newton's method from a guess; return X, the friction forces (N,) and the last matrix.

    ``rubbed`` (N,) is the friction at ``origin``, the nodes from which the elements slide. Returns None if Newton's
    iteration does not converge.
    """
    steep, dampers, before, share = mu * chain.contact, chain.dampers, math.nan, 1.0

    def slid(nodes: Array) -> tuple[Array, Array, Array]:
        return dahl_friction(rubbed, origin[:-1], nodes[:-1], steep, chain.friction_stiffness, chain.exponent)

    nodes = guess
    for _ in range(MOST_ITERATIONS):
        rubbing, along, above = slid(nodes)
        columns = Columns(chain, nodes)
        arrow = Arrow(columns, along, above, c)
        moved = arrow.solve(dampers * (base - nodes) + c * columns.forces(rubbing, load))
        most = np.abs(moved).max()
        if not most < 1.0:  # m: the iteration diverges
            return None
        if before < 2 * most:  # to and fro across a kink, for which half the movement converges
            share = 0.5
        nodes = nodes + share * moved
        if most * min(1.0, max(most / before, 1 - share)) <= NEWTON * tolerance:  # what is left to move
            return nodes, slid(nodes)[0], arrow
        before = most
    return None
