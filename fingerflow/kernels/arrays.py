"""Array operations that work on NumPy arrays and on torch tensors, without importing torch."""

import ctypes
import sys
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray


class Shaped(Protocol):
    """Common interface of NumPy arrays and torch tensors."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def ndim(self) -> int: ...
    @property
    def dtype(self) -> Any: ...


#: NumPy arrays or torch tensors: a function returns the type that it is given.
Array = TypeVar("Array", bound=Shaped)


class _DtypeNames(dict[Any, str]):
    """Cache of the names of NumPy's and torch's dtypes, such as "float32"."""

    def __missing__(self, dtype: Any) -> str:
        self[dtype] = str(dtype).removeprefix("torch.")
        return self[dtype]


KINDS = _DtypeNames()


def empty(like: Any, dtype: str, shape: tuple[int, ...]) -> Any:
    """Return an uninitialised tensor on the device of the tensor `like`."""
    return like.new_empty(shape, dtype=getattr(sys.modules["torch"], dtype))


def in_one_piece(array: Any) -> Any:
    """Return an array unchanged if it is contiguous (and, in NumPy, aligned), else a contiguous copy.

    The numbers of a view that torch negates lazily, such as the imaginary part of a conjugate, are written out.
    """
    if not isinstance(array, np.ndarray):
        return array.resolve_neg().contiguous()
    return array if array.flags.c_contiguous and array.flags.aligned else array.copy()


def copied(array: Any) -> Any:
    """Return a contiguous copy of an array."""
    if isinstance(array, np.ndarray):
        return array.copy()
    return array.resolve_neg().clone(memory_format=sys.modules["torch"].contiguous_format)


def with_axes_reversed(array: Array, dtype: str) -> Array:
    """Return a contiguous copy of an array with its axes reversed, converted to a dtype."""
    array_or_tensor: Any = array
    if isinstance(array, np.ndarray):
        return cast(Array, array.T.astype(dtype, order="C"))
    reversed_axes = array_or_tensor.resolve_neg().permute(*range(array.ndim - 1, -1, -1))
    return cast(Array, reversed_axes.to(getattr(sys.modules["torch"], dtype)).contiguous())


def rows_in_one_piece(images: Any) -> tuple[Any, int, int]:
    """Return images (B, 1, H, W), copied unless the pixels of each row are contiguous, and the distances in memory, in
    pixels, from one image to the next and from one row to the next.
    """
    if not isinstance(images, np.ndarray):
        images = images.resolve_neg()
        if images.stride(3) != 1 and images.shape[3] != 1:
            images = images.contiguous()
        return images, images.stride(0), images.stride(2)
    size, strides = images.itemsize, images.strides
    if not images.flags.c_contiguous or not images.flags.aligned:
        neighbours = strides[3] == size or images.shape[3] == 1
        whole = images.flags.aligned and all(stride >= 0 and stride % size == 0 for stride in strides)
        images = images if neighbours and whole else images.copy()
        strides = images.strides
    return images, strides[0] // size, strides[2] // size


def limits_of(array: Any) -> tuple[int, int]:
    """Return the minimum and the maximum of a non-empty array of integers."""
    if isinstance(array, np.ndarray):
        return int(np.minimum.reduce(array, axis=None)), int(np.maximum.reduce(array, axis=None))
    # The minimum of uint16 is not implemented in torch.
    least, greatest = (array.int() if KINDS[array.dtype] == "uint16" else array).aminmax()
    return int(least), int(greatest)


def address(array: Any) -> int:
    """Return the memory address of the first element of an array; raise ValueError for a tensor not on the CPU."""
    if isinstance(array, np.ndarray):
        return array.__array_interface__["data"][0]
    if not array.is_cpu:
        raise ValueError(f"a tensor is on {array.device}: give tensors on the CPU")
    return array.data_ptr()


def _data_offset() -> int:
    """Return where the C structure of a NumPy array has the address of its data, which reads in 0.1 us in place of 0.9;
    0 if it lies elsewhere.
    """
    offset, example = object.__basicsize__, np.zeros(3)
    known = sys.implementation.name == "cpython" and all(
        ctypes.c_size_t.from_address(id(array) + offset).value == address(array) for array in (example, example[1:])
    )
    return offset if known else 0


DATA_OFFSET = _data_offset()


def inverse_2x2(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the inverses (..., 2, 2) of 2 x 2 NumPy matrices; not finite for a singular matrix."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    result = np.empty(matrix.shape, matrix.dtype)
    result[..., 0, 0], result[..., 0, 1], result[..., 1, 0], result[..., 1, 1] = d, -b, -c, a
    determinant = (a * d - b * c)[..., None, None]
    determinant[determinant == 0] = np.nan
    result /= determinant
    return result


def squared_distances(points: NDArray[Any], others: NDArray[Any]) -> NDArray[Any]:
    """Return the squared distances (N, M) of points (N, 2) from other points (M, 2).

    Sums over an axis of two take NumPy five times as long.
    """
    x, y = (points[:, k, None] - others[:, k] for k in range(2))
    return x * x + y * y


def nanmedian(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the medians (F, ...) over N points of values (F, N, ...), ignoring NaN; NaN where no value is finite."""
    if values.shape[1] == 0:
        return np.full((len(values), *values.shape[2:]), np.nan)
    # Make the sorted axis contiguous: sorting and counting are then twice as fast.
    ordered = np.array(values.transpose(0, *range(2, values.ndim), 1), order="C")
    ordered.sort(axis=-1)  # NaN last
    count = np.add.reduce(~np.isnan(ordered), -1)
    first, flat = np.arange(0, ordered.size, ordered.shape[-1]).reshape(count.shape), ordered.ravel()
    last = len(flat) - 1  # upper bound of the index, which may lie beyond the end where all values are NaN
    low, high = (flat[np.minimum(first + rank, last)] for rank in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.where(count > 0, (low + high) / 2, np.nan).astype(np.float64)


def is_finite(points: NDArray[Any]) -> NDArray[Any]:
    """Return a mask (...) of the points (..., 2) whose two components are finite."""
    return np.isfinite(points[..., 0] + points[..., 1])


def identities(*counts: int) -> NDArray[np.float32]:
    """Return read-only identity matrices (*counts, 2, 2)."""
    return np.broadcast_to(np.eye(2, dtype=np.float32), (*counts, 2, 2))
