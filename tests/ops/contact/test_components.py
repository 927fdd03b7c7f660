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


@pytest.mark.parametrize("density", [0.1, 0.3, 0.41, 0.5, 0.6, 0.75, 0.95])
@pytest.mark.parametrize("shape", [(40, 53), (64, 64), (1, 30), (30, 1), (2, 2)])
def test_equal_scipy_on_noise(density: float, shape: tuple[int, int]) -> None:
    """Holes and components of random masks equal SciPy's, also at the percolation densities of 0.41 and 0.59, where
    components are longest and most winding.
    """
    mask = np.random.default_rng(int(100 * density)).random((6, *shape)) < density
    tensor = torch.from_numpy(mask)[:, None]
    filled = np.stack([scipy.ndimage.binary_fill_holes(m) for m in mask])
    assert np.array_equal(fill_holes(tensor)[:, 0].numpy(), filled)
    assert np.array_equal(largest_component(tensor)[:, 0].numpy(), np.stack([scipy_largest(m) for m in mask]))


def test_finger_with_ridges() -> None:
    y, x = np.mgrid[:256, :320]
    inside = ((x - 160) / 130) ** 2 + ((y - 128) / 100) ** 2 < 1
    ridges = np.sin(0.45 * np.hypot(x - 40, y - 300) + 2 * np.sin(x / 30)) > -0.3
    mask = inside & (ridges | (np.random.default_rng(0).random(inside.shape) < 0.1))
    tensor = torch.from_numpy(mask)[None, None]
    assert np.array_equal(fill_holes(tensor)[0, 0].numpy(), scipy.ndimage.binary_fill_holes(mask))
    assert np.array_equal(largest_component(tensor)[0, 0].numpy(), scipy_largest(mask))


def test_gross_contact_of_separate_ridges() -> None:
    """A ring with a spot inside is filled before components are compared, and so is larger than a line outside."""
    mask = torch.zeros(1, 1, 40, 60, dtype=torch.bool)
    mask[0, 0, 5:25, 5:25] = True
    mask[0, 0, 6:24, 6:24] = False
    mask[0, 0, 12:14, 12:14] = True
    mask[0, 0, 30, :] = True
    mask[0, 0, 32:35, :20] = True
    square = torch.zeros_like(mask)
    square[0, 0, 5:25, 5:25] = True
    assert torch.equal(largest_component(fill_holes(mask)), square)


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


@pytest.mark.parametrize("size", [9, 64, 201])
def test_spiral_is_one_part_and_open_to_the_outside(size: int) -> None:
    walls = spiral(size)
    mask = torch.from_numpy(walls)[None, None]
    assert torch.equal(largest_component(mask), mask)
    expected = scipy.ndimage.binary_fill_holes(walls)
    assert np.array_equal(fill_holes(mask)[0, 0].numpy(), expected)
    corridor = ~mask
    labels, count = scipy.ndimage.label(~walls)
    assert np.array_equal(largest_component(corridor)[0, 0].numpy(), (labels == 1) if count == 1 else ~walls)


def test_spiral_closed_at_its_mouth_is_filled() -> None:
    walls = np.pad(spiral(65), 1, constant_values=True)
    assert fill_holes(torch.from_numpy(walls)[None, None]).all()


def test_zigzag_comb_of_many_dead_ends() -> None:
    mask = np.zeros((60, 400), dtype=bool)
    mask[:-1, ::2] = True
    mask[-1] = True
    mask[:-1, ::4] &= np.arange(59)[:, None] > 20
    tensor = torch.from_numpy(mask)[None, None]
    assert torch.equal(largest_component(tensor), tensor)
    assert torch.equal(largest_component(tensor.flip(-2)), tensor.flip(-2))


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


def test_all_none_and_empty() -> None:
    nothing = torch.zeros(2, 1, 6, 7, dtype=torch.bool)
    assert not largest_component(nothing).any()
    assert not fill_holes(nothing).any()
    assert largest_component(~nothing).all()
    assert fill_holes(~nothing).all()
    mixed = nothing.clone()
    mixed[1] = True
    assert torch.equal(largest_component(mixed), mixed)
    for shape in [(0, 1, 6, 7), (2, 1, 0, 7), (2, 1, 6, 0)]:
        empty = torch.zeros(shape, dtype=torch.bool)
        assert largest_component(empty).shape == shape
        assert fill_holes(empty).shape == shape


def test_equal_parts_give_the_first() -> None:
    mask = torch.zeros(1, 1, 5, 9, dtype=torch.bool)
    mask[0, 0, 0:2, 6:8] = True
    mask[0, 0, 1:3, 0:2] = True
    expected = torch.zeros_like(mask)
    expected[0, 0, 0:2, 6:8] = True
    assert torch.equal(largest_component(mask), expected)


def test_hole_at_the_border_stays_open() -> None:
    mask = torch.ones(1, 1, 5, 5, dtype=torch.bool)
    mask[0, 0, 0:3, 2] = False
    assert torch.equal(fill_holes(mask), mask)
