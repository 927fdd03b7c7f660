"""Tests of the program of minima and maxima alone, executed as its docstring defines it and without torch."""

import itertools

import numpy as np
import pytest

from fingerflow.kernels.median_network import MedianProgram, median_program

# Achieved with tiles of 2x1, 2x1, 4x2, 2x2 and 4x2; a change that needs more operations fails the test.
OPERATIONS_PER_PIXEL = {3: 17.0, 5: 57.0, 7: 115.75, 9: 183.0, 11: 264.25}


def medians_of_tile(program: MedianProgram, block: np.ndarray) -> list[np.ndarray]:
    """Return the tile's medians from the block (rows, columns, ...) of its windows, by recursion from the outputs."""
    step_of = {step.result: step for step in program.steps}
    rows, columns = program.tile
    known: dict[tuple[int, int, int], np.ndarray] = {}

    def value(plane: int, down: int, right: int) -> np.ndarray:
        key = (plane, down, right)
        if key not in known:
            if plane < rows * columns:
                assert down <= program.reach[0]
                assert right <= program.reach[1]
                known[key] = block[down * rows + plane // columns, right * columns + plane % columns]
            else:
                step = step_of[plane]
                operate = np.minimum if step.operation == "minimum" else np.maximum
                second = value(step.right, down + step.rows, right + step.columns)
                known[key] = operate(value(step.left, down, right), second)
        return known[key]

    return [value(*output) for output in program.outputs]


@pytest.mark.parametrize("size", OPERATIONS_PER_PIXEL)
def test_operations_per_pixel(size: int) -> None:
    assert median_program(size).operations_per_pixel <= OPERATIONS_PER_PIXEL[size]


def test_all_zero_one_inputs_of_3x3() -> None:
    """The program is right for all 0/1 inputs and hence, by the zero-one principle, for all inputs."""
    program = median_program(3)
    shape = (program.tile[0] + 2, program.tile[1] + 2)
    bits = np.array(list(itertools.product((0, 1), repeat=shape[0] * shape[1])), dtype=np.uint8).T.reshape(*shape, -1)
    for place, median in enumerate(medians_of_tile(program, bits)):
        y, x = divmod(place, program.tile[1])
        assert np.array_equal(median, bits[y : y + 3, x : x + 3].sum((0, 1)) > 4)


@pytest.mark.parametrize("size", [5, 9, 13])
def test_zero_one_inputs_at_the_edge_of_the_majority(size: int) -> None:
    """Windows with just more or just fewer ones than half have the right median, with ones in random, sorted and nearly
    sorted order.
    """
    program = median_program(size)
    rng = np.random.default_rng(size)
    rows, columns = program.tile
    for place in range(rows * columns):
        y, x = divmod(place, columns)
        block = rng.integers(0, 2, (rows + size - 1, columns + size - 1, 600), dtype=np.uint8)
        for sample in range(block.shape[-1]):
            ones = size * size // 2 + sample % 2
            window = np.arange(size * size) < ones
            if sample % 3 == 0:
                window = rng.permutation(window)
            elif sample % 3 == 1:  # a few pixels out of order, along rows or columns, from either end
                window[rng.integers(0, size * size, 4)] ^= True
            window = window.reshape(size, size)
            window = window.T if sample % 4 < 2 else window
            block[y : y + size, x : x + size, sample] = window[:: 1 if sample % 8 < 4 else -1]
        truth = block[y : y + size, x : x + size].sum((0, 1), dtype=int) > size * size // 2
        assert np.array_equal(medians_of_tile(program, block)[place], truth)


@pytest.mark.parametrize("size", [3, 7, 9])
def test_planes_are_released_after_their_last_use(size: int) -> None:
    program = median_program(size)
    alive = set(range(program.tile[0] * program.tile[1]))
    for step in program.steps:
        assert {step.left, step.right} <= alive
        assert (step.rows, step.columns) >= (0, 0)
        alive = (alive | {step.result}) - set(step.released)
    assert alive == {output.plane for output in program.outputs}


@pytest.mark.parametrize("size", [1, 4, 0, -3])
def test_refuses_windows_without_a_centre(size: int) -> None:
    with pytest.raises(ValueError, match=f"{size} x {size}"):
        median_program(size)
