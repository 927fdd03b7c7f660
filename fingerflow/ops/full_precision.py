"""Protection of ops and modules from `torch.autocast`, which would round their sums to half precision."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

_P = ParamSpec("_P")
_R = TypeVar("_R")


def without_autocast(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function with `torch.autocast` switched off in it: results are those of the dtypes of its inputs.

    Derivatives, where `backward` is called outside autocast as torch demands, are too.
    """

    @wraps(function)
    def called(*arguments: _P.args, **options: _P.kwargs) -> _R:
        for device in ("cpu", "cuda", "mps", "xpu"):
            if torch.is_autocast_enabled(device):
                with torch.autocast(device, enabled=False):
                    return called(*arguments, **options)
        return function(*arguments, **options)

    return called
