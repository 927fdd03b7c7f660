"""Segmentation of the apparent (gross) contact: the region spanned by ridges in contact, with the gaps between them.

The method is of this package; docs/methods/contact.md states its accuracy. Compiled twin:
`kernels/apparent_contact.cpp`.
"""

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels import contact_sizes as sizes
from fingerflow.kernels.contact import CELLS
from fingerflow.kernels.contact_sizes import cell_of as cell_of
from fingerflow.kernels.result_records import FrameContact
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.checks import check_mask
from fingerflow.ops.contact.cells import cell_means, enlarge, largest_around
from fingerflow.ops.tensors import constant_like, half_angle, scalar_products

_compiled: Twin[tuple[Tensor, Tensor]] = twin("apparent_contact")
_PART = 32  # cells of a line smoothed by one matrix product


def apparent_contact(
    mask: Tensor, radius: int, cell: int | None = None, precision: torch.dtype = torch.float32
) -> FrameContact:
    """Segment the apparent (gross) contact, ridges and the gaps between them, from a mask of the pixels in contact: the
    border is where the locally averaged mask falls to about half of its mean just inside the border.

    Holes of the region are filled. The density is the mean of the mask over about two periods (three box means). At a
    straight border it falls to one half of the density inside, whatever the direction of the pattern. At a convex
    border it falls further; that level is measured on the region itself, smoothed in the same way.

    Ridges become thinner towards the rim, where the pressure is low: half of the density in the middle would leave
    out 4 % of a real print. The share that the pattern covers is therefore measured in two bands inside the border,
    1.5 and 3 boxes wide, and extrapolated: share = narrow (narrow / wide)^0.6, as for a share that approaches its
    value inside exponentially, over the width of a box. A contact without valleys has the same share everywhere.
    Region and shares depend on each other; a fixed number of rounds of a fixed-point iteration finds them.

    The density varies slowly over a box, so cells with a fourth of the box's side resolve it. A cell crossed by the
    border counts by the fraction inside, which follows from the slope of the density. A hole is filled where the region
    lies on all four sides of it. Components are separated on blocks of 8 cells. The cost is fixed, without
    data-dependent branches.

    Args:
        mask: (B, 1, H, W) bool.
        radius: px, half the period of the pattern or slightly more, 1 to 255. The boxes have the side 2 radius + 1; the
            mask counts as empty beyond the frame.
        cell: px; None derives it from the radius (`cell_of`). With cells of 8 px and a radius of 8 the error of the
            area is 0.6 % from 14 mm² on and 2 % at 7 mm² (at 32.5 um per pixel).
        precision: dtype of the sums on cells.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W), `radius` lies outside 1 to 255, or a cell is larger than the boxes.
    """
    check_mask(mask)
    if 0 in mask.shape[2:]:
        raise ValueError(f"the mask has shape {tuple(mask.shape)}: it has no pixel")
    if not 1 <= radius <= 255:
        raise ValueError(f"a radius of {radius} px: give 1 to 255")
    side = cell or cell_of(radius)
    if not 1 <= side <= 2 * radius + 1:
        raise ValueError(f"cells of {side} px: the boxes of a radius of {radius} px hold 1 to {2 * radius + 1}")
    if precision == torch.float32 and side in CELLS and _compiled.serves(mask):
        margin, numbers = _compiled(mask, radius, side)
        real, gross, center, axes = numbers[:, 0], numbers[:, 1], numbers[:, 2:4], numbers[:, 4:6]
        return FrameContact(mask, real, gross, center, axes, numbers[:, 6], margin)
    margin, real, gross, center, axes, angle = _region(cell_means(mask, side, precision), radius, side)
    return FrameContact(mask, real, gross, center, axes, angle, margin)


def _region(cells: Tensor, radius: int, side: int) -> tuple[Tensor, ...]:
    """Segment the apparent contact from the fraction of each cell (B, 1, h, w), `side` px wide, that the real contact
    mask covers, smoothed over boxes of 2 `radius` + 1 px.
    """
    width = (2 * radius + 1) / side
    boxes, *bands = _all_boxes(cells, width)
    density = _smooth(cells, boxes)
    flat = 1 / _slope(density)

    def inside(limit: Tensor | float) -> Tensor:
        """Return the fraction, 0 to 1, of each cell's area in which the smoothed contact density, taken as linear
        within the cell, exceeds `limit`.
        """
        return ((density - limit) * flat + 0.5).clamp(0.0, 1.0)

    def shares(limit: Tensor | float, weights: Tensor) -> Tensor:
        """Return the shares (B, 1, 1, n) of the region above the density `limit` that ridges (the real contact mask)
        cover, one for each of n sets of cell weights (B, n, h, w).
        """
        part = inside(limit)
        # The pattern in a border cell is taken to lie entirely in the part inside, as far as that can hold it.
        sums = scalar_products(torch.cat((torch.minimum(cells, part), part), dim=1).flatten(2), weights.flatten(2))
        return (sums[:, :1] / sums[:, 1:].clamp_min(1e-3)).clamp(sizes.LEAST_SHARE, 1.0)[:, None]

    alike = torch.ones_like(cells)
    limit: Tensor | float = 0.25
    for _ in range(sizes.FIRST_ROUNDS):
        inner = shares(limit, alike)
        limit = inner / 2
    solid = (inner - sizes.SOLID).clamp_min(0).sign()
    for _ in range(sizes.BORDERS):
        part = inside(limit)
        filled = _enclosed(_main_component(_above(density, limit), density))
        # The outer border: what lies beyond the frame, or in a hole, is no rim.
        border = part * (1 - part) * largest_around(filled) * largest_around(1 - filled)
        # At a convex border the smoothed region itself is below one half.
        border_mass = (_smooth(part, boxes) * border).sum((2, 3), keepdim=True)
        level = (border_mass / border.sum((2, 3), keepdim=True).clamp_min(1e-3)).clamp(0.25, 0.5)
        # Weights of cells fall off with the distance from the border, smoothed on blocks of 2 x 2 cells.
        halved = cell_means(border, 2, border.dtype)
        falling = (enlarge(_smooth(halved, band), 2)[..., : cells.shape[2], : cells.shape[3]] for band in bands)
        weights = torch.cat((*falling, alike), dim=1)
        for _ in range(sizes.ROUNDS):
            near, far, everywhere = shares(limit, weights).split(1, dim=3)
            rim = (near * (near / far) ** sizes.THINNING).clamp(sizes.LEAST_SHARE, 1.0)
            limit = (solid * everywhere + (1 - solid) * rim) * level
    part = inside(limit)
    whole = _above(density, limit)
    filled = _enclosed(_main_component(whole, density))
    # Border cells count by their fraction inside, including those just outside.
    near = largest_around(filled)
    hole = torch.clamp_min(filled - whole, 0)
    # Maxima and products are several times as fast as comparisons and `where`. They suffice because the density does
    # not exceed the limit in a hole and is non-negative elsewhere.
    coverage = torch.maximum(part * near, hole)
    density_margin = torch.maximum(density * near - limit, (2 * hole - 1) * limit)
    return density_margin, cells.sum((1, 2, 3)) * side**2, *_moments(coverage, side)


# Matrices that smooth the columns and the rows of an image on cells by three successive box means, and the distance in
# cells over which they spread a value.
_Boxes = tuple[Tensor, Tensor, int]


def _all_boxes(cells: Tensor, width: float) -> list[_Boxes]:
    """Return the smoothing matrices for images on cells (B, 1, h, w): that of boxes `width` cells wide, for the contact
    density, and those of a narrow and a wide band along the border, for blocks of 2 x 2 cells.
    """
    # A traced graph computes the matrices on its device; else they are cached.
    traced = torch.compiler.is_compiling()

    def matrix(side: int, wide: float) -> Tensor:
        if traced:
            return _smoothing_matrix(side, wide, cells.device).to(cells.dtype)
        return constant_like(_kept_boxes(side, wide, torch.device("cpu")), cells)

    def boxes(size: int, wide: float) -> _Boxes:
        down, along = (matrix(-(-side // size), wide) for side in cells.shape[-2:])
        return down, along, 3 * math.ceil(wide / 2)

    return [boxes(1, width), *(boxes(2, max(width * factor / 2, 1.0)) for factor in (sizes.NARROW, sizes.WIDE))]


def _smooth(cells: Tensor, boxes: _Boxes) -> Tensor:
    """Smooth values on cells by three successive box means in x and y; beyond the frame the values are 0."""
    down, along, reach = boxes
    if torch.compiler.is_exporting() or cells.device.type != "cpu":  # one large product is one launch
        return down @ cells @ along
    # The smoothing matrices are banded: each part of a line is multiplied only with the cells within reach.
    height, wide = cells.shape[-2:]
    of_rows = [down[rows_out, near] @ cells[..., near, :] for rows_out, near in _segments(height, reach)]
    rows = torch.cat(of_rows, dim=2)
    return torch.cat([rows[..., near] @ along[near, rows_out] for rows_out, near in _segments(wide, reach)], dim=3)


def _segments(side: int, reach: int) -> list[tuple[slice, slice]]:
    """Return pairs of slices of `side` cells: a segment, and the same segment widened by `reach` cells at both ends."""
    ends = [(first, min(first + _PART, side)) for first in range(0, side, _PART)]
    return [(slice(first, last), slice(max(first - reach, 0), last + reach)) for first, last in ends]


def _smoothing_matrix(side: int, width: float, device: torch.device) -> Tensor:
    """Return the matrix (side, side) that smooths a line of cells by three successive box means of `width` cells.

    The cells at the ends of a box have fractional weights.
    """
    index = torch.arange(side, dtype=torch.float64, device=device)
    box = ((width + 1) / 2 - (index[:, None] - index).abs()).clamp(0, 1) / width
    return box @ box @ box


_kept_boxes = functools.lru_cache(16)(_smoothing_matrix)


def _above(values: Tensor, limit: Tensor | float) -> Tensor:
    """Return 1 where `values` exceed `limit`, else 0, in the dtype of the values.

    The factor makes every difference of two densities larger than 1. Comparisons are slow in torch, and signs in ONNX
    runtimes.
    """
    return ((values - limit) * 2.0**100).clamp(0.0, 1.0)


def _slope(density: Tensor) -> Tensor:
    """Compute the slope of the density on cells: the magnitude of the gradient, at least 1e-6.

    Differences are central; beyond the frame the density is 0.
    """
    along, down = functional.pad(density, (1, 1)), functional.pad(density, (0, 0, 1, 1))
    x, y = along[..., 2:] - along[..., :-2], down[..., 2:, :] - down[..., :-2, :]
    return ((x * x + y * y) / 4 + 1e-12).sqrt()


def _main_component(inside: Tensor, density: Tensor) -> Tensor:
    """Return the connected component of a region (1 inside, else 0) that contains the region's cell of highest
    `density`; components are separated on blocks of 8 x 8 cells.

    The component grows by one block per step, for as many steps as the longer side has blocks. A component whose path
    is longer is cut off there.
    """
    height, width = inside.shape[-2:]
    fit = (0, -width % sizes.BLOCK, 0, -height % sizes.BLOCK)
    dense = inside * density
    if any(fit):
        inside, dense = functional.pad(inside, fit), functional.pad(dense, fit)
    blocks, densest = (functional.max_pool2d(cells, sizes.BLOCK) for cells in (inside, dense))
    reached = (densest >= densest.amax((2, 3), keepdim=True)).to(inside.dtype) * blocks
    for _ in range(max(blocks.shape[-2:])):
        reached = torch.minimum(functional.max_pool2d(reached, 3, 1, 1), blocks)
    return (inside * enlarge(reached, sizes.BLOCK))[..., :height, :width]


def _enclosed(inside: Tensor) -> Tensor:
    """Fill the holes of a region (1 inside, else 0): add the cells that have region cells on all four sides."""
    between = []
    for axis in (2, 3):
        side = inside.shape[axis]
        index = torch.arange(1, side + 1, dtype=inside.dtype, device=inside.device)
        index = index[:, None] if axis == 2 else index
        last = (inside * index).amax(axis, keepdim=True)
        first = (side + 1) - (inside * ((side + 1) - index)).amax(axis, keepdim=True)
        between.append((torch.minimum(index - first, last - index) + 1).clamp(0.0, 1.0))  # integers: 0 or 1
    return between[0] * between[1]


def _moments(coverage: Tensor, cell: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return area, centre, semi-axes and angle of a region, given the fraction of each cell (B, 1, h, w) that it
    covers; the latter three are those of the ellipse with the same first and second moments.

    Centre and semi-axes are in px, the angle in rad.
    """
    # Moments about the centre of the frame, in cells, so that float32 represents the squares.
    powers = []
    middles = []
    for count in coverage.shape[-2:]:
        coordinate = torch.arange(count, dtype=coverage.dtype, device=coverage.device) - (count - 1) / 2
        powers.append(torch.stack((torch.ones_like(coordinate), coordinate, coordinate * coordinate)))
        middles.append((count - 1) / 2)
    moments = powers[0] @ coverage[:, 0] @ powers[1].T  # (B, 3, 3) by powers of y and x
    mass = moments[:, 0, :1]
    present = mass > 0.5
    moments = moments / torch.where(present, mass, 1.0)[..., None]
    mean = torch.cat((moments[:, 0, 1:2], moments[:, 1, :1]), dim=1)
    square = torch.cat((moments[:, 0, 2:], moments[:, 2, :1]), dim=1) - mean * mean
    mixed = moments[:, 1, 1:2] - mean[:, :1] * mean[:, 1:]
    # The pixel centres within a cell have a variance of (cell^2 - 1) / 12 px^2.
    variance = square * cell**2 + (cell**2 - 1) / 12
    middle, half = variance.mean(1, keepdim=True), (square[:, :1] - square[:, 1:]) * (cell**2 / 2)
    mixed = mixed * cell**2
    spread = (half * half + mixed * mixed).sqrt()
    axes = 2 * torch.cat((middle + spread, (middle - spread).clamp_min(0)), dim=1).sqrt()
    angle = half_angle(mixed, half)
    center = torch.cat((mean[:, :1] + middles[1], mean[:, 1:] + middles[0]), dim=1) * cell + (cell - 1) / 2
    return (
        torch.where(present, mass * cell**2, 0.0).squeeze(1),
        torch.where(present, center, torch.nan),
        torch.where(present, axes, torch.nan),
        torch.where(present, angle, torch.nan).squeeze(1),
    )
