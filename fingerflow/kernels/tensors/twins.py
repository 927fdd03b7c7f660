"""Compiled twins of portable ops, as their sources declare them."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, Generic, TypeVar, cast

import torch
from torch import Tensor

from fingerflow.kernels.declarations import ArrayField
from fingerflow.kernels.library import compiled, declared
from fingerflow.kernels.tensors.serving import serve
from fingerflow.kernels.tensors.torch_op import torch_op

_R = TypeVar("_R")


class Twin(Generic[_R]):
    """Compiled twin of a portable op, by the name of the kernel, with the arguments in the order of its declaration:
    arrays and the numbers that these do not tell.

    It is registered as `torch.ops.fingerflow.<name>`, which the torch compiler does not trace. Arguments that do not
    fit the declaration raise TypeError or ValueError.
    """

    def __init__(self, name: str) -> None:
        """Register the kernel `name` as an op of torch, unless the library has none."""
        self.__name__, function = name, declared().get(name)
        if function is None:
            return
        arguments, results = function.arguments, [array for array in function.arrays if array.role != "input"]
        self._dtypes = [
            frozenset(getattr(torch, dtype) for dtype in array.dtypes)
            for array in arguments
            if isinstance(array, ArrayField)
        ]
        names = [argument.name for argument in arguments]

        def call(*values: Any) -> Any:
            return compiled(name)(**dict(zip(names, values, strict=True)))

        kinds = [_type(argument) for argument in arguments]
        call.__name__ = name
        call.__annotations__ = {
            **dict(zip(names, kinds, strict=True)),
            "return": Tensor if len(results) == 1 else tuple[(Tensor,) * len(results)],  # type: ignore[misc]
        }
        call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [
                inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=kind)
                for name, kind in zip(names, kinds, strict=True)
            ]
        )
        self._op: Callable[..., _R] = torch_op()(call)

    def __call__(self, *arguments: Any) -> _R:
        """Call the kernel, and return its results, newly allocated, as a tensor or a tuple of tensors."""
        return self._op(*arguments)

    def serves(self, *tensors: Tensor | None) -> bool:
        """Return whether the kernel can be called with these tensors, the first of its arguments: they have its dtypes,
        and compiled kernels serve them (`serve`).
        """
        return serve(*tensors) and all(
            tensor is None or tensor.dtype in dtypes for tensor, dtypes in zip(tensors, self._dtypes, strict=False)
        )


@functools.cache
def twin(name: str) -> Twin[Any]:
    """Return the compiled twin by the name of the kernel."""
    return Twin(name)


def _type(argument: Any) -> Any:
    if isinstance(argument, ArrayField):
        return Tensor | None if argument.optional else Tensor
    return cast(Any, int if argument.least is not None else float)
