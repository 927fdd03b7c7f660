"""Where the picture rests while the skin in it moves: dust on the glass or the lens, and the windows that hold it."""

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fingerflow.ops.box_sum import box_sum
from fingerflow.ops.noise import estimate_noise

_CLEARLY = 3.0  # times the variance of a pixel that skin in motion would have at least
_BOX = 5  # px, odd, over which both are averaged: about a speck; what is found is as much wider
_STEP_PX = 0.25  # of motion of a quarter of the points between pictures that count
_MOST_SPREAD = 9.0  # px^2: beyond half a ridge variance grows no more
_CELL = 8  # px that share the motion of the points around
_AROUND = 9  # points whose median motion is that of the skin
_REACH_PX = 25.0  # within which the nearest of them has to be
_FEWEST = 4  # pictures
_KNOWN = 0.9  # of the steps in which the motion has to be known
_GROWTH = 1.2  # of the number of pictures between looks
_SHARE = 0.02  # of a window's pixels that may rest


class RestingDust:
    """Tells specks that rest in the picture from skin that moves, by mean and variance of every pixel over time.

    A pixel sees f(u) of skin displaced by u. With Sigma, the covariance of u over the pictures, the variance of f is at
    least E[grad f]' Sigma E[grad f] (Cacoullos 1982, Annals of Probability 10, 799: for Gaussian u; for any other to
    first order in u), and E[grad f] is the gradient of the mean picture: where skin moves, an edge in the mean costs
    variance. Dust has the edge without the variance. A pixel rests where that bound, in means over 5 x 5 px, exceeds
    three times the variance (noise counted twice); at most it reached 2.4 times on a synthetic press and slide.

    Displacements are integrated at fixed places, so that skin may come and go: from picture to picture the median of
    nine points, by which those that a speck holds are outvoted; of the cells around a place the one that moves least
    counts, as skin beside a slip border rests. Where skin has not moved nothing is bounded and nothing found: what dust
    does there is less than that motion. A point is not to be trusted where its window, in the picture in which it was
    chosen or now, holds more than 2 % of what rests.
    """

    def __init__(self, image: Tensor, window: int) -> None:
        """`image` (1, 1, h, w), the first one, and the side of the points' windows, px."""
        self._first, self._half = image.clone(), window // 2
        self._noise = float(estimate_noise(image)) ** 2
        self._sum = torch.zeros(image.shape, dtype=torch.float32, device=image.device)  # of differences to the first
        self._square = torch.zeros_like(self._sum)
        self._count = self._looked = 1
        height, width = image.shape[-2:]
        y, x = (np.arange(_CELL / 2, side + _CELL / 2, _CELL) for side in (height, width))
        self._cells = np.stack(np.meshgrid(x, y), axis=-1)  # (rows, columns, 2) px
        self._place = np.zeros(self._cells.shape)  # displacement of the skin there
        self._places = np.zeros(self._cells.shape)  # sums of it, and of xx, xy, yy
        self._products = np.zeros((3, *self._cells.shape[:2]))
        self._known = np.zeros(self._cells.shape[:2])
        self._last: NDArray[np.float64] | None = None
        self._share = torch.empty(0)  # (h, w): of the window around a pixel that rests; empty where nothing does
        self.rests = torch.zeros(image.shape, dtype=torch.bool, device=image.device)

    def holds(self, images: Tensor, points: Tensor, start: Tensor) -> Tensor:
        """(n, N): whether points at (n, N, 2) px, NaN where not known, chosen at (N, 2) px, have dust in their windows.

        `images` (n, 1, h, w) follow those of the call before. The points may have become more, not fewer.
        """
        for image, found in zip(images.split(1), points.cpu().numpy().astype(np.float64), strict=True):
            self._go_on(image, found)
        if self._count >= max(_FEWEST, _GROWTH * self._looked):
            self._looked = self._count
            self._find()
        if not len(self._share):
            return torch.zeros(points.shape[:2], dtype=torch.bool, device=points.device)
        return (self._at(points) > _SHARE) | (self._at(start) > _SHARE)

    def _go_on(self, image: Tensor, found: NDArray[np.float64]) -> None:
        """Counts a picture, in which points are at (N, 2) px, if they have moved since the last one that did."""
        if self._last is None:
            self._last = found
            return
        before = self._last
        both = np.flatnonzero(np.isfinite(found[: len(before)]).all(1) & np.isfinite(before).all(1))
        if len(both) < _AROUND:  # too few to tell: they are compared from here on
            self._last = found
            return
        moved = found[both] - before[both]
        if np.quantile(np.hypot(*moved.T), 0.75) < _STEP_PX:
            return
        tree = cKDTree(before[both])
        known = np.isfinite(tree.query(self._cells, distance_upper_bound=_REACH_PX)[0])
        near = tree.query(self._cells[known], k=_AROUND)[1]
        self._place[known] += np.median(moved[near], axis=1)
        self._places += self._place
        x, y = np.moveaxis(self._place, -1, 0)
        self._products += np.stack((x * x, x * y, y * y))
        self._known += known
        more = (image.float() - self._first.float()).nan_to_num(0.0, 0.0, 0.0)
        self._sum += more
        self._square += more * more
        self._count += 1
        self._last = found

    def _find(self) -> None:
        """Adds what is found to rest by all pictures so far."""
        offset = self._sum / self._count
        mean = self._first.float() + offset
        variance = self._square / self._count - offset * offset
        right = F.pad((mean[..., 2:] - mean[..., :-2]) / 2, (1, 1))
        down = F.pad((mean[..., 2:, :] - mean[..., :-2, :]) / 2, (0, 0, 1, 1))
        height, width = mean.shape[-2:]
        cells = torch.from_numpy(self._spread()).to(mean).repeat_interleave(_CELL, 1).repeat_interleave(_CELL, 2)
        xx, xy, yy = cells[:, :height, :width]
        bound = xx * right * right + 2 * xy * right * down + yy * down * down
        # One sum tells: bound - 3 (variance + noise).
        rests = box_sum(bound - _CLEARLY * (variance + self._noise), _BOX) > 0
        self.rests |= F.max_pool2d(F.pad(rests.float(), (_BOX // 2,) * 4), _BOX, 1, _BOX // 2) > 0
        if self.rests.any():
            side = 2 * self._half + 1
            padded = F.pad(self.rests.float(), (self._half,) * 4)
            self._share = box_sum(padded, side)[0, 0] / side**2

    def _spread(self) -> NDArray[np.float64]:
        """(3, rows, columns) px^2: xx, xy, yy of Sigma in cells, of the 3 x 3 around that of least motion."""
        x, y = np.moveaxis(self._places / self._count, -1, 0)
        spread = self._products / self._count - np.stack((x * x, x * y, y * y))
        spread *= self._known >= _KNOWN * (self._count - 1)
        size = spread[0] + spread[2]
        rows, columns = size.shape
        padded, sizes = np.pad(spread, ((0, 0), (1, 1), (1, 1)), mode="edge"), np.pad(size, 1, mode="edge")
        shifts = [np.s_[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
        least = np.argmin([sizes[shift] for shift in shifts], axis=0)
        every = np.stack([padded[:, shift[0], shift[1]] for shift in shifts])
        chosen = np.take_along_axis(every, least[None, None], axis=0)[0]
        return np.asarray(chosen * (_MOST_SPREAD / np.maximum(chosen[0] + chosen[2], _MOST_SPREAD)))

    def _at(self, points: Tensor) -> Tensor:
        """The share of windows at (..., N, 2) px that rests; 0 where a point is not known."""
        height, width = self._share.shape
        known = points.isfinite().all(-1)
        x, y = torch.where(known[..., None], points, 0.0).round().long().unbind(-1)
        return torch.where(known, self._share[y.clamp(0, height - 1), x.clamp(0, width - 1)], 0.0)
