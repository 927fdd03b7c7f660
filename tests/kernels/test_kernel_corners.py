"""The compiled corners of uint8 frames beside the portable ones, bit for bit."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking.corners import Corners, detect_corners

Portable = Callable[[Callable[[], object]], Any]


def texture(*shape: int, seed: int = 1) -> Tensor:
    """Noise that is smooth in x, with saturation at either end."""
    noise = torch.rand(*shape, generator=torch.Generator().manual_seed(seed)) * 3 - 1
    noise = (noise + noise.roll(1, -1)) / 2
    return (noise * 255).clamp(0, 255).to(torch.uint8)


def assert_same(portable: Portable, find: Callable[[], Corners], at_least: int = 1) -> None:
    found, expected = find(), portable(find)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)
    assert found.valid.sum() >= at_least


@pytest.mark.parametrize("window", [1, 3, 5, 7, 9, 11, 13, 15])
@pytest.mark.parametrize("shape", [(1, 1, 3, 3), (2, 1, 63, 17), (1, 1, 130, 65), (3, 1, 65, 200)])
def test_same_corners(instruction_set: int, portable: Portable, shape: tuple[int, ...], window: int) -> None:
    frames = texture(*shape)
    enough = 0 if window == 1 or min(shape[2:]) < 10 else 1
    assert_same(portable, lambda: detect_corners(frames, 100, 5.0, window=window, noise=0.3), enough)
    assert_same(portable, lambda: detect_corners(frames, 10**4, 0.0, window=window, quality=0.0, noise=0.0), enough)


@pytest.mark.parametrize("distance", [0.0, 1.0, 2**0.5, 2.0, 4.9, 10.0, 23.3, 1e6])
def test_same_distances(portable: Portable, distance: float) -> None:
    frames = texture(2, 1, 90, 110)
    assert_same(portable, lambda: detect_corners(frames, 5000, distance, noise=0.0), 2)


def test_more_candidates_than_are_sorted_at_once(portable: Portable) -> None:
    frames = texture(1, 1, 300, 400)
    assert_same(portable, lambda: detect_corners(frames, 10**5, 1.0, window=3, quality=0.0, noise=0.0), 5000)


def test_same_among_equals(instruction_set: int, portable: Portable) -> None:
    """A tiled frame repeats every response exactly: reading order decides."""
    frames = texture(1, 1, 16, 16).repeat(1, 1, 9, 10)
    assert_same(portable, lambda: detect_corners(frames, 300, 3.0, noise=0.0), 100)
    flat = torch.zeros(1, 1, 40, 40, dtype=torch.uint8)
    flat[..., ::8, :] = 255
    flat[..., ::8] = 255
    assert_same(portable, lambda: detect_corners(flat, 300, 2.0, noise=0.0))


@pytest.mark.parametrize("border", [0, 1, 20, 1000])
def test_same_within_mask_and_border(instruction_set: int, portable: Portable, border: int) -> None:
    frames = texture(2, 1, 80, 90, seed=3)
    masks = torch.rand(2, 1, 80, 90, generator=torch.Generator().manual_seed(4)) > 0.4
    for mask in (masks, masks[:1], torch.zeros_like(masks), masks.mT.contiguous().mT):
        assert_same(portable, lambda mask=mask: detect_corners(frames, 50, 4.0, mask, border=border), 0)


def test_frames_that_are_not_contiguous(portable: Portable) -> None:
    frames = texture(4, 1, 60, 80)
    views = (frames[::2, :, 3:50, 7:70], frames.transpose(2, 3), frames[..., ::2], frames[:1].expand(3, 1, 60, 80))
    for view in views:
        assert_same(portable, lambda view=view: detect_corners(view, 40, noise=0.0))


def test_nothing_to_find(portable: Portable) -> None:
    for frames in (torch.full((2, 1, 20, 30), 255, dtype=torch.uint8), texture(0, 1, 20, 30), texture(1, 1, 1, 1)):
        assert_same(portable, lambda frames=frames: detect_corners(frames, 5, noise=1.0), 0)
    assert_same(portable, lambda: detect_corners(texture(1, 1, 20, 30), 0), 0)


def test_threads_change_nothing() -> None:
    frames, before, found = texture(2, 1, 200, 90), torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            found.append(detect_corners(frames, 300, 3.0, noise=0.0))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found[0].points.nan_to_num(), found[1].points.nan_to_num())


def test_what_does_not_belong_together_is_refused() -> None:
    frames, settings = texture(1, 1, 20, 30), {"count": 5, "min_distance": 3.0, "quality": 0.01, "border": 0}
    with pytest.raises(TypeError, match="float32"):
        kernels.corners(frames.float(), None, torch.zeros(1), window=7, **settings)
    with pytest.raises(ValueError, match="17"):
        kernels.corners(frames, None, torch.zeros(1), window=17, **settings)
    with pytest.raises(ValueError, match="floors"):
        kernels.corners(frames, None, torch.zeros(2), window=7, **settings)
    with pytest.raises(ValueError, match="mask"):
        kernels.corners(frames, torch.ones(1, 1, 20, 31, dtype=torch.bool), torch.zeros(1), window=7, **settings)
