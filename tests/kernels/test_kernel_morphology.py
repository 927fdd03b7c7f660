"""Compiled dilation and erosion: the portable ones bit for bit, SciPy and OpenCV."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch
from kernel_images import SHAPES, images

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.filters.morphology import dilate, erode

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]
Shape = Literal["disc", "diamond"]


def sparse(shape: tuple[int, int, int], share: int) -> torch.Tensor:
    """A mask of `share` of 250 pixels."""
    return images(shape, torch.uint8, "random", highest=249) < share


@pytest.mark.parametrize("element", ["disc", "diamond"])
@pytest.mark.parametrize("radius", [0, 1, 2, 5, 8, 40])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_as_the_portable_ops(
    portable: Portable, instruction_set: int, shape: tuple[int, int, int], radius: int, element: Shape
) -> None:
    few, most = sparse(shape, 10), sparse(shape, 240)
    assert torch.equal(dilate(few, radius, element), portable(lambda: dilate(few, radius, element)))
    assert torch.equal(erode(most, radius, element), portable(lambda: erode(most, radius, element)))


@pytest.mark.parametrize("element", ["disc", "diamond"])
@pytest.mark.parametrize("radius", [1, 3, 8])
def test_equals_scipy_and_opencv(radius: int, element: Shape) -> None:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    near = x * x + y * y <= radius * radius if element == "disc" else abs(x) + abs(y) <= radius
    few, most = sparse((1, 90, 130), 8), sparse((1, 90, 130), 245)
    assert np.array_equal(dilate(few, radius, element)[0, 0], scipy.ndimage.binary_dilation(few[0, 0].numpy(), near))
    eroded = cv2.erode(most[0, 0].numpy().astype(np.uint8), near.astype(np.uint8))
    assert np.array_equal(erode(most, radius, element)[0, 0], eroded.astype(bool))


def test_views_and_threads(portable: Portable, torch_threads: Callable[[int], None]) -> None:
    mask = sparse((4, 100, 120), 12)
    view = mask[1::2, :, 7:90, 20:101]
    assert torch.equal(dilate(view, 4), portable(lambda: dilate(view, 4)))
    torch_threads(3)
    assert torch.equal(dilate(mask, 4), portable(lambda: dilate(mask, 4)))


def test_refuses_what_does_not_fit() -> None:
    mask = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    with pytest.raises(TypeError, match="uint8"):
        kernels.dilate(mask.byte(), [0], of_background=False)
    for rows in ([1, 0, 1], [0, 2, 0], [0, 0], [0, 1, 1]):
        with pytest.raises(ValueError, match="grow towards the middle"):
            kernels.dilate(mask, rows, of_background=False)
