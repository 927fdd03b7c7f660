"""Compare the window (subset) of each point with the key frame, to detect points that follow the wrong skin."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import Engine, Images
from fingerflow.engines.together import Call, Steps
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.tracker.window_match import Centred, correlation_of, deformed_alike

Array = NDArray[Any]

STEP = 3  # px of a window's grid: 81 samples of a window of 25 px
_ALIKE = 0.05  # 1 - correlation that is always allowed; ridges with a period of 15 px exceed it if shifted by 1.5 px
_USUAL, _MOST = 4.0, 0.2  # times the median over all points, which is allowed if it is more, and its upper bound
_NOISE = 3.0  # times the loss of correlation by the noise of two images


class Verification:
    """Verification of tracked points: compares the present window of each point with the window in the key frame.

    The present subset is deformed by the gradient of the motion of the surrounding points, sampled in the image and
    correlated, independently of gain and offset. A point fails if 1 - correlation exceeds a limit and no other
    deformation with the same centre explains it (`deformed_alike`). The limit is 5 %, or four times the median over all
    points if that is more (light, focus and contact change all of them), at most 20 %; plus three times sigma^2 / S,
    the loss of correlation by noise of variance sigma^2 in subsets of variance S.

    On synthetic presses, slides and fingerprints with disturbances none of 220,000 correct positions fails. Of
    positions that are wrong by 1 to 2 px 57 to 64 % fail, by 2 to 4 px 89 % or more, beyond that 98 % or more
    (`python -m bench second_look`). Slow drifts by 1.0 to 1.3 px, as in a slide, are not detected: they change the
    subset too little. A subset without neighbours, whose motion would deform it, is not checked. Where most points are
    being lost, gradients are poor: in a slide of 16 frames 16 of 21 wrong positions are detected, and 106 of 1637
    correct ones are lost.
    """

    def __init__(self, engine: Engine, image: Images, points: Array) -> None:
        """Sample the window of each point (N, 2) px in the key frame `image` (1, 1, h, w)."""
        self._engine = engine
        straight = np.broadcast_to(np.eye(2, dtype=np.float32), (len(points), 2, 2))
        self._first = engine.windows(image, np.zeros(len(points), np.int64), points, straight, STEP)
        self._centred = Centred.of(self._first)
        self._variance = self._first.var(1, ddof=1)
        self.failed = np.zeros(len(points), dtype=bool)
        self.correlation = np.full(len(points), np.nan, np.float32)

    def check(self, images: Images, points: Array, status: Array, warp: Array) -> Steps[Array]:
        """Verify the points in several images, and return a mask (N,) of the points to be rejected in these images.

        Positions are (n, N, 2) px, images (n, 1, h, w). Each point is checked once, in the last image in which it is
        tracked. A point that fails there, or failed at the check before, may have left its skin in any of these images.
        `failed` has those that fail at this check, `correlation` (N,) the correlation of each, NaN where unknown.
        `warp` (N, 2, 2) is the deformation gradient in the last image, NaN where it is not known.
        """
        frames = len(images)
        tracked = status == TrackStatus.TRACKED
        last = (tracked * np.arange(1, frames + 1)[:, None]).max(0)  # 0 for none
        number = np.maximum(last - 1, 0)
        places = np.where((last > 0)[:, None], points[number, np.arange(len(number))], np.float32(np.nan))
        apart = yield from self._dissimilarity(images, number, places, warp)
        noise: float = yield Call(self._engine.noise, (images[frames - 1 :],))
        with np.errstate(divide="ignore", invalid="ignore"):
            noise_part = noise**2 / self._variance  # infinite or NaN for a blank window, which never fails
        known = np.sort(apart[np.isfinite(apart)])
        usual = _USUAL * known[(len(known) - 1) // 2] if len(known) else 0.0
        limit = np.clip(usual, _ALIKE, _MOST) + _NOISE * noise_part
        suspect = np.flatnonzero(apart > limit)
        if len(suspect):
            # Skin deforms unevenly near the border: a subset at its correct position may then exceed the limit.
            sample = partial(self._sampled, images)
            some = (number[suspect], places[suspect])
            better = yield from deformed_alike(
                self._first[suspect], sample, *some, warp[suspect], self._engine.settings.window_px, STEP
            )
            again = yield from self._dissimilarity(images, *some, better, suspect)
            apart[suspect] = np.where(np.isnan(again), apart[suspect], np.minimum(again, apart[suspect]))
        before, self.correlation = self.failed, (1 - apart).astype(np.float32)
        # A point that cannot be checked keeps its result.
        self.failed = np.where(np.isnan(apart), before, apart > limit)
        result: Array = before | self.failed
        return result

    def _sampled(self, images: Images, number: Array, places: Array, warp: Array) -> Steps[Array]:
        found: Array = yield Call(self._engine.windows, (images, number, places, warp, STEP))
        return found

    def _dissimilarity(
        self, images: Images, number: Array, places: Array, warp: Array, rows: Array | None = None
    ) -> Steps[Array]:
        """Return the dissimilarity, 1 - correlation, of present and key-frame windows, for all points or for `rows`."""
        now = yield from self._sampled(images, number, places, warp)
        then = self._centred if rows is None else Centred(*(one[rows] for one in self._centred))
        result: Array = 1 - correlation_of(then, Centred.of(now))
        return result
