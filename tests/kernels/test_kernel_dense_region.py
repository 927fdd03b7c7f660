"""Compiled regions, components and moments of masks: the portable ops bit for bit."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import SHAPES, images

from fingerflow import kernels
from fingerflow.ops.components import fill_holes, largest_component
from fingerflow.ops.dense_region import dense_region
from fingerflow.ops.ellipse import fit_ellipse, mask_moments

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]
LARGEST = kernels.LARGEST_DENSITY_RADIUS


def blobs(shape: tuple[int, int, int], share: float) -> torch.Tensor:
    """A mask of patches of about 4 px, of about this share of the pixels."""
    batch, height, width = shape
    coarse = images((batch, height // 4 + 2, width // 4 + 2), torch.uint8, "random", highest=249) < 250 * share
    return coarse.repeat_interleave(4, 2).repeat_interleave(4, 3)[..., 1 : 1 + height, 2 : 2 + width]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_regions(portable: Portable, instruction_set: int, shape: tuple[int, int, int], share: float) -> None:
    mask = blobs(shape, share)
    for radius in (1, 2, 8, LARGEST):
        assert torch.equal(dense_region(mask, radius), portable(lambda r=radius: dense_region(mask, r)))


def test_a_full_frame_reaches_the_largest_sums(portable: Portable, instruction_set: int) -> None:
    mask = torch.ones(1, 1, 220, 230, dtype=torch.bool)
    mask[..., 150:, 170:] = False
    assert torch.equal(dense_region(mask, LARGEST), portable(lambda: dense_region(mask, LARGEST)))


@pytest.mark.parametrize("op", [fill_holes, largest_component, mask_moments])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.5, 0.6, 0.97, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_parts_and_moments(
    portable: Portable, shape: tuple[int, int, int], share: float, op: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    for mask in (blobs(shape, share), images(shape, torch.uint8, "random", highest=249) < 250 * share):
        assert torch.equal(op(mask), portable(lambda m=mask: op(m)))


def test_moments_on_each_instruction_set(portable: Portable, instruction_set: int) -> None:
    mask = images((3, 70, 131), torch.uint8, "random") < 90
    assert torch.equal(mask_moments(mask), portable(lambda: mask_moments(mask)))


@pytest.mark.parametrize("shape", [(0, 5, 6), (1, 1, 1), (2, 130, 1), (5, 37, 41), (2, 33, 800)])
def test_ellipses(portable: Portable, shape: tuple[int, int, int]) -> None:
    for mask in (blobs(shape, 0.4), blobs(shape, 1.0), blobs(shape, 0.0)):
        for ours, theirs in zip(fit_ellipse(mask), portable(lambda m=mask: fit_ellipse(m)), strict=True):
            assert ours.shape == theirs.shape
            torch.testing.assert_close(ours, theirs, rtol=1e-12, atol=1e-9, equal_nan=True)


def test_views_and_threads(portable: Portable) -> None:
    """One frame in bands of rows, and a frame a thread."""
    masks = blobs((5, 300, 220), 0.5)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3, 7):
            torch.set_num_threads(threads)
            for view in (masks, masks[1:2, ..., 3:], masks[::3, :, 7:290, 5:201], masks[..., ::2]):
                for op in (fill_holes, largest_component, mask_moments, lambda mask: dense_region(mask, 6)):
                    assert torch.equal(op(view), portable(lambda op=op, view=view: op(view)))
    finally:
        torch.set_num_threads(before)


def test_refuses_what_does_not_fit() -> None:
    mask = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    for radius in (0, LARGEST + 1):
        with pytest.raises(ValueError, match=f"{radius} was asked for"):
            kernels.dense_region(mask, radius)
    with pytest.raises(TypeError, match="uint8"):
        kernels.fill_holes(mask.byte())
    with pytest.raises(ValueError, match="65536 px wide"):
        kernels.mask_moments(torch.zeros(1, 1, 1, 65536, dtype=torch.bool))
