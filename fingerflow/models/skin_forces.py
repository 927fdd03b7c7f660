"""Forces of one skin chain and their derivatives; `skin_chain` has the derivation.

Nodes (N + 1, 2) are the positions of the N elements and, in the last row, the displacement of the bone, all in m.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """One undeformed chain of N elements with its parameters."""

    reference: Array  # (N, 2) x along the plate and z above it, m
    radius: float
    membrane: float  # N/m of a link, in every direction
    tissue: float  # N/m along the line to the bone, k_t - k_s: without the isotropic part `shear`
    shear: float  # N/m in every direction
    nail: float  # N/m at both ends, in every direction
    contact: float  # N/m
    damping: float  # N s/m of an element
    bone_damping: float  # N s/m
    friction_stiffness: float  # N/m
    exponent: float

    @property
    def centre(self) -> Array:
        """Return the centre of the half-circle, where the tissue's lines meet."""
        return np.array([0.0, self.radius])

    @property
    def dampers(self) -> Array:
        """Return the damping (N + 1, 1) of each node, N s/m."""
        return np.array([self.damping] * len(self.reference) + [self.bone_damping])[:, None]


def half_circle(count: int, radius: float) -> Array:
    """Return the half-circle (N, 2), exactly mirror-symmetric, its lowest point on the plate."""
    right = (
        np.linspace(0, np.pi / 2, count // 2 + 1)[1:]
        if count % 2
        else (np.arange(count // 2) + 0.5) * np.pi / (count - 1)
    )
    x, z = radius * np.sin(right), 2 * radius * np.sin(right / 2) ** 2
    middle = [0.0] if count % 2 else []
    return np.stack((np.concatenate((-x[::-1], middle, x)), np.concatenate((z[::-1], middle, z))), 1)


def elastic_forces(chain: Chain, nodes: Array) -> Array:
    """Compute the forces (N + 1, 2) on the nodes: the negative gradient of the energy of links, tissue, nail, plate."""
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
    """Compute the stiffness (N, 2, 2) of tissue, shear and nail between each element and the bone."""
    line = nodes[:-1] - chain.centre - nodes[-1]
    along = np.hypot(*line.T)
    direction, ratio = line / along[:, None], chain.radius / along
    turned = (chain.tissue * ratio)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    tissue = turned + (chain.tissue * (1 - ratio) + chain.shear)[:, None, None] * np.eye(2)
    tissue[[0, -1]] += chain.nail * np.eye(2)
    return np.asarray(tissue)


class Friction(NamedTuple):
    """Dahl's force (N,) after a slide, and its derivatives by the position along the plate and above it."""

    force: Array
    along: Array
    above: Array


def friction(chain: Chain, mu: Array, before: Array, old: Array, place: Array) -> Friction:
    """Compute Dahl's force after a slide from ``old`` to ``place``, both (N, 2), and its derivatives.

    `friction.dahl_step` is taken at the mean of the limits before and after, which makes the error of a changing limit
    third order. The result is clamped to the last limit, so the force never exceeds it.
    """
    steep, deep, was_deep = mu * chain.contact, np.maximum(-place[:, 1], 0), np.maximum(-old[:, 1], 0)
    last = steep * deep
    middle = (last + steep * was_deep) / 2
    slid = place[:, 0] - old[:, 0]
    active = (middle > 0) & (place[:, 1] < 0)
    limit = np.where(active, middle, 1.0)
    sign = np.where(slid < 0, -1.0, 1.0)
    n, power = chain.exponent, 1 - chain.exponent
    held = np.clip(before, -limit, limit)
    cut = held != before
    left = 1 - sign * held / limit
    done = left <= 0
    left = np.where(done, 1.0, left)
    distance = chain.friction_stiffness * np.abs(slid) / limit * left ** (n - 1)
    if power == 0:
        kept, rest = np.exp(-distance), np.exp(-distance)
    else:
        base = np.maximum(1 - power * distance, 0)
        kept = base ** (1 / power)  # u / u_0
        rest = np.where(base > 0, base ** (n / power), 0.0)  # -d(u / u_0) / d distance = (u / u_0)^n
    after = np.where(done, sign * limit, held + sign * limit * left * (1 - kept))
    along = chain.friction_stiffness * left**n * rest
    # u^(1-n) = u_0^(1-n) - (1-n) sigma_0 d / F: a change of the limit changes u_0 and the scaled distance.
    of_left = np.where(cut, 0.0, sign * held / limit**2)
    of_limit = np.where(
        done, sign, sign * (1 - left * kept) - sign * limit * (rest * of_left + left * rest * distance / limit)
    )
    over = np.abs(after) > last
    still = done | over | ~active
    end_sign = np.where(after < 0, -1.0, 1.0)
    return Friction(
        force=np.where(active, np.clip(after, -last, last), 0.0),
        along=np.where(still, 0.0, along),
        above=np.where(active, np.where(over, -end_sign * steep, -of_limit * steep / 2), 0.0),
    )
