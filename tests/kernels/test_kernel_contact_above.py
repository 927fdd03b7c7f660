"""The fused path from counts to what touches by a given threshold: its ops one by one bit for bit."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import SHAPES, images

from fingerflow import kernels
from fingerflow.ops.contact_above import contact_above

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]
THRESHOLDS = torch.tensor([0.25, torch.nan, -0.5, 0.9, 0.5], dtype=torch.float64)


@pytest.mark.parametrize("size", [1, 3, 15])
@pytest.mark.parametrize("content", ["two levels", "random"])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_as_the_ops(
    portable: Portable, instruction_set: int, shape: tuple[int, int, int], content: str, size: int
) -> None:
    frames = images(shape, torch.uint8, content)
    reference = images((1, *shape[1:]), torch.float32, "random", seed=5)
    threshold = THRESHOLDS[: shape[0]]

    def above() -> torch.Tensor:
        return contact_above(frames, reference, threshold=threshold, median_px=size)

    assert torch.equal(above(), portable(above))


def test_what_is_not_known_does_not_touch(portable: Portable) -> None:
    strange = torch.tensor([torch.nan, torch.inf, -torch.inf, 0.0, -5.0, 3e38, 100.0, 40.0])
    frames = strange.repeat(40, 5)[None, None]
    reference = frames.roll(3, -1).transpose(2, 3).contiguous()[..., :40]
    for threshold in (-0.1, 0.3, 1.0):

        def above(limit: float = threshold) -> torch.Tensor:
            return contact_above(frames, reference, threshold=torch.tensor([limit]), median_px=3)

        assert torch.equal(above(), portable(above))


def test_dark_views_and_threads(portable: Portable) -> None:
    both = images((3, 140, 200), torch.uint16, "random", highest=4095)
    frames, reference, dark = both[..., :100], both[..., 100:], both[:1, ..., 50:150] / 64

    def above() -> torch.Tensor:
        return contact_above(frames, reference, dark, threshold=THRESHOLDS[:3].float(), median_px=5)

    expected = portable(above)
    before = torch.get_num_threads()
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            assert torch.equal(above(), expected)
    finally:
        torch.set_num_threads(before)


def test_refuses_what_does_not_fit() -> None:
    frames = torch.zeros(2, 1, 8, 8)
    with pytest.raises(ValueError, match="reference has shape"):
        contact_above(frames, frames[..., :7], threshold=torch.zeros(2))
    with pytest.raises(ValueError, match="for 2 frames"):
        contact_above(frames, frames, threshold=torch.zeros(3))
    with pytest.raises(ValueError, match="4 x 4"):
        contact_above(frames, frames, threshold=torch.zeros(2), median_px=4)
    with pytest.raises(ValueError, match="17 was asked for"):
        kernels.contact_above(frames, frames, None, 0.05, torch.zeros(2, dtype=torch.float64), 17)
