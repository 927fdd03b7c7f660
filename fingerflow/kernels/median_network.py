"""Median filter as a program of minima and maxima, which neighbouring windows share.

A frame is cut into tiles of a few pixels. The windows of one tile have a core of pixels in common: it is sorted once,
then the tile is halved again and again, and each half merges the few rows or columns that its own windows share on top
of that, until one pixel is left. Three savings, none of which changes the answer:

- an element is dropped as soon as its rank says that it cannot be the median of the whole window any more;
- equal sub-expressions are found across neighbouring tiles too, because an expression is known by its shape and not by
  its place: the same sorted column serves every window it lies in;
- what no median depends on is removed at the end.

The idea of a shared sorted core with extremes dropped is Adams 2021 (separable sorting networks for medians), halving
tiles is Sugy 2025 (arXiv 2507.19926), the merges are Batcher's odd-even merges (Knuth, TAOCP 3, 5.3.4). The programs
here are derived, not copied. Nothing in this file knows of tensors: torch, ONNX and C++ read the same program.
"""

import functools
from typing import Literal, NamedTuple

Operation = Literal["minimum", "maximum"]


class Operand(NamedTuple):
    """Plane that is read with a shift by `rows` tiles down and `columns` tiles right.

    The planes -1 and -2 are the bounds LOWEST and HIGHEST.
    """

    plane: int
    rows: int
    columns: int


# Bounds that no pixel passes. They pad a merge to another parity, and every comparison with them folds away.
LOWEST = Operand(-1, 0, 0)
HIGHEST = Operand(-2, 0, 0)


class Step(NamedTuple):
    """Step of a program: plane `result` is the minimum or maximum of the planes `left` and `right`.

    The plane `right` is read with a shift by `rows` and `columns` tiles.

    The shift is never backwards in reading order (row first), so a plane can be kept as one flat array.
    """

    operation: Operation
    result: int
    left: int
    right: int
    rows: int
    columns: int
    released: tuple[int, ...]  # planes that no later step and no output reads


class MedianProgram(NamedTuple):
    """Medians of `size` x `size` windows for tiles of `tile` = (rows, columns) pixels.

    Plane r * columns + c < rows * columns holds pixel (r, c) of every tile; the first window of a tile
    begins at the tile's first pixel, so the frame is padded by size // 2 at the top and left. `outputs` are the medians
    of the tile's pixels in the same order.
    """

    size: int
    tile: tuple[int, int]
    steps: tuple[Step, ...]
    outputs: tuple[Operand, ...]

    @property
    def reach(self) -> tuple[int, int]:
        """Return how far beyond a tile its program reads, in tiles down and right."""
        rows, columns = self.tile
        return (rows + self.size - 2) // rows, (columns + self.size - 2) // columns

    @property
    def operations_per_pixel(self) -> float:
        """Return the number of minima and maxima per pixel."""
        return len(self.steps) / (self.tile[0] * self.tile[1])


@functools.cache
def median_program(size: int) -> MedianProgram:
    """Return the shortest program among a few tilings: 17 operations a pixel for 3 x 3, 57 for 5 x 5, 183 for 9 x 9.

    Args:
        size: window side in pixels, odd and at least 3.

    Raises:
        ValueError: `size` is even or under 3.
    """
    if size < 3 or size % 2 == 0:
        raise ValueError(f"a median window of {size} x {size} has no centre pixel: use an odd size of at least 3")
    # Tiles of 2x1, 2x2, 4x2 and 8x2: which axis is halved, in order. From 13 on the last is the shortest.
    halvings = ["y", "xy", "yyx"] if size < 13 else ["yyyx"]
    programs = [tile_program(size, order) for order in halvings if 2 ** order.count("y") <= size]
    return min(programs, key=lambda program: program.operations_per_pixel)


def tile_program(size: int, order: str) -> MedianProgram:
    """Return the program for tiles of a size given by `order`: "y" for 2 x 1 px, "yyx" for 4 x 2 px.

    The letters are the axes along which a tile is halved in turn.
    """
    tile = 2 ** order.count("y"), 2 ** order.count("x")
    windows = _Windows(size, tile)
    windows.halve(0, 0, *tile, windows.block(*windows.core(0, 0, *tile)), order)
    medians = [windows.medians[pixel] for pixel in sorted(windows.medians)]
    return MedianProgram(size, tile, *windows.network.program(medians))


def _ranks(size: int, count: int) -> tuple[int, int]:
    """Return the first and the last rank among `count` pixels of a window that can still be its median."""
    pixels = size * size
    return max(0, pixels // 2 - (pixels - count)), min(count - 1, pixels // 2)


class _Network:
    """Sorting network for the median: minimum and maximum operations on whole arrays, each computed only once."""

    def __init__(self, rows: int, columns: int) -> None:
        self.rows, self.columns = rows, columns
        self.comparisons: dict[tuple[Operation, int, int, int, int], int] = {}

    @property
    def inputs(self) -> int:
        return self.rows * self.columns

    def pixel(self, y: int, x: int) -> Operand:
        phase = (y % self.rows) * self.columns + x % self.columns
        return Operand(phase, y // self.rows, x // self.columns)

    def compare(self, operation: Operation, first: Operand, second: Operand) -> Operand:
        bounds = (LOWEST, HIGHEST)
        if first in bounds or second in bounds:
            bound, other = (first, second) if first in bounds else (second, first)
            return bound if (operation == "minimum") == (bound == LOWEST) else other
        # The order of operands is free: a canonical one finds repeats and keeps shifts forward.
        left, right = sorted((first, second), key=lambda operand: (operand.rows, operand.columns, operand.plane))
        shift = right.rows - left.rows, right.columns - left.columns
        key = (operation, left.plane, right.plane, *shift)
        plane = self.comparisons.setdefault(key, self.inputs + len(self.comparisons))
        return Operand(plane, left.rows, left.columns)

    def needed(self, outputs: list[Operand]) -> set[int]:
        """Return the planes that the outputs depend on, without the inputs."""
        comparisons = list(self.comparisons)
        found = set()
        waiting = [output.plane for output in outputs]
        while waiting:
            plane = waiting.pop()
            if plane >= self.inputs and plane not in found:
                found.add(plane)
                waiting.extend(comparisons[plane - self.inputs][1:3])
        return found

    def program(self, outputs: list[Operand]) -> tuple[tuple[Step, ...], tuple[Operand, ...]]:
        comparisons = list(self.comparisons)
        order = sorted(self.needed(outputs))
        number = {plane: plane for plane in range(self.inputs)}
        number |= {plane: self.inputs + place for place, plane in enumerate(order)}
        kept = {number[output.plane] for output in outputs}
        steps: list[Step] = []
        for plane in reversed(order):
            operation, left, right, rows, columns = comparisons[plane - self.inputs]
            released = {number[left], number[right]} - kept
            kept |= released
            step = Step(operation, number[plane], number[left], number[right], rows, columns, tuple(sorted(released)))
            steps.append(step)
        return tuple(reversed(steps)), tuple(Operand(number[plane], *shift) for plane, *shift in outputs)


class _Windows:
    """Sorted blocks of pixels, reduced to the elements that can be the median of a window."""

    def __init__(self, size: int, tile: tuple[int, int]) -> None:
        self.size = size
        self.network = _Network(*tile)
        self.medians: dict[tuple[int, int], Operand] = {}

    def core(self, y: int, x: int, rows: int, columns: int) -> tuple[int, int, int, int]:
        """Return the block (y, x, rows, columns) common to the windows that begin in this tile."""
        return y + rows - 1, x + columns - 1, self.size - rows + 1, self.size - columns + 1

    def halve(self, y: int, x: int, rows: int, columns: int, core: list[Operand], order: str) -> None:
        """Halve a tile recursively, and merge its sorted core with the block that the windows of each half share."""
        if not order:
            (self.medians[y, x],) = core
            return
        top, left, height, width = self.core(y, x, rows, columns)
        if order[0] == "y":
            half = rows // 2
            halves = [
                (y, x, half, columns, (top - half, left, half, width)),
                (y + half, x, half, columns, (top + height, left, half, width)),
            ]
        else:
            half = columns // 2
            halves = [
                (y, x, rows, half, (top, left - half, height, half)),
                (y, x + half, rows, half, (top, left + width, height, half)),
            ]
        for half_y, half_x, half_rows, half_columns, block in halves:
            merged = self.join(core, height * width, self.block(*block), block[2] * block[3])
            self.halve(half_y, half_x, half_rows, half_columns, merged, order[1:])

    def block(self, y: int, x: int, rows: int, columns: int) -> list[Operand]:
        """Return the pixels of a rectangle in ascending order: its lines are sorted, then merged by powers of two.

        Blocks are rebuilt for each tile that needs them; the network reuses equal comparisons.
        """
        if rows * columns == 1:
            return [self.network.pixel(y, x)]
        along_x = 1 < columns <= rows or rows == 1
        part = 1 << ((columns if along_x else rows) - 1).bit_length() - 1  # the largest power of two that is smaller
        if along_x:
            first, second = (y, x, rows, part), (y, x + part, rows, columns - part)
        else:
            first, second = (y, x, part, columns), (y + part, x, rows - part, columns)
        return self.join(self.block(*first), first[2] * first[3], self.block(*second), second[2] * second[3])

    def join(self, first: list[Operand], first_count: int, second: list[Operand], second_count: int) -> list[Operand]:
        """Merge the median candidates of two disjoint sets of `first_count` and `second_count` pixels."""
        low, high = _ranks(self.size, first_count + second_count)
        dropped = _ranks(self.size, first_count)[0] + _ranks(self.size, second_count)[0]
        return _merge_ranks(self.network, first, second, low - dropped, high - dropped)


def _merge_ranks(network: _Network, first: list[Operand], second: list[Operand], low: int, high: int) -> list[Operand]:
    """Return the elements of rank `low` to `high` of two ascending lists, by the cheapest odd-even merge."""
    # Element i of one list has a rank between i and i + len(other) in the merged list.
    while True:
        first, second = first[: high + 1], second[: high + 1]
        below_first = max(0, min(low - len(second), len(first)))
        below_second = max(0, min(low - len(first), len(second)))
        if not below_first and not below_second:
            break
        first, second = first[below_first:], second[below_second:]
        low, high = low - below_first - below_second, high - below_first - below_second
    padding = _cheapest_padding(len(first), len(second), low, high)
    return _padded_merge(network, first, second, low, high, *padding)


@functools.cache
def _cheapest_padding(first: int, second: int, low: int, high: int) -> tuple[int, int]:
    """Return how many LOWEST elements to put before each of two lists, so that merging takes the fewest steps."""

    def cost(padding: tuple[int, int]) -> int:
        network = _Network(1, first + second)
        pixels = [network.pixel(0, x) for x in range(first + second)]
        return len(network.needed(_padded_merge(network, pixels[:first], pixels[first:], low, high, *padding)))

    return min(((p, q) for p in range(2) for q in range(2)), key=cost)


def _padded_merge(
    network: _Network, first: list[Operand], second: list[Operand], low: int, high: int, p: int, q: int
) -> list[Operand]:
    merged = _odd_even_merge(network, [LOWEST] * p + first, [LOWEST] * q + second)
    return merged[low + p + q : high + p + q + 1]


def _odd_even_merge(network: _Network, first: list[Operand], second: list[Operand]) -> list[Operand]:
    """Merge two ascending lists of any lengths by Batcher's odd-even merge."""
    if not first or not second:
        return first or second
    if len(first) == len(second) == 1:
        return [network.compare("minimum", first[0], second[0]), network.compare("maximum", first[0], second[0])]
    even = _odd_even_merge(network, first[0::2], second[0::2])
    odd = _odd_even_merge(network, first[1::2], second[1::2])
    merged = [even[0]]
    for place in range(max(len(odd), len(even) - 1)):
        pair = [*odd[place : place + 1], *even[place + 1 : place + 2]]
        if len(pair) == 2:
            pair = [network.compare("minimum", *pair), network.compare("maximum", *pair)]
        merged += pair
    return merged
