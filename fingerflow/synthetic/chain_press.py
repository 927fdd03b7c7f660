"""Synthetic press of a fingertip simulated by the skin chain, so that the spread of the skin depends on friction."""

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
from fingerflow.synthetic.grid_spline import cubic_weights
from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.scenes import Array, SyntheticScene

_TIMES = 257  # times of the chain during the rise
_KNOTS = 32  # intervals of the splines in time; they smooth the growth of contact by elements
_RADII = 96  # intervals of the spline from the axis to the side of the finger
_SIDE = 0.95  # of the finger's radius: beyond, skin is upright and not visible from below


@dataclass(frozen=True, kw_only=True)
class ChainPress(SyntheticScene):
    """Synthetic press whose skin moves as a skin chain turned about its axis, under a force that rises and is then
    held.

    Contact is a disc and displacement is radial; both are those of the chain. The state at the end of the rise
    persists. Settings that all scenes share are those of `SyntheticScene`.

    Args:
        friction: coefficient between skin and glass.
        parameters: of the chain, "paper" or "lab"; the contact with "lab" is half as large.
        softness: divisor of the parameters' stiffnesses.
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
        """Return the simulated skin chain at evenly spaced times from first contact to full force."""
        time = torch.linspace(0, self.rise_time, _TIMES, dtype=torch.float64)
        load = torch.from_numpy(self.normal_force(time.numpy() + self.contact_time))
        skin = named(self.parameters).softer(self.softness)
        return follow(self.friction, time, load, parameters=skin, elements=self.elements)

    @cached_property
    def chain_since_onset(self) -> SinceOnset:
        """Return the chain's displacement and divergence since contact, simulated without images or splines."""
        return since_onset(self.chain)

    def chain_at(self, values: Tensor) -> Array:
        """Interpolate values (T,) at the chain's simulated times to the times of the frames; NaN before contact."""
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
    """Motion of a contact disc that grows while skin spreads radially from its centre, both given by splines.

    Progress is the elapsed share of the rise. With r the distance from the centre, material = position (1 - s), where
    s(r, progress) is a bicubic spline, even in r. The square of the disc's radius is a cubic spline of progress. Both
    are even at either end of the progress, because the force begins and ends with zero slope.

    Args:
        centre: of the contact, mm.
        side: radius (mm) where the spline ends; beyond it s is constant.
        share: coefficients (K + 3, M + 3) of s, from progress 0 to 1 and radius 0 to ``side``, padded by one on each
            side.
        square: coefficients (K + 3,) of the square of the contact radius, mm².
    """

    centre: tuple[float, float]
    side: float
    share: Tensor
    square: Tensor

    # The contact grows faster than the skin spreads, so a point that is inside stays inside.
    entry_steps = 1

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        right, down = x - self.centre[0], y - self.centre[1]
        # 1e-30 is below the rounding of any relevant position; it makes the gradient at the centre finite.
        radius = torch.sqrt(right.square() + down.square() + 1e-30)
        rows, columns = self.share.shape
        first, weights = _place(progress, rows - 3)
        table = self.share.to(x.dtype)
        start, across = _place(radius / self.side, columns - 3)
        if progress.numel() == 1:  # an image: one row of coefficients for all pixels
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
    """Smooth simulated values (T, ...) by a least-squares spline and return them at K + 1 evenly spaced times.

    The values at first contact are kept.
    """
    time = np.linspace(0, 1, _TIMES)
    knots = np.concatenate(([0.0] * 3, np.linspace(0, 1, _KNOTS + 1), [1.0] * 3))
    weight = np.where(time == 0, 1e3, 1.0)
    return np.asarray(make_lsq_spline(time, values, knots, k=3, w=weight)(np.linspace(0, 1, _KNOTS + 1)))


def _coefficients(values: Array) -> Tensor:
    """Return cubic spline coefficients of values on a grid, extended by one at each mirrored end."""
    return torch.from_numpy(np.pad(spline_filter(values, order=3, mode="mirror"), 1, mode="reflect"))


def _place(share: Tensor, steps: int) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Return the index of the first of four spline coefficients, and four weights, at a position (0 to 1) on a grid."""
    at = share.clamp(0, 1) * steps
    first = at.detach().nan_to_num(0.0).floor().clamp(max=steps - 1)  # NaN propagates through the weights
    return first.long(), cubic_weights(at - first)[0]


def _line(flat: Tensor, start: Tensor, weights: tuple[Tensor, ...]) -> Tensor:
    value = torch.take(flat, start) * weights[0]
    for k in range(1, 4):
        value = value.addcmul(torch.take(flat, start + k), weights[k])
    return value
