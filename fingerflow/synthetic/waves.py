"""Wave components of the skin formulas: plane waves in many directions, and a lattice of pores."""

import math

import torch
from torch import Tensor

#: Wave vector (rad/mm) and phase (rad) of each wave.
Waves = list[list[float]]


def plane_waves(wavelengths: list[float], generator: torch.Generator) -> Waves:
    """Return one plane wave, as wave numbers (rad/mm) along x and y and a random phase, for each wavelength (mm), with
    directions spread over the half circle.
    """
    count = len(wavelengths)
    angles = (torch.arange(count) * 0.618 + torch.rand(1, generator=generator)) * math.pi
    angles = angles + 0.3 * (torch.rand(count, generator=generator) - 0.5)
    phases = 2 * math.pi * torch.rand(count, generator=generator)
    return [
        [2 * math.pi / length * math.cos(angle), 2 * math.pi / length * math.sin(angle), phase]
        for length, angle, phase in zip(wavelengths, angles.tolist(), phases.tolist(), strict=True)
    ]


def add_waves(plane: Tensor, waves: Waves, amplitude: float, x: Tensor, y: Tensor) -> Tensor:
    """Return an image `plane` plus plane waves of equal `amplitude`, evaluated at positions (x, y) in mm."""
    for wave_x, wave_y, offset in waves:
        plane = plane.add(torch.sin((wave_x * x).add(y, alpha=wave_y).add(offset)), alpha=amplitude)
    return plane


def pore_lattice(first: float, second: float, generator: torch.Generator) -> Waves:
    """Return two plane waves of given wavelengths (mm) and random phases, whose directions differ by 70 degrees; their
    common maxima are the pores.
    """
    angle = math.pi * torch.rand(1, generator=generator).item()
    phases = (2 * math.pi * torch.rand(2, generator=generator)).tolist()
    directions = (angle, angle + math.radians(70))
    return [
        [2 * math.pi / length * math.cos(direction), 2 * math.pi / length * math.sin(direction), phase]
        for length, direction, phase in zip((first, second), directions, phases, strict=True)
    ]


def pore_depth(lattice: Waves, x: Tensor, y: Tensor) -> Tensor:
    """Return the dimensionless pore depth at positions (x, y), mm: 16 at the centre of a pore, 0 between pores."""
    (a_x, a_y, a_offset), (b_x, b_y, b_offset) = lattice
    rows = torch.cos((a_x * x).add(y, alpha=a_y).add(a_offset))
    crossing_rows = torch.cos((b_x * x).add(y, alpha=b_y).add(b_offset))
    return ((rows + 1) * (crossing_rows + 1)).square()
