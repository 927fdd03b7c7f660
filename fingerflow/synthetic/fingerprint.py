"""A fingertip's skin as a formula: loop, whorl or arch, with minutiae, pores, and ridges that break at the border."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.synthetic.ridge_pattern import Pattern, arch, loop, ridges, whorl
from fingerflow.synthetic.waves import Waves, add_waves, plane_waves, pore_depth, pore_lattice

PATTERNS: dict[str, Callable[[], Pattern]] = {"loop": loop, "whorl": whorl, "arch": arch}
#: Radius of curvature, mm, of the ridges across the fingertip.
BOW = 15.0


@dataclass(frozen=True)
class FingerprintTexture:
    """Fingerprint as a function of material coordinates (mm, x right, y down, fingertip up).

    Grey level and contact are a formula, defined at every real-valued position and continuously differentiable. Ridge
    endings and bifurcations follow from the formula (`ridge_pattern`), about one in 3 mm². Ridges touch above a height.
    The height is lower at a pore, uneven along each ridge, and reduced near the edge of the contact, where the
    pressure is low: there ridges become thin and break up.

    Args:
        pattern: loop, whorl or arch.
        centre: core, mm.
        period: distance between ridges, mm.
        seed: draws the undulation of the ridges, the unevenness, the pores and the grain.
        pores: depth of the pores as contrast; as height, in units of the ridges' amplitude, it is twice that.
        grain: amplitude of the sum of plane waves (wavelengths of 0.25 to 1 mm), as contrast; the ridges have the rest.
        uneven: amplitude of the sum of plane waves (0.6 to 3.2 mm) in the height, in units of the ridges' amplitude.
        border: loss of height at the edge of the contact, in the same unit.
        border_width: distance (mm) from the edge over which that loss falls to 1/e.
    """

    pattern: str = "loop"
    centre: tuple[float, float] = (0.0, 0.0)
    period: float = 0.46
    seed: int = 0
    pores: float = 0.6
    grain: float = 0.3
    uneven: float = 1.1
    border: float = 0.4
    border_width: float = 0.5
    _waves: dict[str, Waves] = field(init=False, repr=False, compare=False)
    _pattern: Pattern = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise FingerflowError(f"{self.pattern!r} is no pattern of ridges; choose one of {', '.join(PATTERNS)}")
        generator = torch.Generator().manual_seed(self.seed)
        waves = {
            "right": plane_waves([2.9, 4.1, 6.5], generator),
            "down": plane_waves([3.3, 4.7, 7.3], generator),
            "spacing": plane_waves([2.7, 3.9, 5.5], generator),
            "uneven": plane_waves([0.6, 0.75, 0.95, 1.2, 1.6, 2.2, 3.2], generator),
            "grain": plane_waves([0.25, 0.31, 0.39, 0.5, 0.68, 1.0], generator),
            "pores": pore_lattice(0.62, 0.74, generator),
        }
        object.__setattr__(self, "_waves", waves)
        object.__setattr__(self, "_pattern", PATTERNS[self.pattern]())

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the skin's contrast, within (-1, 1) and bright on ridges, at material positions (x, y), in mm."""
        ridge = self.ridges(x, y)
        contrast = (1 - self.grain) * ridge - (ridge + 1) * pore_depth(self._waves["pores"], x, y) * (self.pores / 32)
        return add_waves(contrast, self._waves["grain"], self.grain / len(self._waves["grain"]), x, y)

    def ridge_margin(self, x: Tensor, y: Tensor, share: float, depth: Tensor) -> Tensor:
        """Return the signed distance, mm, from positions (x, y) to the edge of the part of a ridge that touches the
        glass (a `share` of its width, less near the contact border, `depth` mm away), positive inside.

        Pores and the border of the contact narrow the ridges.
        """
        height = self.ridges(x, y) - pore_depth(self._waves["pores"], x, y) * (self.pores / 8)
        loose = torch.exp(depth.clamp(min=-self.border_width) / -self.border_width)
        waves = self._waves["uneven"]
        uneven = add_waves(torch.zeros_like(x), waves, self.uneven / len(waves), x, y)
        touching = height + uneven * (1 + loose / 2) - self.border * loose - math.cos(math.pi * share)
        return touching * (self.period / (2 * math.pi))

    def ridges(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the ridge height, within (-1, 1) and 1 on a crest, at material positions (x, y), mm."""
        across, down = x - self.centre[0], y - self.centre[1]
        right = add_waves(across, self._waves["right"], 0.06, x, y)
        below = add_waves(down - across.square() * (0.5 / BOW), self._waves["down"], 0.06, x, y)
        spacing = torch.exp(add_waves(torch.zeros_like(x), self._waves["spacing"], 0.04, x, y))
        return ridges(self._pattern, spacing * (2 * math.pi / self.period), right, below)
