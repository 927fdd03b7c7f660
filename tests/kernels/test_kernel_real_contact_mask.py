"""Compiled limits and gains: what touches bit for bit as the portable ops have it, gains to rounding."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import CONTENTS, SHAPES, images

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.contact.light_gain import light_gain
from fingerflow.ops.contact.real_contact_mask import real_contact_mask

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]


def lit(shape: tuple[int, int, int], batch: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Light and black (batch, 1, H, W): some pixels are not lit."""
    light, black = (images((batch, *shape[1:]), torch.float32, "random", seed=seed) for seed in (1, 2))
    return (0.9 * light - 20).clamp(min=0), 0.04 * black


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("dtype", kernels.FRAME_KINDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_same_pixels(
    portable: Portable, instruction_set: int, shape: tuple[int, int, int], dtype: torch.dtype, content: str
) -> None:
    frames = images(shape, dtype, content, highest=250)
    limits = torch.linspace(0.3, 0.8, len(frames))
    for batch in {1, len(frames)}:
        light, black = lit(shape, batch)
        for size in (1, 3, 5, 9, 15):
            found = real_contact_mask(frames, light, black, limits, size)
            assert torch.equal(
                found, portable(lambda s=size, a=light, b=black: real_contact_mask(frames, a, b, limits, s))
            )


@pytest.mark.parametrize("dtype", kernels.FRAME_KINDS)
@pytest.mark.parametrize("shape", [(1, 66, 129), (2, 130, 300), (3, 256, 320)])
def test_same_gain(portable: Portable, shape: tuple[int, int, int], dtype: torch.dtype) -> None:
    light, black = lit(shape, 1)
    light, black = 120 + 0 * light, black + 3
    frames = (0.93 * light + black).expand(len(range(shape[0])), -1, -1, -1).clone()
    frames[..., : shape[1] // 2, : shape[2] // 2] *= 0.6
    frames = frames.to(dtype) if dtype.is_floating_point else frames.round().to(torch.int32).to(dtype)
    for radius in (2, 8, 20):
        gain = light_gain(frames, light, black, radius)
        assert gain.isfinite().all()
        expected = portable(lambda r=radius: light_gain(frames, light, black, r))
        torch.testing.assert_close(gain, expected, rtol=1e-5, atol=0)


def test_threads(portable: Portable, torch_threads: Callable[[int], None]) -> None:
    frames = images((5, 210, 90), torch.uint8, "random")
    light, black = lit((5, 210, 90), 1)
    limits = torch.linspace(0.3, 0.8, 5)
    expected = portable(lambda: real_contact_mask(frames, light, black, limits, 9))
    for threads in (1, 2, 3, 7):
        torch_threads(threads)
        assert torch.equal(real_contact_mask(frames, light, black, limits, 9), expected)


def test_refuses_what_does_not_fit() -> None:
    frames, image = torch.zeros(2, 1, 8, 8, dtype=torch.uint8), torch.ones(1, 1, 8, 8)
    for size in (0, 2, 17):
        with pytest.raises(ValueError, match=f"{size} was asked for"):
            kernels.real_contact_mask(frames, image, image, torch.zeros(2), size)
    with pytest.raises(ValueError, match="limits is"):
        kernels.real_contact_mask(frames, image, image, torch.zeros(3), 3)
    with pytest.raises(TypeError, match="float64"):
        kernels.real_contact_mask(frames, image.double(), image, torch.zeros(2), 3)
    with pytest.raises(ValueError, match="black of"):
        kernels.light_gain(frames, image, image[..., 1:], 16)
    with pytest.raises(ValueError, match="multiples of 8"):
        kernels.light_gain(frames, image, image, 12)
