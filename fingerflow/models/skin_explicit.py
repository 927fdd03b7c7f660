"""The published integrator: explicit fourth-order Runge-Kutta, with its actual stability limit on the step.

The paper's equation 6 shows explicit Euler, and its first line subtracts the load that equation 5 adds. The text states
fourth-order Runge-Kutta at 2.5 us. Its bound by a wave speed of 440 m/s cannot hold: 501 elements are 50 um apart, and
no wave travels in a chain without mass. Relaxation bounds the step: with lambda the largest rate, step * lambda must
stay below 2.785. That is the rate of the bone, which all tissue pulls on: 1.12e6 1/s with the lab's parameters. So
2.5 us are too long and 2.48 us are not.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from fingerflow.models.skin_forces import Array, Chain, Friction, elastic_forces, elastic_slopes
from fingerflow.models.skin_implicit import Load, State
from fingerflow.models.skin_solve import Arrow

REAL_LIMIT = 2.785293563405282  # of step * rate, for any four-stage Runge-Kutta method of order 4


def march(chain: Chain, state: State, mu: Array, load: Load, duration: float, step: float) -> None:
    """Advance by ``duration`` s in equal steps of at most ``step`` s; changes the state in place.

    Raises:
        ValueError: a step over `largest_step`, or a prescribed motion of the bone.
    """
    most = largest_step(chain)
    if not 0 < step <= most:
        raise ValueError(
            f"a step of {step:g} s: Runge-Kutta is stable up to {most:.4g} s with these parameters (largest rate "
            f"{REAL_LIMIT / most:.4g} 1/s); beyond it results are wrong and look finite; take less, or use press"
        )
    if load.held.any():
        raise ValueError("motions of the bone are not given here: use press or follow")
    count = math.ceil(duration / step * (1 - 1e-12))
    h = duration / count
    at = ChainState(state.place, state.bone, state.friction)
    for k in range(count):
        first = rates(chain, mu, at, load.at(k / count))
        second = rates(chain, mu, _after(at, h / 2, first), load.at((k + 0.5) / count))
        third = rates(chain, mu, _after(at, h / 2, second), load.at((k + 0.5) / count))
        fourth = rates(chain, mu, _after(at, h, third), load.at((k + 1) / count))
        mean = ChainState(
            *((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(first, second, third, fourth, strict=True))
        )
        at = _after(at, h, mean)
        limit = mu * chain.contact * np.maximum(-at.place[:, 1], 0)
        at = at._replace(friction=np.clip(at.friction, -limit, limit))
        state.steps += 1
    state.place, state.bone, state.friction = at


def largest_step(chain: Chain) -> float:
    """Return the largest stable step (s): 2.785 over the largest rate.

    The rate is that of the undeformed chain with every element on the plate and in friction. Contact and friction only
    add stiffness, so other states have no larger rate except through changes of length.
    """
    count = len(chain.reference)
    slopes = elastic_slopes(chain, chain.reference, np.zeros(2))
    slopes.touching = np.full(count, chain.contact)
    steep = np.full(count, chain.friction_stiffness * 2**chain.exponent)  # largest slope: on reversal at the limit
    arrow = Arrow(chain, slopes, Friction(steep, steep, *np.zeros((5, count))), 1.0, np.zeros(2, dtype=bool))
    roots = np.sqrt(np.concatenate((np.full(2 * count, chain.damping), np.full(2, chain.bone_damping))))

    def scaled(vector: Array) -> Array:
        vector = vector.ravel() / roots
        elements, bone = arrow.times(vector[:-2].reshape(-1, 2), vector[-2:])
        return np.asarray(np.concatenate((elements.ravel(), bone)) / roots)  # of damping + K

    size = 2 * count + 2
    operator = LinearOperator((size, size), matvec=scaled, dtype=np.float64)
    start = np.cos(np.arange(size)) + 2  # arbitrary but fixed, for reproducible results
    largest = float(eigsh(operator, k=1, which="LA", return_eigenvectors=False, v0=start)[0]) - 1.0
    return REAL_LIMIT / largest


class ChainState(NamedTuple):
    """State of a chain, or its rates of change."""

    place: Array  # (N, 2) m
    bone: Array  # (2,) m
    friction: Array  # (N,) N


def _after(at: ChainState, h: float, speeds: ChainState) -> ChainState:
    return ChainState(*(value + h * rate for value, rate in zip(at, speeds, strict=True)))


def rates(chain: Chain, mu: Array, at: ChainState, load: Array) -> ChainState:
    """Compute the rates of equation 5, with forces from the energy, and of equation 7 without its stray factor."""
    forces, on_bone = elastic_forces(chain, at.place, at.bone)
    limit = mu * chain.contact * np.maximum(-at.place[:, 1], 0)
    held = np.clip(at.friction, -limit, limit)
    forces[:, 0] -= held  # against the motion
    speed = forces / chain.damping
    rubs = limit > 0
    left = 1 - np.sign(speed[:, 0]) * held / np.where(rubs, limit, 1.0)
    rate = chain.friction_stiffness * np.abs(left) ** chain.exponent * np.sign(left) * speed[:, 0]
    return ChainState(speed, (on_bone + load) / chain.bone_damping, np.where(rubs, rate, 0.0))
