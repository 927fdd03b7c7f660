"""Camera model: grey levels with shot noise, read noise, defective pixels and quantisation."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.schema.views import View


@dataclass(frozen=True)
class Camera:
    """Simulated monochrome camera with shot noise, read noise and defective pixels.

    Levels are given for 8 bits, and scale with the range of a camera of more bits.

    Args:
        bit_depth: 8 to 16; frames are uint8 for 8 bit and uint16 above.
        dark: grey level without light.
        noise: standard deviation at half of the range, in grey levels, without the quantisation.
        shot_share: share of that variance that is shot noise, growing in proportion to the light; the rest is constant.
        salt_and_pepper: share of the pixels at 0 or at full range, in images with defects.
        seed: of all of the noise.
    """

    bit_depth: int = 8
    dark: float = 2.0
    noise: float = 2.0
    shot_share: float = 0.5
    salt_and_pepper: float = 0.002
    seed: int = 0

    def __post_init__(self) -> None:
        if not 8 <= self.bit_depth <= 16:
            raise ValueError(f"bit_depth is {self.bit_depth}; a camera of 8 to 16 bit can be simulated")
        if not 0 <= self.shot_share <= 1:
            raise ValueError(f"shot_share is {self.shot_share}; it is a share of the variance, from 0 to 1")

    @property
    def full_range(self) -> int:
        """Return the camera's largest grey level."""
        return 2**self.bit_depth - 1

    @property
    def levels(self) -> float:
        """Return how many grey levels of this camera correspond to one 8-bit grey level."""
        return self.full_range / 255

    def expose(self, light: Tensor) -> Tensor:
        """Convert light, in 8-bit levels above the dark level, to this camera's noise-free, unrounded grey levels."""
        return (light + self.dark) * self.levels

    def variance(self, clean: Tensor) -> Tensor:
        """Return the noise variance, squared grey levels, of pixels with noise-free levels `clean`, before
        quantisation.
        """
        scale, dark = self.levels, self.dark * self.levels
        at_half = (self.noise * scale) ** 2
        shot = at_half * self.shot_share / (127.5 * scale - dark)
        return (clean - dark).clamp(min=0) * shot + at_half * (1 - self.shot_share)

    def read_out(self, clean: Tensor, picture: int, defects: View | None = None) -> NDArray[np.integer]:
        """Return the noisy image (H, W) that the camera delivers for the noise-free grey levels `clean`; the same
        `picture` number always gives the same noise.

        Args:
            clean: noise-free grey levels (H, W).
            picture: number of the image; each has its own noise.
            defects: the part of the image with salt-and-pepper noise.
        """
        generator = torch.Generator().manual_seed(self.seed * 0x9E3779B1 + picture + 2**31)
        noise = torch.randn(clean.shape, generator=generator, dtype=torch.float32)
        grey = noise.mul_(self.variance(clean).sqrt_()).add_(clean).round_().clamp_(0, self.full_range)
        if defects is not None:
            part = defects.crop(grey)
            height, width = part.shape
            count = round(self.salt_and_pepper * height * width)
            rows, columns = (torch.randint(size, (count,), generator=generator) for size in (height, width))
            part[rows, columns] = torch.randint(2, (count,), generator=generator) * float(self.full_range)
        return grey.numpy().astype(np.uint8 if self.bit_depth == 8 else np.uint16)
