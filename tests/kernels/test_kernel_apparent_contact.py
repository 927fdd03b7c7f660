"""Compiled regions to rounding, components and moments of masks bit for bit as the portable ops."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import SHAPES, images

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.contact.apparent_contact import ApparentRegion, apparent_contact

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]


def blobs(shape: tuple[int, int, int], share: float) -> torch.Tensor:
    """A mask of patches of about 4 px, of about this share of the pixels."""
    batch, height, width = shape
    coarse = images((batch, height // 4 + 2, width // 4 + 2), torch.uint8, "random", highest=249) < 250 * share
    return coarse.repeat_interleave(4, 2).repeat_interleave(4, 3)[..., 1 : 1 + height, 2 : 2 + width]


def same(found: ApparentRegion, expected: ApparentRegion) -> None:
    for name, ours, theirs in zip(ApparentRegion._fields, found, expected, strict=True):
        assert ours.shape == theirs.shape, name
        tolerance = {"density_margin": 2e-5, "angle": 1e-2}.get(name, 2e-3)
        torch.testing.assert_close(
            ours, theirs, rtol=2e-5, atol=tolerance, equal_nan=True, msg=lambda m, n=name: f"{n}: {m}"
        )


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_regions(portable: Portable, instruction_set: int, shape: tuple[int, int, int], share: float) -> None:
    mask = blobs(shape, share)
    for radius, cell in ((1, None), (2, None), (8, None), (8, 8), (30, 4), (255, 4)):
        same(apparent_contact(mask, radius, cell), portable(lambda r=radius, c=cell: apparent_contact(mask, r, c)))


def test_contacts(portable: Portable, instruction_set: int) -> None:
    """Ridges within an ellipse, with a hole and dirt, on frames of sizes that are no whole cells."""
    y, x = torch.meshgrid(torch.arange(301.0), torch.arange(403.0), indexing="ij")
    inside = torch.hypot((x - 200) / 150, (y - 140) / 110) < 1
    mask = (inside & (torch.sin(0.45 * (x + 0.3 * y)) > 0))[None, None].repeat(3, 1, 1, 1)
    mask[1, :, 120:170, 190:240] = False
    mask[2, :, 5:30, 360:400] = True
    for radius, cell in ((8, None), (8, 8), (5, None)):
        same(apparent_contact(mask, radius, cell), portable(lambda r=radius, c=cell: apparent_contact(mask, r, c)))


def test_views_and_threads(portable: Portable) -> None:
    """One frame in bands of rows, and a frame a thread."""
    masks = blobs((5, 300, 220), 0.5)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3, 7):
            torch.set_num_threads(threads)
            for view in (masks, masks[1:2, ..., 3:], masks[::3, :, 7:290, 5:201], masks[..., ::2]):
                same(apparent_contact(view, 6), portable(lambda view=view: apparent_contact(view, 6)))
    finally:
        torch.set_num_threads(before)


def test_refuses_what_does_not_fit() -> None:
    mask = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    with pytest.raises(ValueError, match="cells of 3 px"):
        kernels.apparent_contact(mask, 8, 3)
    with pytest.raises(TypeError, match="uint8"):
        kernels.apparent_contact(mask.byte(), 8, 4)
