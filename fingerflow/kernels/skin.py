"""Kernel of the skin chain, the model of a fingertip's skin as a chain of elements joined by springs
(`fingerflow.models`).
"""

from fingerflow.kernels.arrays import Array, in_one_piece, may_be_written, zeros
from fingerflow.kernels.checks import check_like
from fingerflow.kernels.library import entry, threads

__all__ = ["press_skin"]


def press_skin(
    reference: Array,
    numbers: Array,
    friction: Array,
    load: Array,
    rest: Array,
    place: Array,
    bone: Array,
    rubbed: Array,
    step: Array,
    *,
    most_steps: int,
    tolerance: float,
    duration: float,
) -> tuple[Array, Array]:
    """Advance B skin chains of N elements in time by up to `duration` s under a load, and change their state in place,
    as `models.skin_implicit.advance` up to rounding; float64, SI units.

    Inputs are `reference` (B, N, 2), `numbers` (B, 10) in the order of `models.skin_forces.Chain`, `friction` (B, N),
    `load` (B, 2, 2), first and last, and `rest` (B,). The state `place` (B, N, 2), `bone` (B, 2), `rubbed` (B, N) and
    `step` (B,) is changed in place.

    Returns:
        Time (B,), and counts (B, 2) int64 of steps and rejected ones.

    Raises:
        ValueError: wrong dtype, or inconsistent shapes.
    """
    batch, count = friction.shape
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "friction": (batch, count), "load": (batch, 2, 2)}
    shapes |= {"rest": (batch,)}
    state = {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count), "step": (batch,)}
    given = {"reference": reference, "numbers": numbers, "friction": friction, "load": load, "rest": rest}
    changed = {"place": place, "bone": bone, "rubbed": rubbed, "step": step}
    for name, shape in (shapes | state).items():
        check_like(name, (given | changed)[name], "float64", shape)
    if count < 3 or not all(may_be_written(array) for array in changed.values()):
        raise ValueError(f"a chain of {count} elements: give 3 or more, and a state in one piece")
    time, counts = zeros(step, "float64", batch), zeros(step, "int64", batch, 2)
    entry("press_skin")(
        **{name: in_one_piece(tensor) for name, tensor in given.items()},
        **changed,
        time=time,
        counts=counts,
        batch=batch,
        count=count,
        most_steps=most_steps,
        tolerance=tolerance,
        duration=duration,
        threads=threads(),
    )
    return time, counts
