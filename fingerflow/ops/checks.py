"""Input checks shared by ops on images."""

import torch
from torch import Tensor


def check_frames(frames: Tensor) -> None:
    """Raise ValueError unless frames have the shape (B, 1, H, W): B frames of H x W px."""
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def check_images(frames: Tensor, **images: Tensor | None) -> None:
    """Raise ValueError unless frames are (B, 1, H, W) and each other image that is given (1 or B, 1, H, W)."""
    check_frames(frames)
    for name, image in images.items():
        if image is not None and (image.shape[1:] != frames.shape[1:] or image.shape[0] not in (1, frames.shape[0])):
            raise ValueError(
                f"{name} has shape {tuple(image.shape)} beside frames of {tuple(frames.shape)}: give one image of the "
                "same size, or one for each frame"
            )


def check_pixels(frames: Tensor, least: int) -> None:
    """Raise ValueError if the height or the width of frames (B, 1, H, W) is below `least` pixels."""
    if min(frames.shape[-2:]) < least:
        raise ValueError(f"frames of {tuple(frames.shape[-2:])} px: give at least {least} x {least}")


def check_mask(mask: Tensor) -> None:
    """Raise TypeError if a mask is not bool, or ValueError if the shape of the mask is not (B, 1, H, W)."""
    if mask.dtype != torch.bool:
        raise TypeError(f"the mask is {mask.dtype}: compare it with a threshold to make it bool")
    if mask.ndim != 4 or mask.shape[1] != 1:
        raise ValueError(f"the mask has shape {tuple(mask.shape)}: give (B, 1, H, W)")


def check_window(size: int) -> None:
    """Raise ValueError unless the side of a median window is odd and positive."""
    if size < 1 or size % 2 == 0:
        raise ValueError(f"a median window of {size} x {size} has no centre pixel: use an odd size")
