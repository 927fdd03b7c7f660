"""Forces in one skin chain and their derivatives, as derived in `skin_chain`.

Nodes (N + 1, 2) are the positions of the N elements and, in the last row, the displacement of the bone, all in m.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import exprel

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
    stiffening: float  # 1/m, exponential rate at which both grow with the compression of a column, 1 / c_0
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


class Columns:
    """State of the columns of tissue between the N elements of a chain at positions `nodes` (N + 1, 2), m, and the
    bone: geometry, stiffness and force.

    With c = R - |X - P|, d = u - U and the unit vector e along X - P, the energy of a column is W(c) + 1/2 k |d|^2,
    k = k_s exp(c / c_0). It pushes the element along e by W' + k |d|^2 / (2 c_0) and across by -k d.
    """

    def __init__(self, chain: Chain, nodes: Array) -> None:
        self.chain, self.moved, self.depth = chain, nodes[:-1] - chain.reference, np.maximum(-nodes[:-1, 1], 0)
        self.sheared = (self.moved - nodes[-1]).T  # (2, N) m, d
        line = (nodes[:-1] - nodes[-1] - (0.0, chain.radius)).T
        self.length = np.hypot(*line)  # (N,) m, |X - P|
        self.line = line / self.length  # (2, N), e
        compression = chain.radius - self.length
        self.stiffening = chain.stiffening * (compression > 0)  # (N,) 1/m; a stretched column is linear
        relative = self.stiffening * compression
        grown = np.exp(relative)
        self.shear = chain.shear * grown  # (N,) N/m, k
        bulge = self.shear * self.stiffening * (self.sheared[0] ** 2 + self.sheared[1] ** 2) / 2
        # exprel(x) = (exp(x) - 1) / x is 1 at 0: without stiffening W' = (k_t - k_s) c.
        self.push = chain.tissue * compression * exprel(relative) + bulge  # (N,) N
        self.slope = chain.tissue * grown + self.stiffening * bulge  # (N,) N/m, -d push / d length

    def forces(self, friction: Array | float = 0.0, load: Array | float = 0.0) -> Array:
        """Compute the forces (N + 1, 2), N, on elements and bone: the negative gradient of the elastic energy, less
        the `friction` (N,) of each element along x, and the `load` (2,) on the bone.
        """
        chain, count = self.chain, len(self.moved)
        pull = chain.membrane * (self.moved[1:] - self.moved[:-1])
        held = self.shear * self.sheared - self.push * self.line
        held[:, :: count - 1] += chain.nail * self.sheared[:, :: count - 1]
        forces = np.empty((count + 1, 2))
        forces[:-1] = -held.T
        forces[:-1, 1] += chain.contact * self.depth
        forces[:-2] += pull
        forces[1:-1] -= pull
        forces[:-1, 0] -= friction
        forces[-1] = held.sum(1) + load
        return forces

    def slopes(self) -> tuple[Array, Array, Array]:
        """Compute the stiffnesses, N/m, of the springs (tissue, shear and nail) between each element and the bone: the
        entries xx, xz and zz, (N,) each, of a symmetric 2 x 2 matrix.
        """
        (along_x, along_z), (shear_x, shear_z) = self.line, self.sheared
        pushed, twice = self.push / self.length, self.shear * self.stiffening
        turned, plain = self.slope + pushed, self.shear - pushed
        plain[:: len(plain) - 1] += self.chain.nail
        return (
            turned * along_x**2 - 2 * twice * along_x * shear_x + plain,
            turned * along_x * along_z - twice * (along_x * shear_z + along_z * shear_x),
            turned * along_z**2 - 2 * twice * along_z * shear_z + plain,
        )
