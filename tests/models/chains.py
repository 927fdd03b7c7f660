"""Helpers for tests of the parts of the skin model: a chain and its initial state."""

import numpy as np
import torch
from scipy.integrate import solve_ivp

from fingerflow.models.skin_forces import Array, Chain, Columns
from fingerflow.models.skin_implicit import State
from fingerflow.models.skin_motion import Chains
from fingerflow.models.skin_parameters import parameter_set


def chain_of(elements: int = 41, parameters: str = "lab") -> Chain:
    return Chains.build(parameter_set(parameters), elements, torch.Size(())).single(0)


def nodes_of(chain: Chain) -> Array:
    """Return the nodes (N + 1, 2) of the undeformed chain."""
    return np.vstack((chain.reference, (0.0, 0.0)))


def begun(chain: Chain) -> State:
    return State(nodes_of(chain), np.zeros(len(chain.reference)))


def constant_load(newton: float, along: float = 0.0) -> Array:
    force = np.array([along, -newton])
    return np.stack((force, force))


def bent(chain: Chain, size: float = 3e-5) -> Array:
    """Return nodes (N + 1, 2) displaced at random, with some elements on the plate."""
    off = size * np.random.default_rng(0).standard_normal(chain.reference.shape) - np.array([0, 2e-4])
    return nodes_of(chain) + np.vstack((off, (2e-5, -2.3e-4)))


def energy(chain: Chain, nodes: Array) -> float:
    """Return the elastic energy (J) of links, tissue, nail and plate, as in the docstring of `skin_chain`."""
    place, bone = nodes[:-1], nodes[-1]
    moved = place - chain.reference - bone
    compression = chain.radius - np.hypot(*(place - np.array([0.0, chain.radius]) - bone).T)
    grown, column = np.ones_like(compression), np.square(compression) / 2
    if chain.stiffening:
        relative = chain.stiffening * compression
        grown = np.where(relative > 0, np.exp(relative), 1.0)
        column = np.where(relative > 0, (grown - 1 - relative) / chain.stiffening**2, column)
    parts = (
        chain.membrane * np.square(np.diff(moved, axis=0)).sum(),
        2 * chain.tissue * column.sum(),
        chain.shear * (grown * np.square(moved).sum(1)).sum(),
        chain.nail * np.square(moved[[0, -1]]).sum(),
        chain.contact * np.square(np.minimum(place[:, 1], 0)).sum(),
    )
    return float(sum(parts)) / 2


def runge_kutta(chain: Chain, mu: Array, load: Array, duration: float) -> tuple[Array, Array]:
    """Return positions (N, 2) in m and friction (N,) in N of a chain after ``duration`` s under a load (2,) in N.

    Equation 5 has the forces of `skin_forces`; equation 7 is Dahl's friction.
    """
    count = len(mu)

    def unpacked(state: Array) -> tuple[Array, Array, Array]:
        nodes = state[: 2 * count + 2].reshape(-1, 2) + np.vstack((chain.reference, (0.0, 0.0)))
        limit = mu * chain.contact * np.maximum(-nodes[:-1, 1], 0)
        return nodes, limit, np.clip(state[2 * count + 2 :], -limit, limit)

    def rates(time: float, state: Array) -> Array:
        nodes, limit, held = unpacked(state)
        forces = Columns(chain, nodes).forces()
        forces[:-1, 0] -= held  # against the motion
        forces[-1] += load
        speed = forces / chain.dampers
        rubs = limit > 0
        left = 1 - np.sign(speed[:-1, 0]) * held / np.where(rubs, limit, 1.0)
        rate = chain.friction_stiffness * np.abs(left) ** chain.exponent * np.sign(left) * speed[:-1, 0]
        return np.concatenate((speed.ravel(), np.where(rubs, rate, 0.0)))

    # Positions to 0.1 nm and forces to 1e-7 N: both are small where skin hardly moves.
    absolute = np.concatenate((np.full(2 * count + 2, 1e-10), np.full(count, 1e-7)))
    end = solve_ivp(rates, (0.0, duration), np.zeros(3 * count + 2), rtol=1e-6, atol=absolute).y[:, -1]
    nodes, _, held = unpacked(end)
    return nodes[:-1], held
