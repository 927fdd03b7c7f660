"""Adjoint of a chain's motion, back along the steps that `skin_implicit` recorded: one transposed solve per stage.

A stage solves r = damping (Y - known) - c G(Y, F) = 0 with Dahl's force F(before, from, Y). A gradient w with respect
to Y becomes lambda = M^-T w with M = dr/dY. The gradient is then damping lambda for `known` and c lambda for the
forces. Step lengths are treated as constants: their dependence on the parameters is of the order of the tolerance.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.models.skin_forces import Array, Chain, elastic_forces, elastic_slopes, friction
from fingerflow.models.skin_implicit import TO_EARLIER, TO_LATER, C
from fingerflow.models.skin_solve import Arrow

Stage = tuple[Array, Array, Array]  # positions (N, 2), bone (2,), friction (N,)
_ELASTIC = ("membrane", "tissue", "shear", "nail", "contact")


class Back(NamedTuple):
    """Gradients with respect to stiffnesses, friction coefficients and the initial state."""

    stiffness: Array  # (6,) membrane, tissue, shear, nail, contact, friction
    friction: Array  # (N,) coefficients
    place: Array  # (N, 2)
    bone: Array  # (2,)
    rubbed: Array  # (N,)


def stiffness_gradients(
    chain: Chain,
    mu: Array,
    begin: Stage,
    held: NDArray[np.bool_],
    record: Array,
    wanted: Stage,
) -> Back:
    """Return the gradients for ``wanted``, the gradient with respect to the state at the end of ``record``.

    ``begin`` is the state before the first step; ``record`` has one row per step, written by `skin_implicit.advance`.
    """
    count = len(mu)
    place, bone, rubbed = begin
    of_place, of_bone, of_rubbed = wanted
    stiffness, coefficients = np.zeros(6), np.zeros(count)
    speed, bone_speed = np.zeros((count, 2)), np.zeros(2)  # gradients with respect to the velocity

    def stage(row: Array) -> Stage:
        return row[: 2 * count].reshape(count, 2), row[2 * count : 2 * count + 2], row[2 * count + 2 :]

    def back(before: Array, start: Array, end: Stage, c: float) -> tuple[Array, Array, Array, Array]:
        """Go back through one stage: gradients for `known` (elements, bone), the slide's origin, and the F before."""
        nonlocal of_place, of_bone, of_rubbed
        at, bone_at, _ = end
        rubbing = friction(chain, mu, before, start, at)
        of_place = of_place.copy()
        of_place[:, 0] += rubbing.along * of_rubbed
        of_place[:, 1] += rubbing.above * of_rubbed
        arrow = Arrow(chain, elastic_slopes(chain, at, bone_at), rubbing, c, held)
        of_elements, of_the_bone = arrow.solve_transposed(of_place, np.where(held, 0.0, of_bone))
        of_the_bone = np.where(held, 0.0, of_the_bone)
        for k, name in enumerate(_ELASTIC):
            forces, on_bone = elastic_forces(_alone(chain, name), at, bone_at)
            stiffness[k] += c * float((of_elements * forces).sum() + (of_the_bone * on_bone).sum())
        of_friction = of_rubbed - c * of_elements[:, 0]
        coefficients[:] += rubbing.steep * of_friction * chain.contact
        stiffness[4] += float((rubbing.steep * of_friction * mu).sum())
        stiffness[5] += float((rubbing.spring * of_friction).sum())
        start_back = np.stack((-rubbing.along * of_friction, rubbing.from_above * of_friction), 1)
        before_back = rubbing.before * of_friction
        return chain.damping * of_elements, chain.bone_damping * of_the_bone, start_back, before_back

    for number in range(len(record) - 1, -1, -1):
        row = record[number]
        c = C * row[1]
        middle, end = stage(row[2 : 4 + 3 * count]), stage(row[4 + 3 * count :])
        start = stage(record[number - 1, 4 + 3 * count :]) if number else begin
        # The velocity at the end is (end - known) / c.
        of_place, of_bone = of_place + speed / c, of_bone + bone_speed / c
        known, bone_known, slid_from, of_rubbed_middle = back(middle[2], middle[0], end, c)
        known, bone_known = known - speed / c, bone_known - bone_speed / c
        earlier, bone_earlier = -TO_EARLIER * known, -TO_EARLIER * bone_known
        of_place, of_bone, of_rubbed = TO_LATER * known + slid_from, TO_LATER * bone_known, of_rubbed_middle
        known, bone_known, slid_from, of_rubbed = back(start[2], start[0], middle, c)
        of_place, of_bone = earlier + known + slid_from, bone_earlier + bone_known
        speed, bone_speed = c * known, np.where(held, 0.0, c * bone_known)

    # The initial velocity follows from the forces on the initial state.
    slopes = elastic_slopes(chain, place, bone)
    nothing = friction(chain, 0 * mu, rubbed, place, place)
    whole = Arrow(chain, slopes, nothing, 1.0, held)  # damping + K; damping is subtracted below
    pull, bone_pull = speed / chain.damping, bone_speed / chain.bone_damping
    times, bone_times = whole.times(pull, bone_pull)
    of_place = of_place - (times - chain.damping * pull)
    of_bone = of_bone - (bone_times - chain.bone_damping * bone_pull)
    of_rubbed = of_rubbed - pull[:, 0]
    for k, name in enumerate(_ELASTIC):
        forces, on_bone = elastic_forces(_alone(chain, name), place, bone)
        stiffness[k] += float((pull * forces).sum() + (bone_pull * on_bone).sum())
    return Back(stiffness, coefficients, of_place, of_bone, of_rubbed)


def _alone(chain: Chain, name: str) -> Chain:
    """Return the chain with this stiffness set to 1 and the others to 0: forces are linear in the stiffnesses."""
    membrane, tissue, shear, nail, contact = (float(name == one) for one in _ELASTIC)
    return chain._replace(membrane=membrane, tissue=tissue, shear=shear, nail=nail, contact=contact)
