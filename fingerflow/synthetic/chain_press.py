"""Synthetic press of a fingertip simulated by the skin chain, so that the spreading of skin over the glass depends on
friction.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.ndimage import spline_filter
from torch import Tensor

from fingerflow.models.skin_chain import PressedChain as Chain
from fingerflow.models.skin_chain import follow
from fingerflow.models.skin_parameters import parameter_set
from fingerflow.synthetic.grid_spline import cubic_weights
from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.scenes import Array, SyntheticScene

_TIMES = 257  # number of times at which the chain is simulated during the rise
PATH_N_S = 3.6  # N/s, mean rate of a simulated path that several presses share: the printed one
_KNOTS = 32  # number of intervals of the splines in time; they smooth the growth of contact by whole elements
_RADII = 96  # number of intervals of the spline from the axis to the side of the finger
_SIDE = 0.95  # share of the finger's radius beyond which skin is upright and not visible from below


@dataclass(frozen=True, kw_only=True)
class ChainPress(SyntheticScene):
    """Synthetic press of a fingertip whose skin moves as a simulated chain of skin elements, rotated about its axis;
    the force rises, then stays constant.

    Contact is a disc and displacement is radial; both are those of the chain. While the force is held they persist, and
    disc and skin may shift as a whole. Progress is 1 at the end of the rise and 2 in the last frame.

    With r the distance from the disc's centre, material = position - s (position - centre), where s(r, p) is a bicubic
    spline, even in r, and p the place on the path of the chain. The square of the disc's radius is a cubic spline of p.
    Both splines are even at either end of the path, because the force, sin² of p, has no slope there. Beyond a
    progress of 1 disc and skin move together, by shift sin²(pi (progress - 1) / 2). Settings that all scenes share are
    those of `SyntheticScene`.

    Args:
        friction: coefficient between skin and glass.
        parameters: of the chain: "paper", "lab", with half the contact, or "fitted", whose pulp stiffens.
        softness: divisor of the stiffnesses of the tissue.
        force: at the end of the rise, N.
        contact_time: s from the trigger to first contact.
        rise_time: s from first contact to the full force.
        steady: whether the force on skin and chain rises at a constant rate, else as sin².
        relaxation: share of the force that is lost, evenly, from the end of the rise to the last frame; the skin stays.
        drag: tangential force as a share of the normal force.
        shift: displacement (x, y) in mm of disc and skin from the end of the rise to the last frame.
        elements: of the chain.
        path_force: force in N to which the chain is simulated, at 3.6 N/s on average; that of the press where None, in
            its time. Presses of one skin, friction and path share one simulation, so that their rate has no influence.
    """

    friction: float = 0.2
    parameters: str = "paper"
    softness: float = 1.0
    force: float = 5.0
    contact_time: float = 0.02
    rise_time: float = 0.9
    steady: bool = False
    relaxation: float = 0.0
    drag: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    elements: int = 1001
    path_force: float | None = None

    def __post_init__(self) -> None:
        if self.path_force is not None and self.path_force < self.force:
            raise ValueError(f"path_force is {self.path_force:g} N, below the {self.force:g} N of the press")

    @property
    def chain(self) -> Chain:
        """Return the states of the simulated skin chain at evenly spaced times from first contact to the largest
        simulated force, `path_force`, or else `force`.
        """
        return pressed_chain(*self._path)

    def interpolate_chain(self, values: Tensor) -> Array:
        """Interpolate a quantity of the simulated skin chain, given (T,) at its simulated times, to the times of the
        frames; NaN before contact.
        """
        share = np.minimum(self.progress(self.times), 1) * self._path_end
        return np.where(share > 0, np.interp(share, np.linspace(0, 1, _TIMES), values.numpy()), np.nan)

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        shifted = self._shifted(progress)
        x, y = x - self.shift[0] * shifted, y - self.shift[1] * shifted
        right, down = x - self.contact_centre[0], y - self.contact_centre[1]
        # 1e-30 is below the rounding of any relevant position, and makes the gradient at the centre finite.
        radius = torch.sqrt(right.square() + down.square() + 1e-30)
        side, share, _ = _path_splines(*self._path)
        rows, columns = share.shape
        first, weights = _spline_weights(self._on_path(progress), rows - 3)
        table = share.to(x.dtype)
        start, across = _spline_weights(radius / side, columns - 3)
        if progress.numel() == 1:  # a whole image has one progress, so one row of coefficients serves all pixels
            four = torch.stack([weight.reshape(()) for weight in weights])
            spread = _spline_value(four @ table[int(first) : int(first) + 4], start, across)
        else:
            flat, spread = table.flatten(), torch.zeros_like(radius)
            for k, weight in enumerate(weights):
                spread = spread + weight * _spline_value(flat, (first + k) * columns + start, across)
        return x - spread * right, y - spread * down

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        shifted, (centre_x, centre_y) = self._shifted(progress), self.contact_centre
        right, down = x - centre_x - self.shift[0] * shifted, y - centre_y - self.shift[1] * shifted
        largest = float(self._square(torch.ones(1, dtype=torch.float64)))
        return (self._square(progress) - right.square() - down.square()) / largest

    def ellipse(self, progress: float) -> Ellipse | None:
        at = torch.tensor(progress, dtype=torch.float64)
        square, shifted = (float(self._square(at)) if progress > 0 else 0.0), float(self._shifted(at))
        centre = self.contact_centre[0] + self.shift[0] * shifted, self.contact_centre[1] + self.shift[1] * shifted
        return Ellipse(centre, (math.sqrt(square), math.sqrt(square))) if square > 1e-6 else None

    def _on_path(self, progress: Tensor) -> Tensor:
        return progress.clamp(0, 1) * self._path_end

    def _shifted(self, progress: Tensor) -> Tensor:
        return torch.sin(math.pi / 2 * (progress - 1).clamp(0, 1)).square()

    def _square(self, progress: Tensor) -> Tensor:
        """Return the square of the contact radius, mm², at a progress of the movement."""
        square = _path_splines(*self._path)[2]
        start, weights = _spline_weights(self._on_path(progress), len(square) - 3)
        return _spline_value(square.to(progress.dtype), start, weights)

    def progress(self, time: Array) -> Array:
        share = self._share_of_rise(time)
        if self.steady:
            share = _invert_force_share(share * self.force / self._path_force) / self._path_end
        elif self._path_end < 1:
            share = _invert_force_share(force_share(share) * self.force / self._path_force) / self._path_end
        return np.minimum(share, 1.0) + self._share_of_hold(time)

    def normal_force(self, time: Array) -> Array:
        share = self._share_of_rise(time)
        risen = share if self.steady else force_share(share)
        return self.force * risen * (1 - self.relaxation * self._share_of_hold(time))

    def tangential_force(self, time: Array) -> Array:
        return self.drag * self.normal_force(time)

    def _share_of_rise(self, time: Array) -> Array:
        return np.clip((time - self.contact_time) / self.rise_time, 0, 1)

    def _share_of_hold(self, time: Array) -> Array:
        """Return how much of the hold, the time from the end of the force's rise to the last frame, has elapsed at
        times in s: 0 to 1.
        """
        held = time - self.contact_time - self.rise_time
        whole = float(self.times[-1]) - self.contact_time - self.rise_time
        return np.clip(held / whole, 0, 1) if whole > 0 else np.zeros_like(held)

    @property
    def _path_force(self) -> float:
        return self.force if self.path_force is None else self.path_force

    @property
    def _path(self) -> tuple[float, str, float, float, float, bool, int]:
        """Return the arguments of `pressed_chain` for this press: friction, skin parameters, softness, force, rise
        time, whether the force rises steadily, and number of elements.
        """
        rise_s = self.rise_time if self.path_force is None else self.path_force / PATH_N_S
        return self.friction, self.parameters, self.softness, self._path_force, rise_s, self.steady, self.elements

    @property
    def _path_end(self) -> float:
        """Return the time at which the simulated force reaches that of the press, as a share (0 to 1) of the simulated
        rise time.
        """
        return float(_invert_force_share(np.asarray(self.force / self._path_force)))


@lru_cache(maxsize=4)
def pressed_chain(
    friction: float, parameters: str, softness: float, force: float, rise_s: float, steady: bool, elements: int
) -> Chain:
    """Simulate a skin chain that is pressed on the plate by a force which rises to `force` N in `rise_s` s, as sin² or
    at a constant rate; return its states at 257 forces, evenly spaced in the inverse of sin².
    """
    share = np.linspace(0, 1, _TIMES)
    time = torch.from_numpy(rise_s * (force_share(share) if steady else share))
    load = torch.from_numpy(force * force_share(share))
    return follow(friction, time, load, parameters=parameter_set(parameters).softer(softness), elements=elements)


def force_share(progress: Array) -> Array:
    """Return the force on the simulated skin chain, as a share of its full force, at a share (0 to 1) of the rise time,
    the progress: it rises as sin².
    """
    return np.sin(math.pi / 2 * progress) ** 2


def _invert_force_share(share: Array) -> Array:
    """Return the progress, the share of the rise time, at which the force on the simulated skin chain reaches a share
    (0 to 1) of its full force.
    """
    return 2 / math.pi * np.arcsin(np.sqrt(np.minimum(share, 1.0)))


@lru_cache(maxsize=64)
def _path_splines(
    friction: float, parameters: str, softness: float, force: float, rise_s: float, steady: bool, elements: int
) -> tuple[float, Tensor, Tensor]:
    """Simulate a skin chain as `pressed_chain` does; return the radius (mm) where the spline s of the radial motion
    ends, beyond which s is constant, its coefficients (K + 3, M + 3) from p = 0 to 1 and radius 0 to there, padded by
    one on each side, and the coefficients (K + 3,) of the square of the contact radius, mm².
    """
    chain = pressed_chain(friction, parameters, softness, force, rise_s, steady, elements)
    x = 1e3 * (chain.position[..., 0] - chain.position[..., 0].flip(-1)).numpy() / 2
    undeformed = x[0]
    seen = np.abs(undeformed) <= _SIDE * undeformed[-1]
    side = float(x[:, seen][:, -1].min())
    radius = np.linspace(0, side, _RADII + 1)
    share = np.empty((_TIMES, _RADII + 1))
    for row, positions in zip(share, x, strict=True):
        moved = CubicSpline(positions[seen], (positions - undeformed)[seen])
        row[0], row[1:] = moved(0.0, 1), moved(radius[1:]) / radius[1:]
    square = (500 * chain.contact_length.numpy()) ** 2
    return side, _coefficients(_smoothed(share)), _coefficients(_smoothed(square))


def _smoothed(values: Array) -> Array:
    """Smooth simulated values (T, ...), given at T even times, by a least-squares spline in time that is exact at first
    contact; return its values at K + 1 even times.
    """
    time = np.linspace(0, 1, _TIMES)
    knots = np.concatenate(([0.0] * 3, np.linspace(0, 1, _KNOTS + 1), [1.0] * 3))
    weight = np.where(time == 0, 1e3, 1.0)
    return make_lsq_spline(time, values, knots, k=3, w=weight)(np.linspace(0, 1, _KNOTS + 1))


def _coefficients(values: Array) -> Tensor:
    """Return the coefficients of the cubic spline through values on an even grid, padded by one mirrored coefficient at
    each end.
    """
    return torch.from_numpy(np.pad(spline_filter(values, order=3, mode="mirror"), 1, mode="reflect"))


def _spline_weights(share: Tensor, steps: int) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Return how to evaluate a cubic B-spline on a uniform grid of `steps` intervals at positions `share` (0 to 1): the
    index of the first of four coefficients at each position, and their four weights.
    """
    at = share.clamp(0, 1) * steps
    first = at.detach().nan_to_num(0.0).floor().clamp(max=steps - 1)  # NaN propagates through the weights instead
    return first.long(), cubic_weights(at - first)[0]


def _spline_value(flat: Tensor, start: Tensor, weights: tuple[Tensor, ...]) -> Tensor:
    """Return the value of a spline: the weighted sum of four successive coefficients in `flat`, of which the first has
    the index `start`.
    """
    value = torch.take(flat, start) * weights[0]
    for k in range(1, 4):
        value = value.addcmul(torch.take(flat, start + k), weights[k])
    return value
