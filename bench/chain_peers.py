"""The skin chain's equations by integrators of other packages, which are installed where they are to be compared:
`pip install numba scikit-sundae`."""

import importlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.rows import Skipped
from fingerflow.models.skin_explicit import ChainState, rates
from fingerflow.models.skin_forces import Array, Chain
from fingerflow.models.skin_implicit import Load, State


def cvode(chain: Chain, state: State, mu: Array, load: Load, duration: float, rtol: float) -> Array:
    """Places (N, 2) after ``duration`` s by SUNDIALS' BDF of variable order with matrix-free GMRES (scikit-sundae); the
    right-hand side is that of the explicit method, in NumPy.

    Raises Skipped where the package is missing.
    """
    solver = _package("sksundae.cvode", "scikit-sundae").CVODE
    count = len(mu)
    start = np.concatenate((np.zeros(2 * count + 2), state.friction))

    def slopes(time: float, y: Array, out: Array) -> None:
        place = chain.reference + y[: 2 * count].reshape(count, 2)
        at = ChainState(place, y[2 * count : 2 * count + 2], y[2 * count + 2 :])
        speeds = rates(chain, mu, at, load.at(time / duration))
        out[:] = np.concatenate([part.ravel() for part in speeds])

    # Places to 0.1 nm and forces to 1e-7 N at least: both are small where skin hardly moves.
    absolute = np.concatenate((np.full(2 * count + 2, 1e-10), np.full(count, 1e-7)))
    found = solver(
        slopes, method="BDF", linsolver="gmres", krylov_dim=20, rtol=rtol, atol=absolute, max_num_steps=100_000
    ).solve(np.array([0.0, duration]), start)
    if not found.success:
        raise RuntimeError(f"CVODE at rtol {rtol:g}: {found.message}")
    return np.asarray(chain.reference + found.y[-1, : 2 * count].reshape(count, 2))


def numba_runge_kutta(chain: Chain, state: State, mu: Array, load: Load, duration: float, step: float) -> Array:
    """Places (N, 2) after ``duration`` s by the published Runge-Kutta at ``step`` s, element by element, compiled by
    numba at the first call; the load is constant.

    Raises Skipped where the package is missing.
    """
    march = _compiled(_package("numba", "numba"))
    place, bone, rubbed = state.place.copy(), state.bone.copy(), state.friction.copy()
    march(
        *(chain.reference, mu, place, bone, rubbed, load.first, math.ceil(duration / step * (1 - 1e-12)), duration),
        *(chain.radius, chain.membrane, chain.tissue, chain.shear, chain.nail, chain.contact, chain.damping),
        *(chain.bone_damping, chain.friction_stiffness, chain.exponent),
    )
    return np.asarray(place)


_march: Callable[..., None] | None = None


def _compiled(numba: Any) -> Callable[..., None]:
    global _march
    if _march is None:
        slopes = numba.njit(fastmath=True)(_slopes)
        _march = numba.njit(_marching(slopes))
    return _march


def _package(module: str, name: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise Skipped(f"{name} is not installed") from None


def _slopes(
    reference: Array, mu: Array, place: Array, bone: Array, rubbed: Array, load: Array, radius: float, membrane: float,
    tissue: float, shear: float, nail: float, contact: float, damping: float, bone_damping: float, spring: float,
    exponent: float, of_place: Array, of_bone: Array, of_rubbed: Array,
) -> None:  # fmt: skip
    """Of equations 5 and 7, as `models.skin_explicit.rates` has them."""
    count = len(mu)
    on_bone_x, on_bone_z = load[0], load[1]
    for i in range(count):
        x, z = place[i, 0], place[i, 1]
        line_x, line_z = x - bone[0], z - radius - bone[1]
        own = tissue * (1 - radius / math.sqrt(line_x * line_x + line_z * line_z))
        off_x, off_z = x - reference[i, 0] - bone[0], z - reference[i, 1] - bone[1]
        resisted = shear + nail if i == 0 or i == count - 1 else shear
        held_x, held_z = own * line_x + resisted * off_x, own * line_z + resisted * off_z
        on_bone_x += held_x
        on_bone_z += held_z
        force_x, force_z = -held_x, -held_z
        moved_x, moved_z = x - reference[i, 0], z - reference[i, 1]
        if i > 0:
            force_x += membrane * (place[i - 1, 0] - reference[i - 1, 0] - moved_x)
            force_z += membrane * (place[i - 1, 1] - reference[i - 1, 1] - moved_z)
        if i < count - 1:
            force_x += membrane * (place[i + 1, 0] - reference[i + 1, 0] - moved_x)
            force_z += membrane * (place[i + 1, 1] - reference[i + 1, 1] - moved_z)
        of_rubbed[i] = 0.0
        if z < 0:
            force_z -= contact * z
            limit = -mu[i] * contact * z
            if limit > 0:
                held = min(max(rubbed[i], -limit), limit)
                force_x -= held
                sign = 1.0 if force_x > 0 else (-1.0 if force_x < 0 else 0.0)
                left = 1 - sign * held / limit
                steep = abs(left) ** exponent if left >= 0 else -(abs(left) ** exponent)
                of_rubbed[i] = spring * steep * force_x / damping
        of_place[i, 0] = force_x / damping
        of_place[i, 1] = force_z / damping
    of_bone[0] = on_bone_x / bone_damping
    of_bone[1] = on_bone_z / bone_damping


def _marching(slopes: Callable[..., None]) -> Callable[..., None]:
    def march(
        reference: Array, mu: Array, place: Array, bone: Array, rubbed: Array, load: Array, count: int, duration: float,
        radius: float, membrane: float, tissue: float, shear: float, nail: float, contact: float, damping: float,
        bone_damping: float, spring: float, exponent: float,
    ) -> None:  # fmt: skip
        h = duration / count
        at_place, at_bone, at_rubbed = place.copy(), bone.copy(), rubbed.copy()
        of_place, of_bone, of_rubbed = np.zeros_like(place), np.zeros_like(bone), np.zeros_like(rubbed)
        sum_place, sum_bone, sum_rubbed = np.zeros_like(place), np.zeros_like(bone), np.zeros_like(rubbed)
        for _ in range(count):
            at_place[:], at_bone[:], at_rubbed[:] = place, bone, rubbed
            sum_place[:], sum_bone[:], sum_rubbed[:] = 0.0, 0.0, 0.0
            for stage in range(4):
                slopes(
                    reference, mu, at_place, at_bone, at_rubbed, load, radius, membrane, tissue, shear, nail, contact,
                    damping, bone_damping, spring, exponent, of_place, of_bone, of_rubbed,
                )  # fmt: skip
                weight = h / 6 if stage == 0 or stage == 3 else h / 3
                ahead = h if stage == 2 else h / 2
                for i in range(len(mu)):
                    for k in range(2):
                        sum_place[i, k] += weight * of_place[i, k]
                        at_place[i, k] = place[i, k] + ahead * of_place[i, k]
                    sum_rubbed[i] += weight * of_rubbed[i]
                    at_rubbed[i] = rubbed[i] + ahead * of_rubbed[i]
                for k in range(2):
                    sum_bone[k] += weight * of_bone[k]
                    at_bone[k] = bone[k] + ahead * of_bone[k]
            for i in range(len(mu)):
                for k in range(2):
                    place[i, k] += sum_place[i, k]
                limit = mu[i] * contact * max(-place[i, 1], 0.0)
                rubbed[i] = min(max(rubbed[i] + sum_rubbed[i], -limit), limit)
            for k in range(2):
                bone[k] += sum_bone[k]

    return march
