"""Registration of kernel functions as torch ops, which the torch compiler calls without tracing them."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast, get_args, get_origin, get_type_hints

import torch
from torch import Tensor

from fingerflow.kernels.kernel import shapes_only

_P = ParamSpec("_P")
_R = TypeVar("_R")

_CPU = torch.device("cpu")  # device of all results, whatever torch's default device is
_OPS = torch.library.Library("fingerflow", "DEF")


def torch_op(*, shapes: Callable[..., Any] | None = None) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Return a decorator that registers a function as `torch.ops.fingerflow.<name>`, opaque to the compiler.

    Outside compilation the function is called directly, and so it is while torch exports (to standard operators) and if
    a derivative is needed. A function with `shapes`, whose control flow depends on data, is exported as the op, and
    `torch.func.vmap` calls it once, with the mapped axis folded into the batch. The compiler infers the shapes of
    results from the function itself, if it is one of kernels: it runs on tensors without values, and the library
    computes nothing (`shapes_only`). The signature is taken from the annotations, a type variable standing for a
    tensor: tensors and numbers in, a tensor or a tuple of tensors out. Of these, tensors with two or more axes may be
    None. No result shares memory with another or with an argument.

    Args:
        shapes: needed for a function of portable ops, on any device, whose control flow depends on data: returns
            tensors of the shapes and dtypes of its results from the same arguments. The first axis of all its tensors,
            in and out, is the batch.

    Raises:
        RuntimeError: when called, if `torch.func.vmap` and a derivative are asked of a function with `shapes`.
    """

    def known(function: Callable[_P, _R]) -> Callable[_P, _R]:
        name = getattr(function, "__name__", "")
        kind = _of_tensors(get_type_hints(function)["return"])
        parts = (kind,) if kind is Tensor else _parts(kind)
        named = _named(kind)
        may_be_none = [type(None) in get_args(part) for part in parts]

        def whole(result: Any) -> Any:
            """Replace None in a result tuple by an empty tensor, because a torch op cannot return None."""
            if kind is Tensor:
                return cast(_R, result)
            return tuple(torch.empty(0, device=_CPU) if part is None else part for part in result)

        def computed(*args: Any, **kwargs: Any) -> Any:
            return whole(function(*args, **kwargs))

        def shaped(*args: Any, **kwargs: Any) -> Any:
            with shapes_only():
                return whole((shapes or function)(*args, **kwargs))

        _OPS.define(name + _schema(function, len(parts)), tags=(torch.Tag.pt2_compliant_tag,))
        _OPS.impl(name, computed, "CPU" if shapes is None else "CompositeExplicitAutograd")
        torch.library.register_fake(f"fingerflow::{name}", shaped, lib=_OPS)
        op = getattr(torch.ops.fingerflow, name).default

        def folded(info: Any, dims: tuple[int | None, ...], *args: Any) -> Any:
            """Compute the op under `torch.func.vmap`: merge the mapped axis, of size V, with the batch, of size B, into
            one batch of V B, call the op once, and split its results again.
            """
            size = info.batch_size
            result = op(*(_into_batch(one, dim, size) for one, dim in zip(args, dims, strict=True)))
            if kind is Tensor:
                return result.unflatten(0, (size, -1)), 0
            missing = [none and part.ndim == 1 for none, part in zip(may_be_none, result, strict=True)]
            split = [
                part if none else part.unflatten(0, (size, -1)) for none, part in zip(missing, result, strict=True)
            ]
            return tuple(split), tuple(None if none else 0 for none in missing)

        if shapes is not None:
            torch.library.register_vmap(f"fingerflow::{name}", folded, lib=_OPS)

        def is_opaque(args: tuple[Any, ...]) -> bool:
            """Return whether a call with these arguments is to go to the registered op, which torch does not trace, in
            place of the Python function.
            """
            if torch.compiler.is_compiling():
                return not (torch.compiler.is_exporting() and shapes is None) and not requires_gradient(*args)
            if shapes is None or not any(torch._C._functorch.is_batchedtensor(level) for level in _levels(args)):
                return False
            if requires_gradient(*args):
                raise RuntimeError(f"{name} has no derivative under torch.func.vmap: pass a batch (B, ...) instead")
            return True

        @functools.wraps(function)
        def called(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if not is_opaque(args):
                return function(*args, **kwargs)
            result = op(*args, **kwargs)
            if kind is Tensor:
                return cast(_R, result)
            given = [None if none and part.ndim == 1 else part for none, part in zip(may_be_none, result, strict=True)]
            return cast(_R, (named._make if named else tuple)(given))

        return called

    return known


def requires_gradient(*arguments: Any) -> bool:
    """Return whether any tensor among the arguments requires a gradient, or carries a tangent of forward mode, which an
    opaque op cannot provide.

    `torch.func.vmap` hides from its function that a tensor does, so that the mapped tensor is asked too.
    """
    levels = _levels(arguments)
    if torch.is_grad_enabled() and any(level.requires_grad for level in levels):
        return True
    return any(torch.autograd.forward_ad.unpack_dual(level).tangent is not None for level in levels)


def _levels(arguments: tuple[Any, ...]) -> list[Tensor]:
    """Return the tensors among the arguments and, in turn, those that they wrap, one for each transform of `torch.func`
    (such as vmap or grad) around a function.
    """
    levels = [one for one in arguments if isinstance(one, Tensor)]
    if not torch.compiler.is_compiling() and torch._C._are_functorch_transforms_active():
        for level in levels:
            if torch._C._functorch.is_functorch_wrapped_tensor(level):
                levels.append(torch._C._functorch.get_unwrapped(level))
    return levels


def _into_batch(argument: Any, dim: int | None, size: int) -> Any:
    """Return a tensor (B, ...) whose axis `dim` is mapped by `torch.func.vmap` (None: the same tensor for all) as a
    batch (`size` B, ...).
    """
    if not isinstance(argument, Tensor):
        return argument
    mapped = argument.expand(size, *argument.shape) if dim is None else argument.movedim(dim, 0)
    return mapped.flatten(0, 1)


def _parts(kind: Any) -> tuple[Any, ...]:
    """Return the element types of a tuple type or named tuple type."""
    named = _named(kind)
    return get_args(kind) if named is None else tuple(_of_tensors(part) for part in get_type_hints(named).values())


def _named(kind: Any) -> Any:
    """Return the class of named tuples that a return annotation stands for, or None if it stands for none."""
    named = get_origin(kind) or kind
    return named if hasattr(named, "_fields") else None


def _of_tensors(annotation: Any) -> Any:
    """Return a type annotation with `Tensor` in place of type variables."""
    if isinstance(annotation, TypeVar):
        return Tensor
    return annotation[Tensor] if getattr(annotation, "__parameters__", ()) else annotation


def _schema(function: Callable[..., Any], parts: int) -> str:
    def described(*args: Any, **kwargs: Any) -> Any:
        raise NotImplementedError

    signature = inspect.signature(function)
    tensors: Any = Tensor if parts == 1 else tuple[(Tensor,) * parts]  # type: ignore[misc]
    given = [one.replace(annotation=_of_tensors(one.annotation)) for one in signature.parameters.values()]
    described.__signature__ = signature.replace(parameters=given, return_annotation=tensors)  # type: ignore[attr-defined]
    return torch.library.infer_schema(described, mutates_args=())
