"""Arrays, and the tensors that graphs read and write."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.player.errors import PlayerError

Array = NDArray[Any]
_NUMPY = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(uint16)": np.uint16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


class Tensor(NamedTuple):
    """Name, shape and type of an input or output; a batch that is free is 1."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, argument: Any, path: Path) -> Tensor:
        """Of an input or output of a session; raises PlayerError where its sizes are not fixed."""
        shape = [1 if place == 0 and not isinstance(size, int) else size for place, size in enumerate(argument.shape)]
        if not all(isinstance(size, int) for size in shape) or argument.type not in _NUMPY:
            raise PlayerError(
                f"{path}: {argument.name} is {argument.type} {argument.shape}; the player needs fixed sizes: export "
                "the bundle with them"
            )
        return cls(argument.name, tuple(shape), np.dtype(_NUMPY[argument.type]))
