"""Energy of one skin chain, its forces and their derivatives; `skin_chain` has the derivation."""

from dataclasses import dataclass
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


@dataclass
class Slopes:
    """Negative derivatives of the elastic forces, from which `skin_solve` assembles its matrix."""

    link: float  # of a link between its elements, in every direction
    tissue: Array  # (N, 2, 2) between an element and the bone
    touching: Array  # (N,) of the plate on z


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


def energy(chain: Chain, place: Array, bone: Array) -> float:
    """Compute the elastic energy (J) of links, tissue, nail and plate."""
    moved = place - chain.reference - bone
    line = np.hypot(*(place - chain.centre - bone).T)
    nail = moved[[0, -1]]
    return (
        float(
            chain.membrane * np.square(np.diff(moved, axis=0)).sum()
            + chain.tissue * np.square(line - chain.radius).sum()
            + chain.shear * np.square(moved).sum()
            + chain.nail * np.square(nail).sum()
            + chain.contact * np.square(np.minimum(place[:, 1], 0)).sum()
        )
        / 2
    )


def elastic_forces(chain: Chain, place: Array, bone: Array) -> tuple[Array, Array]:
    """Compute the forces (N, 2) on the elements and (2,) on the bone: the negative gradient of `energy`."""
    pull = chain.membrane * np.diff(place - chain.reference, axis=0)
    line = place - chain.centre - bone
    along = np.hypot(*line.T)
    held = (chain.tissue * (1 - chain.radius / along))[:, None] * line + chain.shear * (place - chain.reference - bone)
    for end in (0, -1):
        held[end] += chain.nail * (place[end] - chain.reference[end] - bone)
    forces = -held
    forces[:-1] += pull
    forces[1:] -= pull
    forces[:, 1] += chain.contact * np.maximum(-place[:, 1], 0)
    return forces, held.sum(0)


def elastic_slopes(chain: Chain, place: Array, bone: Array) -> Slopes:
    """Compute the negative derivatives of `elastic_forces`."""
    line = place - chain.centre - bone
    along = np.hypot(*line.T)
    direction, ratio = line / along[:, None], chain.radius / along
    turned = (chain.tissue * ratio)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    tissue = turned + (chain.tissue * (1 - ratio) + chain.shear)[:, None, None] * np.eye(2)
    tissue[[0, -1]] += chain.nail * np.eye(2)
    return Slopes(chain.membrane, tissue, np.where(place[:, 1] < 0, chain.contact, 0.0))


class Friction(NamedTuple):
    """Dahl's force (N,) after a slide, and its derivatives.

    The derivative with respect to the along-plate position it slid from is minus `along`.
    """

    force: Array
    along: Array  # by the position along the plate
    above: Array  # by the height above it
    before: Array  # by the force before
    from_above: Array  # by the height it slid from
    steep: Array  # by mu k_c
    spring: Array  # by sigma_0


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
        before=np.where(still | cut, 0.0, rest),
        from_above=np.where((old[:, 1] < 0) & active & ~over, -of_limit * steep / 2, 0.0),
        steep=np.where(active, np.where(over, end_sign * deep, of_limit * (deep + was_deep) / 2), 0.0),
        spring=np.where(still, 0.0, left**n * rest * slid),
    )
