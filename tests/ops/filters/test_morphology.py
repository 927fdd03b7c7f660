"""Tests of dilation and erosion against SciPy with scikit-image's discs and diamonds, hard cases included."""

import numpy as np
import pytest
import scipy.ndimage
import torch
from skimage.morphology import diamond, disk

from fingerflow.ops.filters.morphology import Shape, dilate, erode


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("radius", [0, 1, 3, 8])
@pytest.mark.parametrize("shape", ["disc", "diamond"])
def test_equal_scipy(radius: int, shape: Shape) -> None:
    mask = np.random.default_rng(radius).random((2, 50, 43)) < 0.02
    footprint = (disk if shape == "disc" else diamond)(radius).astype(bool)
    tensor = torch.from_numpy(mask)[:, None]
    dilated = np.stack([scipy.ndimage.binary_dilation(m, footprint) for m in mask])
    assert np.array_equal(dilate(tensor, radius, shape)[:, 0].numpy(), dilated)
    eroded = np.stack([scipy.ndimage.binary_erosion(~m, footprint, border_value=1) for m in mask])
    assert np.array_equal(erode(~tensor, radius, shape)[:, 0].numpy(), eroded)
