"""Forces in one skin chain and their derivatives, as derived in `skin_chain`.

Nodes (N + 1, 2) are the positions of the N elements and, in the last row, the displacement of the bone, all in m.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """Mechanical parameters of one skin chain (N elements around a bone): stiffnesses, damping and friction, and its
    undeformed shape.
    """

    reference: Array  # (N, 2) m, undeformed positions: x along the plate and z above it
    radius: float
    membrane: float  # N/m, stiffness of a link between neighbours, in every direction
    tissue: float  # N/m, stiffness along the line to the bone, k_t - k_s: without the isotropic part `shear`
    shear: float  # N/m, isotropic stiffness between element and bone
    nail: float  # N/m, stiffness of the links at both ends, in every direction
    contact: float  # N/m, stiffness of the plate
    damping: float  # N s/m, damping of an element
    bone_damping: float  # N s/m, damping of the bone
    friction_stiffness: float  # N/m, sigma_0 of Dahl's model
    exponent: float

    @property
    def centre(self) -> Array:
        """Return the centre (2,) m of the undeformed half-circle, where the lines of all tissue springs meet."""
        return np.array([0.0, self.radius])

    @property
    def dampers(self) -> Array:
        """Return the damping coefficients (N + 1, 1) of N elements and the bone, N s/m."""
        return np.array([self.damping] * len(self.reference) + [self.bone_damping])[:, None]


def half_circle(count: int, radius: float) -> Array:
    """Return positions (N, 2), x and z, of N = `count` elements evenly spaced on a half-circle of a given radius,
    exactly mirror-symmetric, whose lowest point touches the plate at z = 0.
    """
    right = (
        np.linspace(0, np.pi / 2, count // 2 + 1)[1:]
        if count % 2
        else (np.arange(count // 2) + 0.5) * np.pi / (count - 1)
    )
    x, z = radius * np.sin(right), 2 * radius * np.sin(right / 2) ** 2
    middle = [0.0] if count % 2 else []
    return np.stack((np.concatenate((-x[::-1], middle, x)), np.concatenate((z[::-1], middle, z))), 1)


def elastic_forces(chain: Chain, nodes: Array) -> Array:
    """Compute the elastic forces (N + 1, 2), N, on elements and bone of a chain at positions `nodes` (N + 1, 2), m: the
    negative gradient of the elastic energy.
    """
    place, bone = nodes[:-1], nodes[-1]
    pull = chain.membrane * np.diff(place - chain.reference, axis=0)
    moved, line = place - chain.reference - bone, place - chain.centre - bone
    held = (chain.tissue * (1 - chain.radius / np.hypot(*line.T)))[:, None] * line + chain.shear * moved
    held[[0, -1]] += chain.nail * moved[[0, -1]]
    forces = -held
    forces[:-1] += pull
    forces[1:] -= pull
    forces[:, 1] += chain.contact * np.maximum(-place[:, 1], 0)
    return np.concatenate((forces, held.sum(0)[None]))


def tissue_slopes(chain: Chain, nodes: Array) -> Array:
    """Compute the stiffness matrices (N, 2, 2), N/m, of the springs (tissue, shear and nail) between each of N elements
    and the bone, at positions `nodes` (N + 1, 2), m.
    """
    line = nodes[:-1] - chain.centre - nodes[-1]
    along = np.hypot(*line.T)
    direction, ratio = line / along[:, None], chain.radius / along
    turned = (chain.tissue * ratio)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    tissue = turned + (chain.tissue * (1 - ratio) + chain.shear)[:, None, None] * np.eye(2)
    tissue[[0, -1]] += chain.nail * np.eye(2)
    return np.asarray(tissue)
