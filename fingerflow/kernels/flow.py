"""Kernels of dense flow."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, Generic, NamedTuple

import numpy as np

from fingerflow.kernels.arrays import Array, address, empty, in_one_piece
from fingerflow.kernels.checks import check_frames, check_like
from fingerflow.kernels.library import entry, threads, values_are_known

__all__ = [
    "flow_at_pixels",
    "flow_covariance",
    "flow_descend",
    "flow_integrate",
    "flow_left",
    "flow_levels",
    "flow_template",
    "flow_to_cells",
    "flow_to_pixels",
    "flow_warp",
    "level_shapes",
]

# Channels of tensor, right, down, inverse and inside, and their rows and columns relative to those of the level.
_PLANES = ((3, 0, 0), (1, 0, -1), (1, -1, 0), (3, 0, 0), (1, 0, 0))


class FlowFields(NamedTuple, Generic[Array]):
    """Fields of the first image that dense flow needs."""

    value: Array  # (B, 1, H, W) spline at the pixels
    gradient: Array  # (B, 2, H, W), 0 outside the mask
    inside: Array  # (B, 1, H, W), 1 in the mask, else 0
    tensor: Array  # (B, 3, h, w) means over cells of the products of slopes
    known: Array  # (B, 1, h, w), 1 for cells with a pixel in the mask, else 0
    right: Array  # (B, 1, h, w - 1) edges to the next cell of the row
    down: Array  # (B, 1, h - 1, w) and of the column


class Left(NamedTuple, Generic[Array]):
    """Residual that a flow leaves unexplained, on cells (B, ., h, w)."""

    data: Array  # (B, 2, h, w)
    squares: Array  # (B, 1, h, w)
    seen: Array  # (B, 1, h, w)
    gain: Array  # (B, 1, 1, 1)


class AtPixels(NamedTuple, Generic[Array]):
    """Displacement, covariance and residual of every pixel."""

    displacement: Array  # (B, 2, H, W)
    covariance: Array  # (B, 2, 2, H, W)
    residual: Array  # (B, 1, H, W)


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
    """Return the flow (B, 2, H, W) after multigrid cycles, as `ops.flow.flow_descent.descended` to rounding.

    `planes` are five for each level, the finest first: tensor, right, down, inverse, inside, all float32. `weights` are
    those of the window for the trend of the flow.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    batch, _, height, width = pull.shape
    check_like("pull", pull, "float32", (batch, 2, height, width))
    check_like("flow", flow, "float32", (batch, 2, height, width))
    check_like("known", known, "float32", (batch, 1, height, width))
    if not planes or len(planes) % len(_PLANES):
        raise ValueError(f"{len(planes)} planes: there are {len(_PLANES)} of each level")
    numbers: list[int] = []
    kept: list[Array] = []
    for shapes in level_shapes(batch, height, width, len(planes) // len(_PLANES)):
        first = len(kept)
        for plane, shape in zip(planes[first:], shapes, strict=False):
            check_like("a level", plane, "float32", shape)
            kept.append(in_one_piece(plane))
        if values_are_known():
            numbers += [*(address(plane) for plane in kept[first:]), *shapes[0][2:]]
    moved = empty(pull, "float32", *flow.shape)
    levels = np.array(numbers, np.int64)  # fingerflow_flow_level, one after the other
    entry("flow_descend")(
        levels=levels,
        pull=in_one_piece(pull),
        flow=in_one_piece(flow),
        known=in_one_piece(known),
        moved=moved,
        count=len(planes) // len(_PLANES),
        batch=batch,
        cycles=cycles,
        sweeps=sweeps,
        coarsest=coarsest,
        damping=damping,
        threads=threads(),
        **_window(weights),
    )
    return moved


def flow_levels(tensor: Array, right: Array, down: Array, inside: Array, count: int) -> Array:
    """Compute the levels of `ops.flow.flow_multigrid.pyramid` from the finest one, to rounding, as one array (N,).

    It holds the inverse of the finest level (B, 3, H, W), then tensor, right, down, inverse and inside of each coarser
    one, concatenated.

    Args:
        tensor, right, down, inside: float32 (B, 3, H, W), (B, 1, H, W - 1), (B, 1, H - 1, W) and (B, 1, H, W).
        count: number of levels, at least 1.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(inside, ("float32",))
    batch, _, height, width = inside.shape
    given = [in_one_piece(one) for one in (tensor, right, down, inside)]
    shapes = level_shapes(batch, height, width, count)
    for name, one, shape in zip(
        ("tensor", "right", "down", "inside"), given, (*shapes[0][:3], shapes[0][4]), strict=True
    ):
        check_like(name, one, "float32", shape)
    made = [shapes[0][3], *(shape for level in shapes[1:] for shape in level)]
    planes = empty(tensor, "float32", sum(math.prod(shape) for shape in made))
    numbers: list[int] = []
    if values_are_known():
        at = iter(itertools.accumulate((4 * math.prod(shape) for shape in made), initial=address(planes)))
        first = [address(one) for one in given]
        numbers += [*first[:3], next(at), first[3], height, width]
        for level in shapes[1:]:
            numbers += [*(next(at) for _ in level), *level[0][2:]]
    levels = np.array(numbers, np.int64)  # fingerflow_flow_level_to, one after the other
    entry("flow_levels")(levels=levels, count=count, batch=batch, threads=threads())
    return planes


def level_shapes(batch: int, height: int, width: int, count: int) -> list[list[tuple[int, ...]]]:
    """Return the shapes of tensor, right, down, inverse and inside of `count` levels, the finest (height, width)."""
    levels: list[list[tuple[int, ...]]] = []
    for _ in range(count):
        levels.append([(batch, channels, height + rows, width + columns) for channels, rows, columns in _PLANES])
        height, width = (height + 1) // 2, (width + 1) // 2
    return levels


def flow_covariance(tensor: Array, density: Array, alpha: Array, textured: Array, rho_square: float) -> Array:
    """Return the covariance of the flow (B, 3, H, W), as `ops.flow.flow_covariance`, with exponentials to 2e-7.

    `tensor` is (B, 3, H, W). `density` of the noise, `alpha`, and `textured`, the eigenvalue above which texture is
    known, are (B,), one for each image. All are float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    batch, _, height, width = tensor.shape
    check_like("tensor", tensor, "float32", (batch, 3, height, width))
    for name, one in (("density", density), ("alpha", alpha), ("textured", textured)):
        check_like(name, one, "float32", (batch,))
    covariance = empty(tensor, "float32", *tensor.shape)
    entry("flow_covariance")(
        tensor=in_one_piece(tensor),
        density=in_one_piece(density),
        alpha=in_one_piece(alpha),
        textured=in_one_piece(textured),
        rho_square=rho_square,
        covariance=covariance,
        batch=batch,
        height=height,
        width=width,
        threads=threads(),
    )
    return covariance


def flow_template(coefficients: Array, mask: Array, margin: int) -> FlowFields[Array]:
    """Return the fields of the first image, as `ops.flow.dense_flow`.

    Spline coefficients and mask are (B, 1, H, W) float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(coefficients, ("float32",))
    batch, _, height, width = coefficients.shape
    check_like("mask", mask, "float32", coefficients.shape)
    rows, columns = (height + 1) // 2, (width + 1) // 2
    sizes = ((1, height, width), (2, height, width), (1, height, width))
    of_cells = ((3, rows, columns), (1, rows, columns), (1, rows, columns - 1), (1, rows - 1, columns))
    fields = FlowFields(*(empty(coefficients, "float32", batch, *size) for size in (*sizes, *of_cells)))
    entry("flow_template")(
        coefficients=in_one_piece(coefficients),
        mask=in_one_piece(mask),
        **fields._asdict(),
        batch=batch,
        height=height,
        width=width,
        margin=margin,
        threads=threads(),
    )
    return fields


def flow_left(
    coefficients: Array,
    value: Array,
    gradient: Array,
    inside: Array,
    flow: Array,
    known: Array,
    margin: float,
    most_gain: float,
) -> Left[Array]:
    """Return the residual of a flow, as `ops.flow.dense_flow`.

    `coefficients`, `value`, `inside` (B, 1, H, W) and `gradient` (B, 2, H, W) are those of images; `flow` and `known`
    (B, ., h, w) lie on cells. All are float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(coefficients, ("float32",))
    batch, _, height, width = coefficients.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    for name, one, shape in (
        ("value", value, (1, height, width)),
        ("gradient", gradient, (2, height, width)),
        ("inside", inside, (1, height, width)),
        ("flow", flow, (2, rows, columns)),
        ("known", known, (1, rows, columns)),
    ):
        check_like(name, one, "float32", (batch, *shape))
    cells = (rows, columns)
    left = Left(
        data=empty(coefficients, "float32", batch, 2, *cells),
        squares=empty(coefficients, "float32", batch, 1, *cells),
        seen=empty(coefficients, "float32", batch, 1, *cells),
        gain=empty(coefficients, "float32", batch, 1, 1, 1),
    )
    entry("flow_left")(
        coefficients=in_one_piece(coefficients),
        value=in_one_piece(value),
        gradient=in_one_piece(gradient),
        inside=in_one_piece(inside),
        flow=in_one_piece(flow),
        known=in_one_piece(known),
        **left._asdict(),
        batch=batch,
        height=height,
        width=width,
        margin=margin,
        most_gain=most_gain,
        threads=threads(),
    )
    return left


def flow_integrate(fields: Array, weights: Sequence[float]) -> Array:
    """Return weighted means (B, C, H, W) along rows and columns of float32 fields, which are 0 beyond the border.

    `weights` are an odd number, symmetric about the middle.

    Raises:
        TypeError, ValueError: wrong dtype or shape.
    """
    batch, channels, height, width = fields.shape
    check_like("fields", fields, "float32", (batch, channels, height, width))
    integrated = empty(fields, "float32", *fields.shape)
    entry("flow_integrate")(
        fields=in_one_piece(fields),
        integrated=integrated,
        count=batch * channels,
        height=height,
        width=width,
        threads=threads(),
        **_window(weights),
    )
    return integrated


def flow_to_cells(fields: Array, inside: Array) -> Array:
    """Return means (B, 2, h, w) over cells of 2 x 2 px of float32 fields (B, 2, H, W) inside a mask (B, 1, H, W).

    Values that are not finite are left out.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(inside, ("float32",))
    batch, _, height, width = inside.shape
    check_like("fields", fields, "float32", (batch, 2, height, width))
    means = empty(fields, "float32", batch, 2, (height + 1) // 2, (width + 1) // 2)
    entry("flow_to_cells")(
        fields=in_one_piece(fields),
        inside=in_one_piece(inside),
        means=means,
        batch=batch,
        height=height,
        width=width,
        threads=threads(),
    )
    return means


def flow_to_pixels(flow: Array, known: Array, height: int, width: int) -> Array:
    """Interpolate a flow on cells (B, ., h, w) to pixels (B, 2, height, width), as `ops.flow.flow_cells.to_pixels`.

    The results agree to rounding. All are float32.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(known, ("float32",))
    batch, cells = known.shape[0], ((height + 1) // 2, (width + 1) // 2)
    check_like("known", known, "float32", (batch, 1, *cells))
    check_like("flow", flow, "float32", (batch, 2, *cells))
    pixels = empty(flow, "float32", batch, 2, height, width)
    entry("flow_to_pixels")(
        flow=in_one_piece(flow),
        known=in_one_piece(known),
        pixels=pixels,
        batch=batch,
        height=height,
        width=width,
        threads=threads(),
    )
    return pixels


def flow_at_pixels(flow: Array, others: Array, known: Array, inside: Array) -> AtPixels[Array]:
    """Return the results at the pixels `inside` (B, 1, H, W) from those on cells (B, ., h, w), all float32.

    On cells are `flow`, `others`, which holds covariance (xx, xy, yy) and residual, and `known`, where they are known.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(inside, ("float32",))
    batch, _, height, width = inside.shape
    for name, one, channels in (("flow", flow, 2), ("others", others, 4), ("known", known, 1)):
        check_like(name, one, "float32", (batch, channels, (height + 1) // 2, (width + 1) // 2))
    result = AtPixels(*(empty(flow, "float32", batch, *sizes, height, width) for sizes in ((2,), (2, 2), (1,))))
    entry("flow_at_pixels")(
        flow=in_one_piece(flow),
        others=in_one_piece(others),
        known=in_one_piece(known),
        inside=in_one_piece(inside),
        **result._asdict(),
        batch=batch,
        height=height,
        width=width,
        threads=threads(),
    )
    return result


def _window(weights: Sequence[float]) -> dict[str, Any]:
    """Return the middle weight with those after it, and the number of the latter."""
    half = len(weights) // 2
    return {"weights": np.array(weights[half:], np.float32), "half": half}


def flow_warp(coefficients: Array, flow: Array) -> Array:
    """Return the values (B, 1, H, W) of a spline at pixels displaced by a finite flow (B, 2, H, W), all float32.

    `coefficients` of the spline are (B, 1, H, W).

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(coefficients, ("float32",))
    batch, _, height, width = coefficients.shape
    check_like("flow", flow, "float32", (batch, 2, height, width))
    values = empty(coefficients, "float32", *coefficients.shape)
    entry("flow_warp")(
        coefficients=in_one_piece(coefficients),
        flow=in_one_piece(flow),
        values=values,
        batch=batch,
        height=height,
        width=width,
        threads=threads(),
    )
    return values
