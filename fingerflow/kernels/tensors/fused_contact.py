"""Apparent contact by one kernel of Triton: one launch for all frames.

A program is a frame. It takes the steps of `ops.contact.apparent_contact` on the frame's cells, with the results of the
portable form to rounding. Intermediate images stay in a few planes of memory, which a processor's cache holds; the
smoothing by three box means is six passes with the weights of a box in place of a product with a matrix.
"""

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels import contact_sizes as limits

TILE = 4096  # cells that a program computes at a time
WARPS = 16
_PLANES = 9

_BLOCK = tl.constexpr(limits.BLOCK)
_LEAST_SHARE, _SOLID = tl.constexpr(limits.LEAST_SHARE), tl.constexpr(limits.SOLID)
_THINNING = tl.constexpr(limits.THINNING)
_FIRST_ROUNDS, _BORDERS = tl.constexpr(limits.FIRST_ROUNDS), tl.constexpr(limits.BORDERS)
_ROUNDS = tl.constexpr(limits.ROUNDS)


def apparent_contact(mask: Tensor, radius: int, cell: int) -> tuple[Tensor, Tensor]:
    """Segment the apparent contact in masks (B, 1, H, W) bool, as `kernels.contact.apparent_contact`: the density
    margin (B, 1, h, w) on cells and, in (B, 7), covered and apparent area, centre, semi-axes and angle.
    """
    batch, (height, width) = len(mask), mask.shape[-2:]
    rows, columns = -(-height // cell), -(-width // cell)
    margin = torch.empty(batch, 1, rows, columns, dtype=torch.float32, device=mask.device)
    numbers = margin.new_empty(batch, 8)
    wide = (2 * radius + 1) / cell
    bands = [max(wide * one / 2, 1.0) for one in (limits.NARROW, limits.WIDE)]
    padded = triton.next_power_of_2(columns)
    blocks = -(-rows // limits.BLOCK) * -(-columns // limits.BLOCK)
    planes = margin.new_empty(batch, _PLANES * rows * columns + 2 * (rows + columns) + 3 * blocks)
    if batch:
        _segment[(batch,)](
            *(mask.contiguous().view(torch.uint8), planes, margin, numbers),
            *(planes.shape[1], height, width, rows, columns),
            *(wide, *bands, *map(_reach, (wide, *bands))),
            CELL=cell,
            ROWS=max(1, TILE // padded),
            COLUMNS=padded,
            num_warps=WARPS,
            num_stages=1,
        )
    angle = torch.atan2(numbers[:, 6], numbers[:, 7]) / 2
    return margin, torch.cat((numbers[:, :6], angle[:, None]), dim=1)


def _reach(wide: float) -> int:
    """Return over how many cells on either side a box that is `wide` cells wide has a weight."""
    return math.ceil((wide + 1) / 2) - 1


@triton.jit
def _place(first, rows, columns, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """Return row and column of the cells of a tile, and a mask of those that exist."""
    row = first + tl.arange(0, ROWS)[:, None]
    column = tl.arange(0, COLUMNS)[None, :]
    return row, column, (row < rows) & (column < columns)


@triton.jit
def _smooth(planes, source, one, other, result, rows, columns, wide, half, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """Store an image smoothed by three successive means over boxes `wide` cells long in y, then in x; beyond the frame
    it is 0.

    Images are offsets in the memory `planes`; those at `one` and `other` are overwritten. `half` is the reach of a box
    on either side, in cells.
    """
    for number in range(6):
        before = tl.where(number == 0, source, tl.where(number % 2 == 0, other, one))
        after = tl.where(number == 5, result, tl.where(number % 2 == 0, one, other))
        down = tl.where(number < 3, 1, 0)
        for first in range(0, rows, ROWS):
            row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
            total = tl.zeros((ROWS, COLUMNS), tl.float32)
            for away in range(-half, half + 1):
                weight = tl.minimum(tl.maximum((wide + 1) / 2 - tl.abs(away * 1.0), 0.0), 1.0) / wide
                at_row = row + away * down
                at_column = column + away * (1 - down)
                inside = there & (at_row >= 0) & (at_row < rows) & (at_column >= 0) & (at_column < columns)
                total += weight * tl.load(planes + before + at_row * columns + at_column, mask=inside, other=0.0)
            tl.store(planes + after + row * columns + column, total, mask=there)
        tl.debug_barrier()


@triton.jit
def _inside(density, flat, limit):
    """Return the fraction of a cell in which the density exceeds a limit."""
    return tl.minimum(tl.maximum((density - limit) * flat + 0.5, 0.0), 1.0)


@triton.jit
def _part_inside(density, flat, at, there, limit):
    """Return the fractions of the cells `at` in which the stored density exceeds a limit, 0 where none is `there`."""
    dense = tl.load(density + at, mask=there, other=0.0)
    return tl.where(there, _inside(dense, tl.load(flat + at, mask=there, other=0.0), limit), 0.0)


@triton.jit
def _largest_around(values, row, column, rows, columns, there):
    """Return the maximum of an image on the 3 x 3 cells around each cell, and the largest of 1 minus the image."""
    largest = there.to(tl.float32) * 0.0
    beyond = largest
    for down in range(-1, 2):
        for along in range(-1, 2):
            at_row = row + down
            at_column = column + along
            inside = there & (at_row >= 0) & (at_row < rows) & (at_column >= 0) & (at_column < columns)
            value = tl.load(values + at_row * columns + at_column, mask=inside, other=0.0)
            largest = tl.maximum(largest, value)
            beyond = tl.maximum(beyond, tl.where(inside, 1.0 - value, 0.0))
    return largest, beyond


@triton.jit
def _fill(density, filled, ends, blocks, rows, columns, limit, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """Store the main component of the region above a density `limit`, with its holes filled, as 1 inside and else 0.

    `ends` and `blocks` are memory for the ends of lines and for blocks of cells.
    """
    down = (rows + _BLOCK - 1) // _BLOCK
    across = (columns + _BLOCK - 1) // _BLOCK
    count = down * across
    step = tl.arange(0, ROWS * COLUMNS)
    # Blocks with a cell of the region, and those with its densest cell.
    most = 0.0
    for first in range(0, count, ROWS * COLUMNS):
        block = first + step
        densest = tl.zeros((ROWS * COLUMNS,), tl.float32)
        for k in range(_BLOCK):
            for n in range(_BLOCK):
                row = block // across * _BLOCK + k
                column = block % across * _BLOCK + n
                there = (block < count) & (row < rows) & (column < columns)
                value = tl.load(density + row * columns + column, mask=there, other=0.0)
                densest = tl.maximum(densest, tl.where(value > limit, value, 0.0))
        tl.store(blocks + block, densest, mask=block < count)
        most = tl.maximum(most, tl.max(densest))
    tl.debug_barrier()
    for first in range(0, count, ROWS * COLUMNS):
        block = first + step
        densest = tl.load(blocks + block, mask=block < count, other=0.0)
        tl.store(blocks + count + block, tl.where((densest >= most) & (densest > 0), 1.0, 0.0), mask=block < count)
    tl.debug_barrier()
    steps = tl.maximum(down, across)
    for k in range(steps):
        reached = blocks + (1 + k % 2) * count
        further = blocks + (2 - k % 2) * count
        for first in range(0, count, ROWS * COLUMNS):
            block = first + step
            row = block // across
            column = block % across
            largest, beyond = _largest_around(reached, row, column, down, across, block < count)
            own = tl.load(blocks + block, mask=block < count, other=0.0)
            tl.store(further + block, tl.where(own > 0, largest, 0.0), mask=block < count)
        tl.debug_barrier()
    reached = blocks + (1 + steps % 2) * count

    # First and last cell of the component in each row and column, counted from 1.
    column_first = tl.full((COLUMNS,), 0, tl.int32) + columns + rows + 1
    column_last = tl.zeros((COLUMNS,), tl.int32)
    for first in range(0, rows, ROWS):
        row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
        value = tl.load(density + row * columns + column, mask=there, other=0.0)
        own = tl.load(reached + row // _BLOCK * across + column // _BLOCK, mask=there, other=0.0)
        inside = there & (value > limit) & (own > 0)
        line = first + tl.arange(0, ROWS)
        nowhere = rows + columns + 1
        tl.store(ends + line, tl.min(tl.where(inside, column + 1, nowhere), 1).to(tl.float32), mask=line < rows)
        tl.store(ends + rows + line, tl.max(tl.where(inside, column + 1, 0), 1).to(tl.float32), mask=line < rows)
        column_first = tl.minimum(column_first, tl.min(tl.where(inside, row + 1, nowhere), 0))
        column_last = tl.maximum(column_last, tl.max(tl.where(inside, row + 1, 0), 0))
    tl.debug_barrier()
    for first in range(0, rows, ROWS):
        row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
        line = first + tl.arange(0, ROWS)
        row_first = tl.load(ends + line, mask=line < rows, other=0.0)[:, None].to(tl.int32)
        row_last = tl.load(ends + rows + line, mask=line < rows, other=0.0)[:, None].to(tl.int32)
        between = (column + 1 >= row_first) & (column + 1 <= row_last)
        between = between & (row + 1 >= column_first[None, :]) & (row + 1 <= column_last[None, :])
        tl.store(filled + row * columns + column, tl.where(between, 1.0, 0.0), mask=there)
    tl.debug_barrier()


@triton.jit
def _band(planes, border, coarse, one, other, rows, columns, wide, half, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """Smooth an image of the border on blocks of 2 x 2 cells; the result, on these blocks, is in `coarse`."""
    down = (rows + 1) // 2
    across = (columns + 1) // 2
    for first in range(0, down, ROWS):
        row, column, there = _place(first, down, across, ROWS, COLUMNS)
        total = tl.zeros((ROWS, COLUMNS), tl.float32)
        for k in range(2):
            for n in range(2):
                at_row = 2 * row + k
                at_column = 2 * column + n
                inside = there & (at_row < rows) & (at_column < columns)
                total += tl.load(planes + border + at_row * columns + at_column, mask=inside, other=0.0)
        tl.store(planes + coarse + row * across + column, total / 4, mask=there)
    tl.debug_barrier()
    _smooth(planes, coarse, one, other, coarse, down, across, wide, half, ROWS, COLUMNS)


@triton.jit
def _ratio(covered, region):
    return tl.minimum(tl.maximum(covered / tl.maximum(region, 1e-3), _LEAST_SHARE), 1.0)


@triton.jit
def _segment(
    mask,
    planes,
    margin,
    numbers,
    memory,
    height,
    width,
    rows,
    columns,
    wide,
    narrow,
    broad,
    half,
    narrow_half,
    broad_half,
    CELL: tl.constexpr,
    ROWS: tl.constexpr,
    COLUMNS: tl.constexpr,
):
    frame = tl.program_id(0).to(tl.int64)
    mask += frame * height * width
    size = rows * columns
    cells = planes + frame * memory
    density = cells + size
    flat = cells + 2 * size
    filled = cells + 5 * size
    border = cells + 6 * size
    near_weight = cells + 7 * size
    far_weight = cells + 8 * size
    ends = cells + 9 * size
    blocks = ends + 2 * (rows + columns)

    covered = tl.zeros((ROWS, COLUMNS), tl.float32)
    for first in range(0, rows, ROWS):
        row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
        total = tl.zeros((ROWS, COLUMNS), tl.int32)
        for k in range(CELL):
            for n in range(CELL):
                y = row * CELL + k
                x = column * CELL + n
                total += tl.load(mask + y * width + x, mask=there & (y < height) & (x < width), other=0).to(tl.int32)
        share = total.to(tl.float32) / (CELL * CELL)
        covered += share
        tl.store(cells + row * columns + column, share, mask=there)
    tl.debug_barrier()
    _smooth(cells, 0, 3 * size, 4 * size, size, rows, columns, wide, half, ROWS, COLUMNS)
    for first in range(0, rows, ROWS):
        row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
        at = density + row * columns + column
        x = tl.load(at + 1, mask=there & (column < columns - 1), other=0.0)
        x -= tl.load(at - 1, mask=there & (column > 0), other=0.0)
        y = tl.load(at + columns, mask=there & (row < rows - 1), other=0.0)
        y -= tl.load(at - columns, mask=there & (row > 0), other=0.0)
        tl.store(flat + row * columns + column, 1 / tl.sqrt((x * x + y * y) / 4 + 1e-12), mask=there)
    tl.debug_barrier()

    limit = 0.25
    inner = 0.0
    for first_step in range(_FIRST_ROUNDS):
        covered_inside = tl.zeros((ROWS, COLUMNS), tl.float32)
        region = tl.zeros((ROWS, COLUMNS), tl.float32)
        for first in range(0, rows, ROWS):
            row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
            at = row * columns + column
            part = _part_inside(density, flat, at, there, limit)
            covered_inside += tl.minimum(tl.load(cells + at, mask=there, other=0.0), part)
            region += part
        inner = _ratio(tl.sum(covered_inside), tl.sum(region))
        limit = inner / 2

    for border_step in range(_BORDERS):
        _fill(density, filled, ends, blocks, rows, columns, limit, ROWS, COLUMNS)
        for first in range(0, rows, ROWS):
            row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
            at = row * columns + column
            part = _part_inside(density, flat, at, there, limit)
            within, beyond = _largest_around(filled, row, column, rows, columns, there)
            tl.store(border + at, part * (1 - part) * within * beyond, mask=there)
            tl.store(near_weight + at, part, mask=there)
        tl.debug_barrier()
        # At a convex border the smoothed region itself is below one half.
        _smooth(cells, 7 * size, 3 * size, 4 * size, 8 * size, rows, columns, wide, half, ROWS, COLUMNS)
        own = tl.zeros((ROWS, COLUMNS), tl.float32)
        length = tl.zeros((ROWS, COLUMNS), tl.float32)
        for first in range(0, rows, ROWS):
            row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
            at = row * columns + column
            rim = tl.load(border + at, mask=there, other=0.0)
            own += tl.load(far_weight + at, mask=there, other=0.0) * rim
            length += rim
        level = tl.minimum(tl.maximum(tl.sum(own) / tl.maximum(tl.sum(length), 1e-3), 0.25), 0.5)
        tl.debug_barrier()
        _band(cells, 6 * size, 7 * size, 3 * size, 4 * size, rows, columns, narrow, narrow_half, ROWS, COLUMNS)
        _band(cells, 6 * size, 8 * size, 3 * size, 4 * size, rows, columns, broad, broad_half, ROWS, COLUMNS)
        for share_step in range(_ROUNDS):
            near_covered = tl.zeros((ROWS, COLUMNS), tl.float32)
            near_region = tl.zeros((ROWS, COLUMNS), tl.float32)
            far_covered = tl.zeros((ROWS, COLUMNS), tl.float32)
            far_region = tl.zeros((ROWS, COLUMNS), tl.float32)
            all_covered = tl.zeros((ROWS, COLUMNS), tl.float32)
            all_region = tl.zeros((ROWS, COLUMNS), tl.float32)
            for first in range(0, rows, ROWS):
                row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
                at = row * columns + column
                part = _part_inside(density, flat, at, there, limit)
                ridges = tl.minimum(tl.load(cells + at, mask=there, other=0.0), part)
                coarse = row // 2 * ((columns + 1) // 2) + column // 2
                near = tl.load(near_weight + coarse, mask=there, other=0.0)
                far = tl.load(far_weight + coarse, mask=there, other=0.0)
                near_covered += near * ridges
                near_region += near * part
                far_covered += far * ridges
                far_region += far * part
                all_covered += ridges
                all_region += part
            near_share = _ratio(tl.sum(near_covered), tl.sum(near_region))
            far_share = _ratio(tl.sum(far_covered), tl.sum(far_region))
            everywhere = _ratio(tl.sum(all_covered), tl.sum(all_region))
            rim_share = near_share * tl.exp2(tl.log2(near_share / far_share) * _THINNING)
            rim_share = tl.minimum(tl.maximum(rim_share, _LEAST_SHARE), 1.0)
            limit = tl.where(inner > _SOLID, everywhere, rim_share) * level

    _fill(density, filled, ends, blocks, rows, columns, limit, ROWS, COLUMNS)
    area = tl.zeros((ROWS, COLUMNS), tl.float32)
    area_x = tl.zeros((ROWS, COLUMNS), tl.float32)
    area_y = tl.zeros((ROWS, COLUMNS), tl.float32)
    area_xx = tl.zeros((ROWS, COLUMNS), tl.float32)
    area_xy = tl.zeros((ROWS, COLUMNS), tl.float32)
    area_yy = tl.zeros((ROWS, COLUMNS), tl.float32)
    middle_x = (columns - 1) / 2
    middle_y = (rows - 1) / 2
    for first in range(0, rows, ROWS):
        row, column, there = _place(first, rows, columns, ROWS, COLUMNS)
        at = row * columns + column
        dense = tl.load(density + at, mask=there, other=0.0)
        part = _inside(dense, tl.load(flat + at, mask=there, other=0.0), limit)
        near, beyond = _largest_around(filled, row, column, rows, columns, there)
        own = tl.load(filled + at, mask=there, other=0.0)
        hole = tl.where((own > 0) & (dense <= limit), 1.0, 0.0)
        tl.store(margin + frame * size + at, tl.maximum(dense * near - limit, (2 * hole - 1) * limit), mask=there)
        coverage = tl.where(there, tl.maximum(part * near, hole), 0.0)
        # About the middle of the frame, in cells, so that float32 represents the squares.
        x = column - middle_x
        y = row - middle_y
        area += coverage
        area_x += coverage * x
        area_y += coverage * y
        area_xx += coverage * x * x
        area_xy += coverage * x * y
        area_yy += coverage * y * y
    mass = tl.sum(area)
    some = mass > 0.5
    safe = tl.where(some, mass, 1.0)
    mean_x = tl.sum(area_x) / safe
    mean_y = tl.sum(area_y) / safe
    square: tl.constexpr = CELL * CELL
    pixels: tl.constexpr = (CELL * CELL - 1) / 12  # variance, px^2, of the pixel centres within a cell
    xx = (tl.sum(area_xx) / safe - mean_x * mean_x) * square
    yy = (tl.sum(area_yy) / safe - mean_y * mean_y) * square
    xy = (tl.sum(area_xy) / safe - mean_x * mean_y) * square
    difference = (xx - yy) / 2
    mean = (xx + yy) / 2 + pixels
    spread = tl.sqrt(difference * difference + xy * xy)
    unknown = tl.where(some, 0.0, float("nan"))
    numbers += frame * 8
    tl.store(numbers, tl.sum(covered) * square)
    tl.store(numbers + 1, tl.where(some, mass * square, 0.0))
    tl.store(numbers + 2, (mean_x + middle_x) * CELL + (CELL - 1) / 2 + unknown)
    tl.store(numbers + 3, (mean_y + middle_y) * CELL + (CELL - 1) / 2 + unknown)
    tl.store(numbers + 4, 2 * tl.sqrt(mean + spread) + unknown)
    tl.store(numbers + 5, 2 * tl.sqrt(tl.maximum(mean - spread, 0.0)) + unknown)
    tl.store(numbers + 6, xy + unknown)
    tl.store(numbers + 7, difference + unknown)
