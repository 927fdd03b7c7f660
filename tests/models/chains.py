"""One chain and its beginning, for tests of the parts of the skin model."""

import numpy as np
import torch

from fingerflow.models.skin_forces import Array, Chain
from fingerflow.models.skin_implicit import Load, State
from fingerflow.models.skin_motion import Chains
from fingerflow.models.skin_parameters import named


def chain_of(parameters: str = "lab", elements: int = 41) -> Chain:
    return Chains.of(named(parameters), elements, torch.Size(())).single(0)


def begun(chain: Chain) -> State:
    count = len(chain.reference)
    return State(chain.reference.copy(), np.zeros(2), np.zeros(count), np.zeros((count, 2)), np.zeros(2))


def held_load(newton: float, along: float = 0.0) -> Load:
    force = np.array([along, -newton])
    return Load(force, force, np.zeros(2, dtype=bool))


def bent(chain: Chain, seed: int = 0, size: float = 3e-5) -> tuple[Array, Array]:
    """A place and a bone that are anywhere, with some elements on the plate."""
    random = np.random.default_rng(seed)
    return (
        chain.reference + size * random.standard_normal(chain.reference.shape) - np.array([0, 2e-4]),
        np.array([2e-5, -2.3e-4]),
    )
