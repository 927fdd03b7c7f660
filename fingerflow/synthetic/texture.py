"""Skin as a formula: ridges, pores and fine grain whose grey level is defined at every real-valued position."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from fingerflow.synthetic.waves import Waves, add_waves, plane_waves, pore_depth, pore_lattice

#: Largest relative change of the ridges' frequency due to one of the three undulations.
UNDULATION = 0.09

Mapping = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class RidgeTexture:
    """Whorl of papillary ridges as an infinitely differentiable function of material coordinates (mm, x right, y down).

    Calling it gives a dimensionless contrast inside [-1, 1], mean close to 0 and bright on the ridges, for tensors of
    any shape, device and floating type. It is the skin as imaged by the camera: the blur of lens and pixel is part of
    the formula, so a pixel is one evaluation at its centre. `ridge_phase` gives the ridges alone. Pores sit on their
    crests, and superposed plane waves make every neighbourhood unique.

    Spectrum: ridges have 1.4 to 2.8 cycles/mm; with pores and grain the whole spectrum ends below 7.5 cycles/mm. At
    0.0325 mm/px that is 0.24 cycles/px, half of the Nyquist limit.

    Args:
        centre: core of the whorl, mm.
        period: distance between ridges, mm.
        seed: draws the undulation of the ridges, the pores and the grain.
        pores: depth of the pores, as contrast.
        grain: amplitude of the sum of plane waves (wavelengths of 0.25 to 1 mm), as contrast; the ridges have the rest.
    """

    centre: tuple[float, float] = (0.0, 0.0)
    period: float = 0.48
    seed: int = 0
    pores: float = 0.6
    grain: float = 0.45
    _undulation: Waves = field(init=False, repr=False, compare=False)
    _pore_rows: Waves = field(init=False, repr=False, compare=False)
    _grain: Waves = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        generator = torch.Generator().manual_seed(self.seed)
        object.__setattr__(self, "_undulation", plane_waves([3.5, 5.0, 7.0], generator))
        object.__setattr__(self, "_pore_rows", pore_lattice(0.62, 0.74, generator))
        object.__setattr__(self, "_grain", plane_waves([0.25, 0.31, 0.39, 0.5, 0.68, 1.0], generator))

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the optical contrast of the skin at material positions (x, y), in mm."""
        ridge = torch.cos(self.ridge_phase(x, y))
        contrast = (1 - self.grain) * ridge - (ridge + 1) * pore_depth(self._pore_rows, x, y) * (self.pores / 32)
        return add_waves(contrast, self._grain, self.grain / len(self._grain), x, y)

    def ridge_margin(self, x: Tensor, y: Tensor, share: float, depth: Tensor) -> Tensor:
        """Return the signed distance, mm, from positions (x, y) to the edge of the part of a ridge that touches the
        glass (a `share` of its width), positive inside; `depth` is ignored.

        An equal share of every ridge touches. The distance is that of straight ridges one period apart, up to the crest
        and to the middle of the valley.
        """
        from_crest = torch.remainder(self.ridge_phase(x, y).add_(math.pi), 2 * math.pi).sub_(math.pi).abs_()
        return from_crest.neg_().add_(math.pi * share).mul_(self.period / (2 * math.pi))

    def ridge_phase(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the phase of the ridges at (x, y) in rad, 2 pi from crest to crest.

        The gradient is therefore close to 2 pi / period.
        """
        across, along = x - self.centre[0], y - self.centre[1]
        # Use an elliptic distance; the constant keeps it smooth at the core, where the innermost ridge is a small disc.
        distance = torch.sqrt(1.14 * across.square() + 0.86 * along.square() + 0.1)
        for wave_x, wave_y, offset in self._undulation:
            wave = torch.sin((wave_x * x).add(y, alpha=wave_y).add(offset))
            distance = distance.add(wave, alpha=UNDULATION / math.hypot(wave_x, wave_y))
        return distance * (2 * math.pi / self.period)


def texture_image(
    texture: Callable[[Tensor, Tensor], Tensor],
    shape: tuple[int, int],
    mm_per_px: float,
    mapping: Mapping | None = None,
) -> Tensor:
    """Return the camera's image of a texture, evaluated at the exact material position of every pixel centre.

    Args:
        texture: contrast of a material position (x, y) in mm.
        shape: rows and columns.
        mm_per_px: size of a pixel; pixel (0, 0) has its centre at 0 mm.
        mapping: from position in the image to material position, both (x, y) in mm; None where they are the same. To
            move the image by d, map (x, y) to (x - d_x, y - d_y).

    Returns:
        (1, 1, H, W) contrast, float64.
    """
    down, right = (torch.arange(size, dtype=torch.float64) * mm_per_px for size in shape)
    y, x = torch.meshgrid(down, right, indexing="ij")
    if mapping is not None:
        x, y = mapping(x, y)
    return texture(x, y)[None, None]
