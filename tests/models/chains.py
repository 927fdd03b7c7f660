"""Helpers for tests of the parts of the skin model: a chain and its initial state."""

import numpy as np
import torch

from fingerflow.models.skin_forces import Array, Chain
from fingerflow.models.skin_implicit import Load, State
from fingerflow.models.skin_motion import Chains
from fingerflow.models.skin_parameters import parameter_set


def chain_of(elements: int = 41) -> Chain:
    return Chains.of(parameter_set("lab"), elements, torch.Size(())).single(0)


def nodes_of(chain: Chain) -> Array:
    """Return the nodes (N + 1, 2) of the undeformed chain."""
    return np.vstack((chain.reference, (0.0, 0.0)))


def begun(chain: Chain) -> State:
    return State(nodes_of(chain), np.zeros(len(chain.reference)))


def constant_load(newton: float, along: float = 0.0) -> Load:
    force = np.array([along, -newton])
    return Load(force, force)


def bent(chain: Chain, size: float = 3e-5) -> Array:
    """Return nodes (N + 1, 2) displaced at random, with some elements on the plate."""
    off = size * np.random.default_rng(0).standard_normal(chain.reference.shape) - np.array([0, 2e-4])
    return nodes_of(chain) + np.vstack((off, (2e-5, -2.3e-4)))


def energy(chain: Chain, nodes: Array) -> float:
    """Return the elastic energy (J) of links, tissue, nail and plate, as in the docstring of `skin_chain`."""
    place, bone = nodes[:-1], nodes[-1]
    moved = place - chain.reference - bone
    line = np.hypot(*(place - chain.centre - bone).T)
    parts = (
        chain.membrane * np.square(np.diff(moved, axis=0)).sum(),
        chain.tissue * np.square(line - chain.radius).sum(),
        chain.shear * np.square(moved).sum(),
        chain.nail * np.square(moved[[0, -1]]).sum(),
        chain.contact * np.square(np.minimum(place[:, 1], 0)).sum(),
    )
    return float(sum(parts)) / 2
