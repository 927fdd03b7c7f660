"""Energy of one skin chain, its forces and their slopes; the derivation stands in `skin_chain`."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """One chain of N elements as it is undeformed, with its numbers."""

    reference: Array  # (N, 2) x along the plate and z above it, m
    radius: float
    membrane: float  # N/m of a link, in every direction
    tissue: float  # N/m along the line to the bone, without what it resists in every direction
    shear: float  # N/m in every direction
    nail: float  # N/m at both ends, in every direction
    contact: float  # N/m
    damping: float  # N s/m of an element
    bone_damping: float  # N s/m
    friction_stiffness: float  # N/m
    exponent: float

    @property
    def centre(self) -> Array:
        """Of the half-circle: where the tissue's lines meet."""
        return np.array([0.0, self.radius])


@dataclass
class Slopes:
    """Negative derivatives of the elastic forces: what `skin_solve` puts together."""

    link: float  # of a link between its elements, in every direction
    tissue: Array  # (N, 2, 2) between an element and the bone
    touching: Array  # (N,) of the plate on z


def half_circle(count: int, radius: float) -> Array:
    """(N, 2), mirrored to the last bit, its lowest point on the plate."""
    right = (
        np.linspace(0, np.pi / 2, count // 2 + 1)[1:]
        if count % 2
        else (np.arange(count // 2) + 0.5) * np.pi / (count - 1)
    )
    x, z = radius * np.sin(right), 2 * radius * np.sin(right / 2) ** 2
    middle = [0.0] if count % 2 else []
    return np.stack((np.concatenate((-x[::-1], middle, x)), np.concatenate((z[::-1], middle, z))), 1)


def energy(chain: Chain, place: Array, bone: Array) -> float:
    """Elastic energy, J: links, tissue, nail and plate."""
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
    """Forces (N, 2) on the elements and (2,) on the bone: minus the slopes of `energy`."""
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
    """Of `elastic_forces`."""
    line = place - chain.centre - bone
    along = np.hypot(*line.T)
    direction, ratio = line / along[:, None], chain.radius / along
    turned = (chain.tissue * ratio)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    tissue = turned + (chain.tissue * (1 - ratio) + chain.shear)[:, None, None] * np.eye(2)
    tissue[[0, -1]] += chain.nail * np.eye(2)
    return Slopes(chain.membrane, tissue, np.where(place[:, 1] < 0, chain.contact, 0.0))


class Friction(NamedTuple):
    """Dahl's force (N,) after a slide, and its slopes.

    That with the place it slid from along the plate is minus the one with the place.
    """

    force: Array
    along: Array  # with the place along the plate
    above: Array  # and above it
    before: Array  # with the force before
    from_above: Array  # with the height it slid from
    steep: Array  # with mu k_c
    spring: Array  # with sigma_0


def friction(chain: Chain, mu: Array, before: Array, old: Array, place: Array) -> Friction:
    """After a slide from ``old`` to ``place``, both (N, 2): `friction.dahl_step` under the middle of both limits, cut.

    With the middle the error of a limit that changes is of third order; cut to the last limit the force never exceeds
    it.
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
        rest = np.where(base > 0, base ** (n / power), 0.0)  # its slope with the distance, and (u / u_0)^n
    after = np.where(done, sign * limit, held + sign * limit * left * (1 - kept))
    along = chain.friction_stiffness * left**n * rest
    # u^(1-n) = u_0^(1-n) - (1-n) sigma_0 d / F: with the limit both u_0 and the distance in its units change.
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
