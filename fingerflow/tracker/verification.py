"""Whether points are still on the skin they were seeded on: their subsets (windows) then and now."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import Engine, Images
from fingerflow.engines.together import Call, Steps
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.tracker.windows import Centred, correlation_of, deformed_alike

Array = NDArray[Any]

STEP = 3  # px of a window's grid: 81 samples of a window of 25 px
_ALIKE = 0.05  # of 1 - correlation that nothing but a shift makes: ridges that repeat every 15 px, by 1.5 px
_USUAL, _MOST = 4.0, 0.2  # times the median of all points that one may have, where that is more, and its bound
_NOISE = 3.0  # times what the noise of two pictures takes from a correlation


class Verification:
    """Compares the subset of each point in the picture in which it was seeded with that where it is now.

    The subset is deformed by the gradient of the motion of all points around, sampled in the recorded picture and
    correlated, whatever gain and offset of the light. A point fails where 1 - correlation exceeds 5 %, or four times
    the median of all points where that is more (light, focus and contact change all of them), plus three times
    sigma^2 / S, what noise of variance sigma^2 takes from subsets of variance S; and where no other deformation with
    the same middle explains it (`deformed_alike`). On synthetic presses, slides and fingerprints, with disturbances,
    none of 220,000 positions that are right fails; of those beside their skin by 1 to 2 px 57 to 64 % do, by 2 to 4 px
    89 % or more, beyond that 98 % or more (`python -m bench second_look`). Slow departures by 1.0 to 1.3 px, as a slide
    has, are not found: the subset changes as little. A subset without neighbours, by whose motion it would be deformed,
    is not checked. Where most points are being lost gradients are poor: of a slide in 16 frames 16 of 21 wrong
    positions are found, and 106 of 1637 right ones are lost.
    """

    def __init__(self, engine: Engine, image: Images, points: Array) -> None:
        """`image` (1, 1, h, w) in which the points (N, 2) px were seeded."""
        self._engine = engine
        straight = np.broadcast_to(np.eye(2, dtype=np.float32), (len(points), 2, 2))
        self._first = engine.windows(image, np.zeros(len(points), np.int64), points, straight, STEP)
        self._centred = Centred.of(self._first)
        self._variance = self._first.var(1, ddof=1)
        self.failed = np.zeros(len(points), dtype=bool)

    def check(self, images: Images, points: Array, status: Array, warp: Array) -> Steps[Array]:
        """(N,) points that are not to be trusted in these images (n, 1, h, w), in which they are at (n, N, 2) px; their
        deformation (N, 2, 2) in the last one, NaN where it is not known.

        Each is checked once, in the last image in which it is tracked: a point that fails there, or failed in the
        images before, may have been beside its skin in any of these. `failed` has those that fail there.
        """
        frames = len(images)
        tracked = status == TrackStatus.TRACKED
        last = (tracked * np.arange(1, frames + 1)[:, None]).max(0)  # 0 for none
        number = np.maximum(last - 1, 0)
        places = np.where((last > 0)[:, None], points[number, np.arange(len(number))], np.float32(np.nan))
        apart = yield from self._apart(images, number, places, warp)
        noise: float = yield Call(self._engine.noise, (images[frames - 1 :],))
        with np.errstate(divide="ignore", invalid="ignore"):
            noise_part = noise**2 / self._variance  # infinite or NaN of a blank window, which never differs
        known = np.sort(apart[np.isfinite(apart)])
        usual = _USUAL * known[(len(known) - 1) // 2] if len(known) else 0.0
        limit = np.clip(usual, _ALIKE, _MOST) + _NOISE * noise_part
        suspect = np.flatnonzero(apart > limit)
        if len(suspect):
            # Skin deforms unevenly beside its border: so would a subset that is where it was.
            sample = partial(self._sampled, images)
            some = (number[suspect], places[suspect])
            better = yield from deformed_alike(
                self._first[suspect], sample, *some, warp[suspect], self._engine.settings.window_px, STEP
            )
            again = yield from self._apart(images, *some, better, suspect)
            apart[suspect] = np.where(np.isnan(again), apart[suspect], np.minimum(again, apart[suspect]))
        before = self.failed
        # A point that cannot be checked is as it was.
        self.failed = np.where(np.isnan(apart), before, apart > limit)
        result: Array = before | self.failed
        return result

    def _sampled(self, images: Images, number: Array, places: Array, warp: Array) -> Steps[Array]:
        found: Array = yield Call(self._engine.windows, (images, number, places, warp, STEP))
        return found

    def _apart(
        self, images: Images, number: Array, places: Array, warp: Array, rows: Array | None = None
    ) -> Steps[Array]:
        """1 - correlation of subsets now with those then, of all points or some rows."""
        now = yield from self._sampled(images, number, places, warp)
        then = self._centred if rows is None else Centred(*(one[rows] for one in self._centred))
        result: Array = 1 - correlation_of(then, Centred.of(now))
        return result
