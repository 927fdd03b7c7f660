"""A call of a graph taken apart: its tensors by name, along which axes points lie, and the rest."""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

Axis = int | None


class GraphCall(NamedTuple):
    """Arguments of a method of a module, flat.

    Attributes:
        names: of the leaves, "['templates'].start".
        values: the leaves.
        axes: of each leaf, along which points lie (``point_axes`` of the module, by argument).
        structure: which puts the leaves together again.
    """

    names: list[str]
    values: list[Any]
    axes: list[Axis]
    structure: Any

    @classmethod
    def of(cls, module: nn.Module, method: str, arguments: tuple[Any, ...], named: Mapping[str, Any]) -> "GraphCall":
        """Of the arguments as they are given, with the defaults of the others."""
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
        """Those of the leaves, in their order."""
        return [value for value in self.values if isinstance(value, Tensor)]

    @property
    def tensor_axes(self) -> list[Axis]:
        """Of each tensor, along which points lie."""
        return [axis for axis, value in zip(self.axes, self.values, strict=True) if isinstance(value, Tensor)]

    @property
    def points(self) -> int:
        """How many there are; 0 where the module knows of none."""
        found = (one.shape[axis] for one, axis in zip(self.tensors, self.tensor_axes, strict=True) if axis is not None)
        return next(found, 0)

    def with_tensors(self, tensors: Sequence[Tensor]) -> dict[str, Any]:
        """The arguments by name, with other tensors in the place of its own."""
        others = iter(tensors)
        values = [next(others) if isinstance(value, Tensor) else value for value in self.values]
        arguments: dict[str, Any] = tree.tree_unflatten(values, self.structure)
        return arguments


def filled_up(tensors: Sequence[Tensor], axes: Sequence[Axis], room: int) -> list[Tensor]:
    """Tensors with so many points along their axes, of which nothing is known beyond their own: NaN, or 0."""
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
    """Axes along which one has more than the other: those of points, where it was made of more of them."""
    return [axis for axis, (one, two) in enumerate(zip(tensor.shape, other.shape, strict=True)) if one != two]


def settings_of(module: nn.Module) -> list[Any]:
    """What modules of one class differ in: attributes that are plain values, and buffers."""
    found: list[Any] = []
    for name, part in module.named_modules():
        plain = {key: repr(value) for key, value in vars(part).items() if isinstance(value, int | float | str | None)}
        found.append([name, type(part).__name__, sorted(plain.items())])
    return [*found, *([name, tensor.tolist()] for name, tensor in module.named_buffers())]
