"""Ridges along an orientation field as one formula: arch, loop and whorl, with endings and bifurcations.

The orientation is the zero-pole model of Sherlock & Monro (1993): ridges run along Q(z)^(1/2) dz = real, where Q is 1
far away, has a pole at each core and a zero at each delta. With v = Im integral Q^(1/2) dz, cos(k v) has such ridges
for any k, but their distance grows as |Q|^(-1/2), whereas that of skin is constant. So several such waves share the
plane, each where its ridges have about the right distance. Where two of them meet, one side has more ridges than the
other, and their sum has phase singularities. These are the endings and bifurcations of the AM-FM model of
Larkin & Fletcher (2007). The sum's amplitude falls to 0 there, so the ridges are differentiable there too.

Around a core or a delta v changes its sign, which leaves cos(k v) unchanged: every branch of the roots is valid. Around
the delta of a loop v also changes by pi Re(delta), so the wave numbers must be multiples of 2 / Re(delta) there.
"""

import cmath
import math
from collections.abc import Callable

import torch
from torch import Tensor

#: Ratio of the wave numbers of two neighbouring waves: about a fifth of the ridges ends on the line where they meet.
RATIO = 1.22
#: Reach of a wave, in units of the distance between log wave numbers of successive waves; at most 1.5.
REACH = 1.3
#: Distance (mm) from a core within which the frequency of the model is limited, as it would be infinite at the core.
CORE = 0.45
#: Share of the full amplitude below which the amplitude of the sum is not equalised: it sets the size of a singularity.
FLOOR = 0.15

#: Function from positions relative to the core (mm) to the level v (mm) and the density of levels relative to far away.
Levels = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


#: Orientation field of ridges as a formula: a function of position that returns a level, whose contours are the ridges,
#: and the local density of these contours; and a step (rad/mm) of which wave numbers are multiples, 0 for none.
Pattern = tuple[Levels, float]


def ridges(pattern: Pattern, wave_number: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Return the height of the ridges of a pattern, inside (-1, 1) and 1 on a crest, at positions (x, y) in mm from the
    core of the fingerprint.

    Args:
        pattern: the orientation field.
        wave_number: desired at each position, rad/mm: 2 pi over the ridge distance.
    """
    levels, step = pattern
    level, density = levels(x, y)
    spacing = math.log(RATIO)
    exact = (torch.log(wave_number / density.clamp(min=1e-3)) / spacing).clamp(-5, 50)
    nearest = torch.round(exact)
    even, odd, total = torch.zeros_like(x), torch.zeros_like(x), torch.zeros_like(x)
    for offset in (-1, 0, 1):
        number = nearest + offset
        # The weight is twice continuously differentiable, so that the end of a wave is not visible.
        weight = (1 - ((exact - number) / REACH).square()).clamp(min=0) ** 3
        k = torch.exp(number * spacing)
        if step:
            k = torch.round(k / step).clamp(min=1) * step
        phase = k * level
        even, odd, total = even + weight * torch.cos(phase), odd + weight * torch.sin(phase), total + weight
    return even / torch.sqrt(even.square() + odd.square() + (FLOOR * total).square())


def arch() -> Pattern:
    """Return the orientation field of an arch: ridges from side to side that rise in the middle."""
    height, width, reach = 2.2, 2.4, 4.0

    def levels(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        rise = height * torch.exp(x.square() * (-0.5 / width**2) - y.square() * (0.5 / reach**2))
        across, down = rise * x / width**2, 1 - rise * y / reach**2
        return y + rise, torch.sqrt(across.square() + down.square())

    return levels, 0.0


def loop(delta: complex = 4.6 + 4.4j) -> Pattern:
    """Return the orientation field of a loop fingerprint that has its core at the origin and its delta, where three
    ridge systems meet, at the complex position `delta` (mm).

    Q = (z - delta) / z. With A² = z and B² = z - delta the integral from the core is
    A B - delta log((A + B) / (-delta)^(1/2)).
    """

    def levels(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        z = torch.complex(x, y)
        a, b = torch.sqrt(z), torch.sqrt(z - delta)
        level = (a * b - delta * torch.log((a + b) / cmath.sqrt(-delta))).imag
        from_core, from_delta = x.square() + y.square(), (x - delta.real).square() + (y - delta.imag).square()
        return level, ((from_delta + CORE**2) / (from_core + CORE**2)) ** 0.25

    return levels, 2 / abs(delta.real)


def whorl(across: float = 5.0, down: float = 5.0) -> Pattern:
    """Return the orientation field of a whorl that has its core at the origin and deltas at (+-across, down), mm.

    Q = (z - delta_1) (z - delta_2) / z². With w = z - i down, R² = w² - across² and h² = across² + down² the integral
    from a delta has the imaginary part Im R - down log|(w + R) / across| - h log|(-i down w - across² + i h R) /
    (across z)|. Towards the core it grows as the logarithm of the distance. Rings at equal distances are levels of the
    Gudermannian of v / h there. That is an odd function of v with slope 1 at 0, where the levels through the deltas
    lie: the sign of v has no effect.
    """
    far = math.hypot(across, down)

    def levels(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        # Shift the core by a millionth of a mm off every pixel, which avoids the logarithm of 0.
        z = torch.complex(x + 1e-6, y + 1e-6)
        w = z - 1j * down
        root = torch.sqrt(w - across) * torch.sqrt(w + across)
        # Choose the branch without cancellation near the core.
        steady, turning = -1j * down * w - across**2, 1j * far * root
        root = torch.where((steady * turning.conj()).real < 0, -root, root)
        turn = steady + 1j * far * root
        level = root.imag - down * torch.log(torch.abs(w + root) / across)
        level = level - far * torch.log(torch.abs(turn / z) / across)
        from_core = torch.sqrt(x.square() + y.square() + 1e-4)
        density = torch.sqrt(torch.abs(w - across) * torch.abs(w + across)) / from_core
        # Blend from the Gudermannian near the core to v itself far away, over the ring in which the deltas lie.
        inverse = (torch.sigmoid((0.65 * far - from_core) / (0.1 * far)) + 1e-3) / far
        share = level * inverse
        return 2 * torch.atan(torch.tanh(share / 2)) / inverse, density / torch.cosh(share.clamp(-60, 60))

    return levels, 0.0
