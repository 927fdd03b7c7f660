"""Kernels of dense optical flow on float32 arrays; all raise ValueError for a wrong dtype or shape."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import Array, address, empty
from fingerflow.kernels.checks import checked
from fingerflow.kernels.library import entry, threads, values_are_known

__all__ = [
    "flow_descend",
    "flow_left",
    "flow_template",
]

# Channels of tensor, right, down, inverse and inside; then their numbers of rows and columns minus those of the level.
_PLANES = ((3, 0, 0), (1, 0, -1), (1, -1, 0), (3, 0, 0), (1, 0, 0))


class FlowFields(NamedTuple, Generic[Array]):
    """Fields computed from the first of two images, as needed for the dense optical flow between them."""

    value: Array  # (B, 1, H, W) spline of the image, at the pixels
    gradient: Array  # (B, 2, H, W) slopes of the spline, 0 outside the mask
    inside: Array  # (B, 1, H, W), 1 in the mask, else 0
    tensor: Array  # (B, 3, h, w) means over cells of the products of slopes, xx, xy, yy
    known: Array  # (B, 1, h, w), 1 for cells with a pixel in the mask, else 0
    right: Array  # (B, 1, h, w - 1) weights of the edges to the next cell of the row
    down: Array  # (B, 1, h - 1, w) weights of the edges to the next cell of the column


class FlowResidual(NamedTuple, Generic[Array]):
    """Residual of a flow: means, over cells of 2 x 2 px, of the part of the image difference that displacement and
    illumination do not explain.
    """

    data: Array  # (B, 2, h, w) products of residual and slopes
    squares: Array  # (B, 1, h, w) squared residuals
    seen: Array  # (B, 1, h, w) share of the cell's pixels with a residual
    gain: Array  # (B, 1, 1, 1) illumination gain


def _run_kernel(
    name: str, given: Mapping[str, tuple[Array, tuple[int, ...]]], made: Mapping[str, tuple[int, ...]], **others: Any
) -> list[Array]:
    """Check float32 arrays, run a kernel on them, and return its results as new float32 arrays.

    Args:
        name: of the kernel.
        given: arrays by the names of arguments, each with the shape that it must have.
        made: shapes of the results by the names of arguments.
        others: the other arguments, except the number of threads.

    Raises:
        ValueError: an array has another dtype or shape.
    """
    arrays = {argument: checked(argument, array, "float32", shape) for argument, (array, shape) in given.items()}
    like = next(iter(arrays.values()))
    results = {argument: empty(like, "float32", *shape) for argument, shape in made.items()}
    entry(name)(**arrays, **results, **others, threads=threads())
    return list(results.values())


def _sizes(image: Array) -> tuple[dict[str, int], tuple[int, int], tuple[int, int]]:
    """Return the size arguments of a kernel for images (B, 1, H, W), the size (H, W), and that of the grid of cells of
    2 x 2 px.
    """
    batch, _, height, width = image.shape
    return {"batch": batch, "height": height, "width": width}, (height, width), _cells(height, width)


def _cells(height: int, width: int) -> tuple[int, int]:
    return (height + 1) // 2, (width + 1) // 2


def _window(weights: Sequence[float]) -> dict[str, Any]:
    """Return half of the weights of a symmetric window, for a kernel; raise ValueError if it is asymmetric."""
    if len(weights) % 2 == 0 or any(one != other for one, other in zip(weights, reversed(weights), strict=True)):
        raise ValueError(f"weights {list(weights)}: give an odd number, the same before the middle as after it")
    half = len(weights) // 2
    return {"weights": np.array(weights[half:], np.float32), "half": half}


def _level_shapes(batch: int, height: int, width: int, count: int) -> list[list[tuple[int, ...]]]:
    """Return the shapes of the five arrays of each of `count` multigrid levels; the finest has height x width cells.

    The arrays (planes) are tensor, right, down, inverse and inside.
    """
    levels: list[list[tuple[int, ...]]] = []
    for _ in range(count):
        levels.append([(batch, channels, height + rows, width + columns) for channels, rows, columns in _PLANES])
        height, width = _cells(height, width)
    return levels


def _levels(addresses: Sequence[int], shapes: list[list[tuple[int, ...]]]) -> NDArray[np.int64]:
    """Pack the memory addresses of the arrays (planes) of all multigrid levels, and the sizes of the levels, into an
    array of the C structure `fingerflow_flow_level`.
    """
    planes = np.array(addresses, np.int64).reshape(len(shapes), len(_PLANES))
    return np.hstack((planes, np.array([level[0][2:] for level in shapes], np.int64)))


def flow_descend(
    planes: Sequence[Array],
    pull: Array,
    flow: Array,
    known: Array,
    weights: Sequence[float],
    cycles: int,
    sweeps: int,
    coarsest: int,
    damping: float,
) -> Array:
    """Improve a dense optical flow (B, 2, H, W) by multigrid cycles on the linear system whose levels are `planes`, as
    `ops.flow.flow_multigrid.descended` up to rounding.

    `planes` are five for each level, the finest first: tensor, right, down, inverse, inside. `weights` are
    those of the window for the trend of the flow.
    """
    batch, _, height, width = pull.shape
    if not planes or len(planes) % len(_PLANES):
        raise ValueError(f"{len(planes)} planes: there are {len(_PLANES)} of each level")
    shapes = _level_shapes(batch, height, width, len(planes) // len(_PLANES))
    kept = [
        checked("a level", plane, "float32", shape)
        for plane, shape in zip(planes, itertools.chain.from_iterable(shapes), strict=True)
    ]
    addresses = [address(plane) if values_are_known() else 0 for plane in kept]
    [moved] = _run_kernel(
        "flow_descend",
        {
            "pull": (pull, (batch, 2, height, width)),
            "flow": (flow, (batch, 2, height, width)),
            "known": (known, (batch, 1, height, width)),
        },
        {"moved": (batch, 2, height, width)},
        levels=_levels(addresses, shapes),
        count=len(shapes),
        batch=batch,
        cycles=cycles,
        sweeps=sweeps,
        coarsest=coarsest,
        damping=damping,
        **_window(weights),
    )
    return moved


def flow_template(coefficients: Array, mask: Array, margin: int) -> FlowFields[Array]:
    """Compute the fields of the first image that dense flow needs (values, gradients, structure tensor, edges between
    cells) from its spline coefficients and a mask, as `ops.flow.dense_flow`.

    Spline coefficients and mask are (B, 1, H, W).
    """
    sizes, size, (rows, columns) = _sizes(coefficients)
    batch = sizes["batch"]
    fields = _run_kernel(
        "flow_template",
        {"coefficients": (coefficients, (batch, 1, *size)), "mask": (mask, (batch, 1, *size))},
        {
            "value": (batch, 1, *size),
            "gradient": (batch, 2, *size),
            "inside": (batch, 1, *size),
            "tensor": (batch, 3, rows, columns),
            "known": (batch, 1, rows, columns),
            "right": (batch, 1, rows, columns - 1),
            "down": (batch, 1, rows - 1, columns),
        },
        margin=margin,
        **sizes,
    )
    return FlowFields(*fields)


def flow_left(
    coefficients: Array,
    value: Array,
    gradient: Array,
    inside: Array,
    flow: Array,
    known: Array,
    margin: float,
    most_gain: float,
) -> FlowResidual[Array]:
    """Compute the residual of a flow, what displacement and illumination leave of the difference of two images,
    averaged over cells, as `ops.flow.dense_flow`.

    `coefficients`, `value`, `inside` (B, 1, H, W) and `gradient` (B, 2, H, W) are those of images; `flow` and `known`
    (B, ., h, w) lie on cells.
    """
    sizes, size, cells = _sizes(coefficients)
    batch = sizes["batch"]
    left = _run_kernel(
        "flow_left",
        {
            "coefficients": (coefficients, (batch, 1, *size)),
            "value": (value, (batch, 1, *size)),
            "gradient": (gradient, (batch, 2, *size)),
            "inside": (inside, (batch, 1, *size)),
            "flow": (flow, (batch, 2, *cells)),
            "known": (known, (batch, 1, *cells)),
        },
        {
            "data": (batch, 2, *cells),
            "squares": (batch, 1, *cells),
            "seen": (batch, 1, *cells),
            "gain": (batch, 1, 1, 1),
        },
        margin=margin,
        most_gain=most_gain,
        **sizes,
    )
    return FlowResidual(*left)
