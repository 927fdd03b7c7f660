"""Tests of the modules from images to images: they compute what the ops do, alone and in kornia's containers."""

import torch
from kornia.augmentation import AugmentationSequential, RandomHorizontalFlip
from kornia.augmentation.container import ImageSequential

from fingerflow.graphs import MedianFilter, NormalizeIllumination
from fingerflow.ops import median_filter, normalize_illumination

torch.manual_seed(0)
EMPTY = 150 + 50 * torch.rand(1, 1, 24, 32)
DARK = 5 + torch.rand(1, 1, 24, 32)
FRAMES = 200 * torch.rand(3, 1, 24, 32)


def test_modules_compute_what_the_ops_do() -> None:
    light = normalize_illumination(FRAMES, EMPTY, DARK).frames
    assert torch.equal(NormalizeIllumination(EMPTY, DARK)(FRAMES), light)
    assert torch.equal(NormalizeIllumination(EMPTY)(FRAMES), normalize_illumination(FRAMES, EMPTY).frames)
    assert torch.equal(MedianFilter(5)(FRAMES), median_filter(FRAMES, 5))


def test_the_empty_glass_moves_with_the_module() -> None:
    """The reference and the dark picture are buffers: they are stored with a module and change dtype with it."""
    module = NormalizeIllumination(EMPTY, DARK)
    assert set(module.state_dict()) == {"reference", "dark"}
    assert module.double()(FRAMES).dtype == torch.float64


def test_modules_are_steps_of_kornia() -> None:
    """In kornia's containers the modules act on frames, and leave keypoints to the augmentations."""
    steps = NormalizeIllumination(EMPTY, DARK), MedianFilter(3)
    expected = median_filter(normalize_illumination(FRAMES, EMPTY, DARK).frames, 3)
    assert torch.equal(ImageSequential(*steps)(FRAMES), expected)
    augment = AugmentationSequential(
        ImageSequential(*steps), RandomHorizontalFlip(p=1.0), data_keys=["input", "keypoints"]
    )
    flipped, moved = augment(FRAMES, torch.tensor([[[3.0, 4.0]]]).repeat(3, 1, 1))
    assert torch.equal(flipped, expected.flip(3))
    torch.testing.assert_close(moved, torch.tensor([[[28.0, 4.0]]]).repeat(3, 1, 1))
