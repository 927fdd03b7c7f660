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


def test_the_empty_glass_moves_with_the_module() -> None:
    """The reference and the dark picture are buffers: they are stored with a module and change dtype with it."""
    module = NormalizeIllumination(EMPTY, DARK)
    assert set(module.state_dict()) == {"reference", "dark"}
    assert module.double()(FRAMES).dtype == torch.float64


def test_modules_are_steps_of_kornia() -> None:
    """In kornia's containers the modules act on frames, and leave keypoints to the augmentations."""
    assert torch.equal(NormalizeIllumination(EMPTY)(FRAMES), normalize_illumination(FRAMES, EMPTY).frames)
    steps = ImageSequential(NormalizeIllumination(EMPTY, DARK), MedianFilter(5))
    expected = median_filter(normalize_illumination(FRAMES, EMPTY, DARK).frames, 5)
    assert torch.equal(steps(FRAMES), expected)
    augment = AugmentationSequential(steps, RandomHorizontalFlip(p=1.0), data_keys=["input", "keypoints"])
    flipped, moved = augment(FRAMES, torch.tensor([[[3.0, 4.0]]]).repeat(3, 1, 1))
    assert torch.equal(flipped, expected.flip(3))
    assert moved.tolist() == [[[28.0, 4.0]]] * 3
