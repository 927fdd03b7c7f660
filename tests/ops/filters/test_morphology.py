"""Dilation and erosion against SciPy with the discs and diamonds of scikit-image; hard cases included."""

import numpy as np
import pytest
import scipy.ndimage
import torch
from skimage.morphology import diamond, disk

from fingerflow.ops.filters.morphology import Shape, dilate, erode


@pytest.mark.parametrize("radius", [0, 1, 2, 3, 5, 8, 13])
@pytest.mark.parametrize("shape", ["disc", "diamond"])
def test_equal_scipy(radius: int, shape: Shape) -> None:
    mask = np.random.default_rng(radius).random((2, 50, 43)) < 0.02
    footprint = (disk if shape == "disc" else diamond)(radius).astype(bool)
    tensor = torch.from_numpy(mask)[:, None]
    dilated = np.stack([scipy.ndimage.binary_dilation(m, footprint) for m in mask])
    assert np.array_equal(dilate(tensor, radius, shape)[:, 0].numpy(), dilated)
    eroded = np.stack([scipy.ndimage.binary_erosion(~m, footprint, border_value=1) for m in mask])
    assert np.array_equal(erode(~tensor, radius, shape)[:, 0].numpy(), eroded)


@pytest.mark.parametrize("radius", [0, 1, 4, 8])
def test_one_pixel_becomes_the_disc_itself(radius: int) -> None:
    mask = torch.zeros(1, 1, 21, 21, dtype=torch.bool)
    mask[0, 0, 10, 10] = True
    y, x = torch.meshgrid(torch.arange(21) - 10, torch.arange(21) - 10, indexing="ij")
    assert torch.equal(dilate(mask, radius)[0, 0], x**2 + y**2 <= radius**2)
    assert torch.equal(dilate(mask, radius, "diamond")[0, 0], x.abs() + y.abs() <= radius)
    assert torch.equal(erode(dilate(mask, radius), radius), mask)


def test_radius_wider_than_the_frame() -> None:
    mask = torch.zeros(1, 1, 3, 5, dtype=torch.bool)
    mask[0, 0, 0, 0] = True
    assert dilate(mask, 9).all()
    assert dilate(mask[..., :1, :1], 4).all()


def test_frame_border_does_not_erode() -> None:
    assert erode(torch.ones(1, 1, 6, 7, dtype=torch.bool), 2).all()


def test_all_none_and_empty_batch() -> None:
    nothing = torch.zeros(2, 1, 6, 7, dtype=torch.bool)
    assert not dilate(nothing, 3).any()
    assert not erode(nothing, 3).any()
    assert dilate(~nothing, 3).all()
    assert dilate(nothing[:0], 3).shape == (0, 1, 6, 7)
