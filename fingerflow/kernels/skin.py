"""Kernels of the skin chain of `fingerflow.models`."""

from collections.abc import Sequence

import torch
from torch import Tensor

from fingerflow.kernels.checks import check_like, empty
from fingerflow.kernels.library import entry, values_are_known
from fingerflow.kernels.torch_op import torch_op

__all__ = [
    "press_skin",
    "press_skin_back",
]


@torch_op(changes=("place", "bone", "rubbed", "step"))
def press_skin(
    reference: Tensor,
    numbers: Tensor,
    friction: Tensor,
    load: Tensor,
    rest: Tensor,
    place: Tensor,
    bone: Tensor,
    rubbed: Tensor,
    step: Tensor,
    *,
    held: Sequence[bool],
    most_steps: int,
    tolerance: float,
    duration: float,
    record_steps: int = 0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Goes on with B chains of N elements, as `models.skin_implicit.advance` does, to rounding; all float64, SI units.

    Reference (B, N, 2), numbers (B, 10) in the order of `models.skin_forces.Chain`, friction (B, N),
    load (B, 2, 2) first and last, rest (B,). Place (B, N, 2), bone (B, 2), rubbed (B, N) and step (B,) are changed.
    Gives time (B,), counts (B, 3) int64 of steps, rejected ones and iterations, and of up to ``record_steps`` steps
    (B, record_steps, 2 + 2 (3 N + 2)) time, length, and of both stages place, bone and friction.

    Raises:
        ValueError: another dtype, or shapes that do not belong together.
    """
    batch, count = friction.shape
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "friction": (batch, count), "load": (batch, 2, 2)}
    shapes |= {"rest": (batch,)}
    state = {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count), "step": (batch,)}
    given = {"reference": reference, "numbers": numbers, "friction": friction, "load": load, "rest": rest}
    changed = {"place": place, "bone": bone, "rubbed": rubbed, "step": step}
    for name, shape in (shapes | state).items():
        check_like(name, (given | changed)[name], torch.float64, shape)
    if count < 3 or not all(tensor.is_contiguous() for tensor in changed.values()):
        raise ValueError(f"a chain of {count} elements: give 3 or more, and a state in one piece")
    time = torch.zeros_like(step, memory_format=torch.contiguous_format)
    counts = torch.zeros_like(step, dtype=torch.int64)[:, None].repeat(1, 3)
    record = step.new_zeros(batch, record_steps, 2 + 2 * (3 * count + 2))
    entry("press_skin")(
        **{name: tensor.contiguous() for name, tensor in given.items()},
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
        threads=torch.get_num_threads(),
    )
    return time, counts, record


@torch_op()
def press_skin_back(
    reference: Tensor,
    numbers: Tensor,
    friction: Tensor,
    place: Tensor,
    bone: Tensor,
    rubbed: Tensor,
    record: Tensor,
    wanted: Tensor,
    steps: Tensor,
    *,
    held: Sequence[bool],
) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives back along the record of `press_skin`, to rounding what `models.skin_adjoint` gives.

    Arguments as there, ``place``, ``bone`` and ``rubbed`` those at the beginning; ``wanted`` (B, 3 N + 2) of places,
    bone and friction at the end, ``steps`` (B,) int64 of the record. Gives those of stiffnesses (B, 6), of friction
    (B, N) and, as wanted, of the beginning (B, 3 N + 2).

    Raises:
        ValueError: another dtype, shapes that do not belong together, or more steps than the record has.
    """
    batch, count = friction.shape
    size, rows = 3 * count + 2, record.shape[1]
    shapes = {"reference": (batch, count, 2), "numbers": (batch, 10), "friction": (batch, count)}
    shapes |= {"place": (batch, count, 2), "bone": (batch, 2), "rubbed": (batch, count)}
    shapes |= {"record": (batch, rows, 2 + 2 * size), "wanted": (batch, size)}
    tensors = (reference, numbers, friction, place, bone, rubbed, record, wanted)
    given = dict(zip(shapes, tensors, strict=True))
    for name, shape in shapes.items():
        check_like(name, given[name], torch.float64, shape)
    check_like("steps", steps, torch.int64, (batch,))
    ends = (0, 0) if not values_are_known() or not batch else (int(steps.min()), int(steps.max()))
    if count < 3 or not 0 <= ends[0] <= ends[1] <= rows:
        raise ValueError(
            f"{count} elements, {ends[0]} to {ends[1]} steps of {rows}: give 3 or more, and the whole record"
        )
    stiffness, of_friction, result = (empty(torch.float64, batch, last) for last in (6, count, size))
    entry("press_skin_back")(
        **{name: tensor.contiguous() for name, tensor in given.items()},
        steps=steps.contiguous(),
        stiffness=stiffness,
        of_friction=of_friction,
        result=result,
        batch=batch,
        count=count,
        held_x=held[0],
        held_z=held[1],
        record_steps=rows,
        threads=torch.get_num_threads(),
    )
    return stiffness, of_friction, result
