"""Kernels of the skin chain of `fingerflow.models`."""

from collections.abc import Sequence

from fingerflow.kernels.arrays import Array, empty, in_one_piece, may_be_written, range_of, zeros
from fingerflow.kernels.checks import check_like
from fingerflow.kernels.library import entry, threads, values_are_known

__all__ = [
    "press_skin",
    "press_skin_back",
]


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
    held: Sequence[bool],
    most_steps: int,
    tolerance: float,
    duration: float,
    record_steps: int = 0,
) -> tuple[Array, Array, Array]:
    """Advance B chains of N elements in time, as `models.skin_implicit.advance` does, to rounding; float64, SI units.

    Inputs are `reference` (B, N, 2), `numbers` (B, 10) in the order of `models.skin_forces.Chain`, `friction` (B, N),
    `load` (B, 2, 2), first and last, and `rest` (B,). The state `place` (B, N, 2), `bone` (B, 2), `rubbed` (B, N) and
    `step` (B,) is changed in place.

    Returns:
        Time (B,), counts (B, 3) int64 of steps, rejected ones and iterations, and a record (B, record_steps,
        2 + 2 (3 N + 2)) of up to `record_steps` steps: time, length, and place, bone and friction of both stages.

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
    time, counts = zeros(step, "float64", batch), zeros(step, "int64", batch, 3)
    record = zeros(step, "float64", batch, record_steps, 2 + 2 * (3 * count + 2))
    entry("press_skin")(
        **{name: in_one_piece(tensor) for name, tensor in given.items()},
        **changed,
        time=time,
        counts=counts,
        record=record if record_steps else None,
        batch=batch,
        count=count,
        held_x=held[0],
        held_z=held[1],
        most_steps=most_steps,
        record_steps=record_steps,
        tolerance=tolerance,
        duration=duration,
        threads=threads(),
    )
    return time, counts, record


def press_skin_back(
    reference: Array,
    numbers: Array,
    friction: Array,
    place: Array,
    bone: Array,
    rubbed: Array,
    record: Array,
    wanted: Array,
    steps: Array,
    *,
    held: Sequence[bool],
) -> tuple[Array, Array, Array]:
    """Propagate derivatives backward along the record of `press_skin`, as `models.skin_adjoint` does to rounding.

    Arguments are those of `press_skin`, with `place`, `bone` and `rubbed` at the beginning. `wanted` (B, 3 N + 2) are
    the derivatives with respect to place, bone and friction at the end, `steps` (B,) int64 the numbers of recorded
    steps.

    Returns:
        Derivatives with respect to the stiffnesses (B, 6), to friction (B, N), and to the state at the beginning
        (B, 3 N + 2), in the order of `wanted`.

    Raises:
        ValueError: wrong dtype, inconsistent shapes, or more steps than the record has.
    """
    batch, count = friction.shape
    size, rows = 3 * count + 2, record.shape[1]
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "friction": (batch, count)}
    shapes |= {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count)}
    shapes |= {"record": (batch, rows, 2 + 2 * size), "wanted": (batch, size)}
    tensors = (reference, numbers, friction, place, bone, rubbed, record, wanted)
    given = dict(zip(shapes, tensors, strict=True))
    for name, shape in shapes.items():
        check_like(name, given[name], "float64", shape)
    check_like("steps", steps, "int64", (batch,))
    ends = (0, 0) if not values_are_known() or not batch else range_of(steps)
    if count < 3 or not 0 <= ends[0] <= ends[1] <= rows:
        raise ValueError(
            f"{count} elements, {ends[0]} to {ends[1]} steps of {rows}: give 3 or more, and the whole record"
        )
    stiffness, of_friction, result = (empty(reference, "float64", batch, last) for last in (6, count, size))
    entry("press_skin_back")(
        **{name: in_one_piece(tensor) for name, tensor in given.items()},
        steps=in_one_piece(steps),
        stiffness=stiffness,
        of_friction=of_friction,
        result=result,
        batch=batch,
        count=count,
        held_x=held[0],
        held_z=held[1],
        record_steps=rows,
        threads=threads(),
    )
    return stiffness, of_friction, result
