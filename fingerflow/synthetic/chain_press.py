"""A fingertip pressed on glass as the skin chain has it: how far its skin spreads depends on friction."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.ndimage import spline_filter
from torch import Tensor

from fingerflow.models.skin_chain import PressedChain as Chain
from fingerflow.models.skin_chain import follow
from fingerflow.models.skin_onset import SinceOnset, since_onset
from fingerflow.models.skin_parameters import named
from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.scenes import Array, SyntheticScene
from fingerflow.synthetic.spline import cubic_weights

_TIMES = 257  # of the chain during the rise
_KNOTS = 32  # steps of the splines in time: contact grows by elements, which they even out
_RADII = 96  # steps of the spline from the axis to the side of the finger
_SIDE = 0.95  # of the finger's radius: beyond, skin stands upright and is not seen from below


@dataclass(frozen=True, kw_only=True)
class ChainPress(SyntheticScene):
    """A press whose skin moves as a skin chain turned about its axis, under a force that rises as sin² and is held.

    Contact is a disc, displacement is radial, and both are those of the chain; what the chain gave up to the end of the
    rise stays. Settings that all scenes share are those of `SyntheticScene`.

    Args:
        friction: coefficient between skin and glass.
        parameters: of the chain, "paper" or "lab", whose contact is half as large.
        softness: what their stiffnesses are divided by.
        force: at the end, N.
        contact_time: s from the trigger to first contact.
        rise_time: s from first contact to the full force.
        elements: of the chain.
    """

    friction: float = 0.2
    parameters: str = "paper"
    softness: float = 1.0
    force: float = 5.0
    contact_time: float = 0.02
    rise_time: float = 0.9
    elements: int = 1001

    @cached_property
    def chain(self) -> Chain:
        """At even times of the rise, first contact and full force among them."""
        time = torch.linspace(0, self.rise_time, _TIMES, dtype=torch.float64)
        load = torch.from_numpy(self.normal_force(time.numpy() + self.contact_time))
        skin = named(self.parameters).softer(self.softness)
        return follow(self.friction, time, load, parameters=skin, elements=self.elements)

    @cached_property
    def chain_since_onset(self) -> SinceOnset:
        """What the chain itself says, without pictures and splines: what is to be recovered."""
        return since_onset(self.chain)

    def chain_at(self, values: Tensor) -> Array:
        """Numbers (T,) of the chain's times at those of the frames, NaN before contact."""
        share = self.progress(self.times)
        return np.where(share > 0, np.interp(share, np.linspace(0, 1, _TIMES), values.numpy()), np.nan)

    @cached_property
    def motion(self) -> "RadialMotion":
        x = 1e3 * (self.chain.position[..., 0] - self.chain.position[..., 0].flip(-1)).numpy() / 2
        undeformed = x[0]
        seen = np.abs(undeformed) <= _SIDE * undeformed[-1]
        side = float(x[:, seen][:, -1].min())
        radius = np.linspace(0, side, _RADII + 1)
        share = np.empty((_TIMES, _RADII + 1))
        for row, place in zip(share, x, strict=True):
            moved = CubicSpline(place[seen], (place - undeformed)[seen])
            row[0], row[1:] = moved(0.0, 1), moved(radius[1:]) / radius[1:]
        square = (500 * self.chain.contact_length.numpy()) ** 2
        return RadialMotion(self.contact_centre, side, _coefficients(_evened(share)), _coefficients(_evened(square)))

    def progress(self, time: Array) -> Array:
        return np.clip((time - self.contact_time) / self.rise_time, 0, 1)

    def time_of(self, progress: Array) -> Array:
        return self.contact_time + self.rise_time * progress

    def normal_force(self, time: Array) -> Array:
        return self.force * np.sin(math.pi / 2 * self.progress(time)) ** 2

    def tangential_force(self, time: Array) -> Array:
        return np.zeros_like(time)


@dataclass(frozen=True, eq=False)
class RadialMotion:
    """A disc of contact that grows under skin which spreads from its centre by as much as splines say.

    Progress is the share of the rise that has gone. With r the distance from the centre, material = position (1 - s),
    s(r, progress) a bicubic spline, even in r; the square of the disc's radius is a cubic spline of progress. Both are
    even at either end of the progress: force begins and ends without a slope.

    Args:
        centre: of the contact, mm.
        side: radius (mm) where the spline ends; beyond, s is that of its end.
        share: coefficients (K + 3, M + 3) of s, from progress 0 to 1 and radius 0 to ``side``, each with one around.
        square: coefficients (K + 3,) of the square of the radius of the contact, mm².
    """

    centre: tuple[float, float]
    side: float
    share: Tensor
    square: Tensor

    # The contact outruns the skin, so a point that is inside stays inside.
    entry_steps = 1

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        right, down = x - self.centre[0], y - self.centre[1]
        # The summand is below the rounding of any position that matters; it gives the centre a gradient, not NaN.
        radius = torch.sqrt(right.square() + down.square() + 1e-30)
        rows, columns = self.share.shape
        first, weights = _place(progress, rows - 3)
        table = self.share.to(x.dtype)
        start, across = _place(radius / self.side, columns - 3)
        if progress.numel() == 1:  # of a picture: one row for all pixels
            four = torch.stack([weight.reshape(()) for weight in weights])
            spread = _line(four @ table[int(first) : int(first) + 4], start, across)
        else:
            flat, spread = table.flatten(), torch.zeros_like(radius)
            for k, weight in enumerate(weights):
                spread = spread + weight * _line(flat, (first + k) * columns + start, across)
        return x - spread * right, y - spread * down

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        square = self._square(progress)
        right, down = x - self.centre[0], y - self.centre[1]
        return (square - right.square() - down.square()) / float(self._square(torch.ones(1, dtype=torch.float64)))

    def ellipse(self, progress: float) -> Ellipse | None:
        square = float(self._square(torch.tensor(progress, dtype=torch.float64))) if progress > 0 else 0.0
        return Ellipse(self.centre, (math.sqrt(square), math.sqrt(square))) if square > 1e-6 else None

    def _square(self, progress: Tensor) -> Tensor:
        start, weights = _place(progress, len(self.square) - 3)
        return _line(self.square.to(progress.dtype), start, weights)


def _evened(values: Array) -> Array:
    """(K + 1, ...) at even times, by least squares from the chain's (T, ...); as they are at the first contact."""
    time = np.linspace(0, 1, _TIMES)
    knots = np.concatenate(([0.0] * 3, np.linspace(0, 1, _KNOTS + 1), [1.0] * 3))
    weight = np.where(time == 0, 1e3, 1.0)
    return np.asarray(make_lsq_spline(time, values, knots, k=3, w=weight)(np.linspace(0, 1, _KNOTS + 1)))


def _coefficients(values: Array) -> Tensor:
    """Of the cubic spline through values on a grid, mirrored at its ends, with one more on either side."""
    return torch.from_numpy(np.pad(spline_filter(values, order=3, mode="mirror"), 1, mode="reflect"))


def _place(share: Tensor, steps: int) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Of a share of the way over a grid: the first of its four coefficients, and their weights."""
    at = share.clamp(0, 1) * steps
    first = at.detach().nan_to_num(0.0).floor().clamp(max=steps - 1)  # NaN goes on in the weights
    return first.long(), cubic_weights(at - first)[0]


def _line(flat: Tensor, start: Tensor, weights: tuple[Tensor, ...]) -> Tensor:
    value = torch.take(flat, start) * weights[0]
    for k in range(1, 4):
        value = value.addcmul(torch.take(flat, start + k), weights[k])
    return value
