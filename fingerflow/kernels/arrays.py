"""What kernels need of an array, whether it is NumPy's or a tensor of torch's, which is never imported for it."""

import ctypes
import sys
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray


class Shaped(Protocol):
    """What NumPy arrays and tensors of torch have in common."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def ndim(self) -> int: ...
    @property
    def dtype(self) -> Any: ...


#: Arrays of one kind: a function gives results of the kind of its arguments, NumPy's or torch's.
Array = TypeVar("Array", bound=Shaped)


class _Kinds(dict[Any, str]):
    """Names by dtype, of NumPy or of torch."""

    def __missing__(self, dtype: Any) -> str:
        self[dtype] = str(dtype).removeprefix("torch.")
        return self[dtype]


KINDS = _Kinds()


def kind(array: Shaped) -> str:
    """Return the name of the numbers of an array: "uint8", "float32", "bool"; that of foreign byte order differs."""
    return KINDS[array.dtype]


def empty(like: Array, kind: str, *shape: int) -> Array:
    """Return an array of the kind of `like`, for results; the defaults of torch do not touch it."""
    given: Any = like
    if isinstance(given, np.ndarray):
        made: Any = np.empty(shape, kind)
    else:
        made = given.new_empty(shape, dtype=getattr(sys.modules["torch"], kind))
    return made  # type: ignore[no-any-return]


def zeros(like: Array, kind: str, *shape: int) -> Array:
    """Return zeros of the kind of `like`."""
    given: Any = like
    if isinstance(given, np.ndarray):
        made: Any = np.zeros(shape, kind)
    else:
        made = given.new_zeros(shape, dtype=getattr(sys.modules["torch"], kind))
    return made  # type: ignore[no-any-return]


def in_one_piece(array: Array) -> Array:
    """Return the array itself where its numbers follow one another in memory, else a copy."""
    given: Any = array
    if not isinstance(given, np.ndarray):
        return given.contiguous()  # type: ignore[no-any-return]
    whole = given.flags.c_contiguous and given.flags.aligned
    return array if whole else cast(Array, given.copy())


def copied(array: Array) -> Array:
    """Return a copy in one piece."""
    given: Any = array
    if isinstance(given, np.ndarray):
        return cast(Array, given.copy())
    return given.clone(memory_format=sys.modules["torch"].contiguous_format)  # type: ignore[no-any-return]


def with_axes_reversed(array: Array, kind: str) -> Array:
    """Return a copy in one piece, last axis first, of numbers of another kind."""
    given: Any = array
    if isinstance(given, np.ndarray):
        return cast(Array, given.T.astype(kind, order="C"))
    axes = range(given.ndim - 1, -1, -1)
    return given.permute(*axes).to(getattr(sys.modules["torch"], kind)).contiguous()  # type: ignore[no-any-return]


def may_be_written(array: Shaped) -> bool:
    """Return whether results can be written to the array as it is: in one piece, and not protected."""
    given: Any = array
    return bool(given.flags.carray if isinstance(given, np.ndarray) else given.is_contiguous())


def rows_in_one_piece(frames: Array) -> Array:
    """Return frames (B, 1, H, W) themselves where pixels of a row are neighbours in memory, else a copy."""
    given: Any = frames
    if not isinstance(given, np.ndarray):
        one_piece = given.stride(3) == 1 or given.shape[3] == 1
        return frames if one_piece else given.contiguous()
    if given.flags.c_contiguous and given.flags.aligned:
        return frames
    size = given.itemsize
    neighbours = given.strides[3] == size or given.shape[3] == 1
    whole = given.flags.aligned and all(stride >= 0 and stride % size == 0 for stride in given.strides)
    return frames if neighbours and whole else cast(Array, given.copy())


def strides_of_rows(frames: Shaped) -> tuple[int, int]:
    """Return the strides of a frame and of a row of (B, 1, H, W), in pixels."""
    given: Any = frames
    if isinstance(given, np.ndarray):
        frame, _, row, _ = given.strides
        return frame // given.itemsize, row // given.itemsize
    frame, _, row, _ = given.stride()
    return frame, row


def range_of(array: Shaped) -> tuple[int, int]:
    """Return the least and the greatest number of an array of integers that is not empty."""
    given: Any = array
    if isinstance(given, np.ndarray):
        return int(given.min()), int(given.max())
    # torch orders no uint16.
    least, greatest = (given.int() if kind(array) == "uint16" else given).aminmax()
    return int(least), int(greatest)


def address(array: Shaped) -> int:
    """Return where an array begins in memory."""
    given: Any = array
    return address_of_numpy(given) if isinstance(given, np.ndarray) else given.data_ptr()


def _by_interface(array: NDArray[Any]) -> int:
    return array.__array_interface__["data"][0]  # type: ignore[no-any-return]


def _by_layout(array: NDArray[Any]) -> int:
    """Read the address from the object itself, behind the head that all objects have: 0.1 us in place of 0.9."""
    return ctypes.c_size_t.from_address(id(array) + object.__basicsize__).value


def _layout_is_known() -> bool:
    """Return whether addresses lie where NumPy's C interface has them, in CPython."""
    example = np.zeros(3)
    return sys.implementation.name == "cpython" and all(
        _by_layout(one) == _by_interface(one) for one in (example, example[1:])
    )


address_of_numpy = _by_layout if _layout_is_known() else _by_interface


def inverse_2x2(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the inverses (..., 2, 2) of matrices of NumPy; not finite where they are singular."""
    a, b, c, d = (matrix[..., row, column] for row in range(2) for column in range(2))
    with np.errstate(divide="ignore", invalid="ignore"):
        result: NDArray[Any] = np.stack((d, -b, -c, a), -1).reshape(matrix.shape) / (a * d - b * c)[..., None, None]
    return result
