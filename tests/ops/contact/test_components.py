"""Tests of filled holes and largest components against SciPy's labels."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from fingerflow.ops.contact.components import fill_holes, largest_component


def scipy_largest(mask: np.ndarray) -> np.ndarray:
    labels, _ = scipy.ndimage.label(mask, np.ones((3, 3)))
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    return (labels == areas.argmax()) & mask  # of equal areas the first in reading order, as SciPy labels


@pytest.mark.parametrize("density", [0.1, 0.41, 0.6, 0.95])
@pytest.mark.parametrize("shape", [(40, 53), (1, 30), (30, 1), (0, 7)])
def test_equal_scipy_on_noise(density: float, shape: tuple[int, int]) -> None:
    """Holes and components of random masks equal SciPy's, also at the percolation densities of 0.41 and 0.59, where
    components are longest and most winding.
    """
    mask = np.random.default_rng(int(100 * density)).random((6, *shape)) < density
    tensor = torch.from_numpy(mask)[:, None]
    filled = np.stack([scipy.ndimage.binary_fill_holes(m) for m in mask])
    assert np.array_equal(fill_holes(tensor)[:, 0].numpy(), filled)
    assert np.array_equal(largest_component(tensor)[:, 0].numpy(), np.stack([scipy_largest(m) for m in mask]))


def spiral(size: int) -> np.ndarray:
    """Return a mask (size, size) of a corridor one pixel wide between walls one pixel wide, from the
    outside inwards.
    """
    wall = np.zeros((size, size), dtype=bool)
    y, x, dy, dx = 0, 0, 0, 1
    wall[0, 0] = True
    while True:
        steps = 0
        while (
            0 <= y + dy < size
            and 0 <= x + dx < size
            and not (0 <= y + 2 * dy < size and 0 <= x + 2 * dx < size and wall[y + 2 * dy, x + 2 * dx])
        ):
            y, x, steps = y + dy, x + dx, steps + 1
            wall[y, x] = True
        if steps < 2:
            return wall
        dy, dx = dx, -dy


@pytest.mark.parametrize("size", [9, 64])
def test_spiral_is_one_part_and_open_to_the_outside(size: int) -> None:
    walls = spiral(size)
    mask = torch.from_numpy(walls)[None, None]
    assert torch.equal(largest_component(mask), mask)
    expected = scipy.ndimage.binary_fill_holes(walls)
    assert np.array_equal(fill_holes(mask)[0, 0].numpy(), expected)
    corridor = ~mask
    labels, count = scipy.ndimage.label(~walls)
    assert np.array_equal(largest_component(corridor)[0, 0].numpy(), (labels == 1) if count == 1 else ~walls)


def test_diagonal_joins_contact_and_stops_background() -> None:
    diamond = torch.tensor([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=torch.bool)[None, None]
    assert torch.equal(largest_component(diamond), diamond)
    filled = diamond.clone()
    filled[0, 0, 1, 1] = True
    assert torch.equal(fill_holes(diamond), filled)


def test_runs_do_not_join_around_the_edge_of_the_frame() -> None:
    mask = torch.zeros(2, 1, 4, 5, dtype=torch.bool)
    mask[0, 0, 1, 3:] = True  # ends at the right edge
    mask[0, 0, 2, :1] = True  # the next pixel in memory
    mask[0, 0, 3] = True  # the last row of one frame and the first of the next
    mask[0, 0, 3, 1:] = False
    mask[1, 0, 0] = True
    expected = torch.zeros_like(mask)
    expected[0, 0, 1, 3:] = True
    expected[1, 0, 0] = True
    assert torch.equal(largest_component(mask), expected)


def test_equal_parts_give_the_first() -> None:
    mask = torch.zeros(1, 1, 5, 9, dtype=torch.bool)
    mask[0, 0, 0:2, 6:8] = True
    mask[0, 0, 1:3, 0:2] = True
    expected = torch.zeros_like(mask)
    expected[0, 0, 0:2, 6:8] = True
    assert torch.equal(largest_component(mask), expected)
