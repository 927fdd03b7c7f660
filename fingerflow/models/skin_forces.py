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
    def dampers(self) -> Array:
        """Return the damping coefficients (N + 1, 1) of N elements and the bone, N s/m."""
        dampers = np.full((len(self.reference) + 1, 1), self.damping)
        dampers[-1] = self.bone_damping
        return dampers


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
    x, z, across, down = _lines(chain, nodes)
    pull_x, pull_z = chain.membrane * np.diff(x), chain.membrane * np.diff(z)
    tight = chain.tissue * (1 - chain.radius / np.hypot(across, down))
    bone = nodes[-1]
    held_x, held_z = tight * across + chain.shear * (x - bone[0]), tight * down + chain.shear * (z - bone[1])
    for end in (0, -1):
        held_x[end] += chain.nail * (x[end] - bone[0])
        held_z[end] += chain.nail * (z[end] - bone[1])
    forces = np.empty_like(nodes)
    forces[:-1, 0], forces[:-1, 1] = -held_x, chain.contact * np.maximum(-nodes[:-1, 1], 0) - held_z
    forces[:-2, 0] += pull_x
    forces[1:-1, 0] -= pull_x
    forces[:-2, 1] += pull_z
    forces[1:-1, 1] -= pull_z
    forces[-1] = held_x.sum(), held_z.sum()
    return forces


def tissue_slopes(chain: Chain, nodes: Array) -> tuple[Array, Array, Array]:
    """Compute the stiffnesses, N/m, of the springs (tissue, shear and nail) between each of N elements and the bone, at
    positions `nodes` (N + 1, 2), m: the entries xx, xz and zz, (N,) each, of a symmetric 2 x 2 matrix.
    """
    _, _, across, down = _lines(chain, nodes)
    along = np.hypot(across, down)
    ratio = chain.radius / along
    turned, plain = chain.tissue * ratio / along**2, chain.tissue * (1 - ratio) + chain.shear
    plain[[0, -1]] += chain.nail
    return turned * across**2 + plain, turned * across * down, turned * down**2 + plain


def _lines(chain: Chain, nodes: Array) -> tuple[Array, Array, Array, Array]:
    """Return the displacement of N elements along x and z, and the lines along x and z from the bone's point in the
    centre to them, (N,) m each.
    """
    (x, z), (first_x, first_z), bone = nodes[:-1].T, chain.reference.T, nodes[-1]
    return x - first_x, z - first_z, x - bone[0], z - (chain.radius + bone[1])
