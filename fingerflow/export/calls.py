"""Arguments of a graph call, flattened to a list of tensors and settings."""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

Axis = int | None


class GraphCall(NamedTuple):
    """Arguments of a method call of a torch module, flattened to a list of tensors and settings.

    Attributes:
        names: of the leaves, such as "['templates'].start".
        values: the leaves.
        axes: for each leaf the axis along which points lie (``point_axes`` of the module, by argument), else None.
        structure: pytree structure that restores the arguments from the leaves.
    """

    names: list[str]
    values: list[Any]
    axes: list[Axis]
    structure: Any

    @classmethod
    def of(cls, module: nn.Module, method: str, arguments: tuple[Any, ...], named: Mapping[str, Any]) -> "GraphCall":
        """Flatten the positional and named arguments of a call of a module's method, with default values for omitted
        arguments.
        """
        bound = inspect.signature(getattr(module, method)).bind(*arguments, **named)
        bound.apply_defaults()
        parts, structure = tree.tree_flatten_with_path(dict(bound.arguments))
        along: dict[str, int] = getattr(module, "point_axes", {})
        return cls(
            [tree.keystr(path) for path, _ in parts],
            [value for _, value in parts],
            [along.get(getattr(path[0], "key", "")) for path, _ in parts],
            structure,
        )

    @property
    def tensors(self) -> list[Tensor]:
        """Return the arguments that are tensors, in the order of the flat list."""
        return [value for value in self.values if isinstance(value, Tensor)]

    @property
    def settings(self) -> list[Any]:
        """Return the flat list of arguments, with None in place of tensors."""
        return [None if isinstance(value, Tensor) else value for value in self.values]

    @property
    def tensor_axes(self) -> list[Axis]:
        """Return the axis of each tensor argument along which points lie, None for a tensor without such an axis."""
        return [axis for axis, value in zip(self.axes, self.values, strict=True) if isinstance(value, Tensor)]

    @property
    def points(self) -> int:
        """Return the number of points in the tensor arguments; 0 if no tensor has an axis of points."""
        found = (one.shape[axis] for one, axis in zip(self.tensors, self.tensor_axes, strict=True) if axis is not None)
        return next(found, 0)

    def of_recording(self, place: int, batch: int) -> "GraphCall":
        """Return the call for the recording at index `place` of a batch; tensors (1, ...) are the same for all
        recordings.
        """
        return self._replace(
            values=[
                value[place : place + 1] if isinstance(value, Tensor) and len(value) == batch else value
                for value in self.values
            ]
        )

    def with_tensors(self, tensors: Sequence[Tensor]) -> dict[str, Any]:
        """Return the arguments by name, with `tensors` in place of the original tensors, in order."""
        others = iter(tensors)
        values = [next(others) if isinstance(value, Tensor) else value for value in self.values]
        arguments: dict[str, Any] = tree.tree_unflatten(values, self.structure)
        return arguments


def pad_points(tensors: Sequence[Tensor], axes: Sequence[Axis], room: int) -> list[Tensor]:
    """Pad tensors to `room` points along their axis of points, with NaN or, for integers, with 0; a tensor whose axis
    is None is returned as it is.
    """
    filled = []
    for tensor, axis in zip(tensors, axes, strict=True):
        if axis is None or tensor.shape[axis] == room:
            filled.append(tensor)
            continue
        shape = list(tensor.shape)
        shape[axis] = room - shape[axis]
        nothing = torch.nan if tensor.is_floating_point() else 0
        filled.append(torch.cat((tensor, tensor.new_full(shape, nothing)), dim=axis))
    return filled


def axes_that_differ(tensor: Tensor, other: Tensor) -> list[int]:
    """Return the axes along which two tensors differ in length: if one was computed for more points, these are the axes
    of points.
    """
    return [axis for axis, (one, two) in enumerate(zip(tensor.shape, other.shape, strict=True)) if one != two]


def settings_of(module: nn.Module) -> list[Any]:
    """Return all in which modules of one class can differ, as a list: plain attributes, also of submodules, and
    buffers.
    """
    found: list[Any] = []
    for name, part in module.named_modules():
        plain = {key: repr(value) for key, value in vars(part).items() if isinstance(value, int | float | str | None)}
        found.append([name, type(part).__name__, sorted(plain.items())])
    return [*found, *([name, tensor.tolist()] for name, tensor in module.named_buffers())]
