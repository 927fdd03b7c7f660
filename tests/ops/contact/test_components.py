"""Filled holes and largest parts against SciPy's labels."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from fingerflow.ops.contact.components import fill_holes, largest_component


def scipy_largest(mask: np.ndarray) -> np.ndarray:
    labels, _ = scipy.ndimage.label(mask, np.ones((3, 3)))
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    return (labels == areas.argmax()) & mask  # argmax and SciPy's labels: the first in reading order


@pytest.mark.parametrize("density", [0.1, 0.3, 0.41, 0.5, 0.6, 0.75, 0.95])
@pytest.mark.parametrize("shape", [(40, 53), (64, 64), (1, 30), (30, 1), (2, 2)])
def test_equal_scipy_on_noise(density: float, shape: tuple[int, int]) -> None:
    """Around the densities 0.41 and 0.59 noise percolates: the parts are as long and winding as they get."""
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
    """A ring, a spot in it and a larger line outside it: filled first, the disc is the largest part."""
    mask = torch.zeros(1, 1, 40, 60, dtype=torch.bool)
    mask[0, 0, 5:25, 5:25] = True
    mask[0, 0, 6:24, 6:24] = False
    mask[0, 0, 12:14, 12:14] = True
    mask[0, 0, 30, :] = True
    mask[0, 0, 32:35, :20] = True
    square = torch.zeros_like(mask)
    square[0, 0, 5:25, 5:25] = True
    assert torch.equal(largest_component(fill_holes(mask)), square)
