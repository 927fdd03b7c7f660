"""Compare the window (subset) of each point with the key frame, to detect points that follow the wrong skin or dust."""

import math
from typing import Any, NamedTuple

import numpy as np

from fingerflow.engines.engine import STEP, TRACKED, Engine, Images, noise_of
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import identities
from fingerflow.kernels.tracking_limits import TUKEY
from fingerflow.tracker.window_match import Sampler, compare, deformed_alike, shifted_alike

_ALIKE = 0.05  # 1 - correlation that is always allowed; for ridges with a period of 15 px a shift by 1.5 px exceeds it
_USUAL = 4.0  # multiple of the median 1 - correlation over all points that is allowed if it is more
_MOST = 0.2  # upper bound of this limit
_NOISE = 3.0  # allowed multiple of the loss of correlation due to the noise of two images
_PEAK = 3.5  # multiple of the usual residual of windows above which a single residual stands out
# Something else than skin holds a point beyond all three limits: its distance from the position at which most samples
# of its window match, in px and in standard deviations, and the largest residual there in standard deviations of all.
# It is 7 to 30 with dust, and 4 to 13 where skin deforms unevenly within a window, on slides of small contacts.
_HELD_PX, _HELD_DEVIATIONS, _HELD_PEAK = 0.35, 4.0, 12.0


class Verified(NamedTuple):
    """Result of comparing the windows of N points with the key frame: which points no longer follow their skin, and
    what variance dust adds to the positions of the others.

    Attributes:
        differs: (N,) bool, windows that are no longer those of the key frame.
        held: (N,) bool, windows in which something that does not move with the skin holds the point back.
        variance: (N,) px^2 that such an object adds to the variance of a coordinate of the other points.
    """

    differs: Array
    held: Array
    variance: Array


class Verification:
    """Verification of tracked points: compares the present window of each point with the window in the key frame.

    The present subset is deformed by the gradient of the motion of the surrounding points, sampled in the image and
    correlated, independently of gain and offset. A point fails if 1 - correlation exceeds a limit and no other
    deformation with the same centre explains it (`deformed_alike`). The limit is 5 %, or four times the median over all
    points if that is more (light, focus and contact change all of them), at most 20 %; plus three times sigma^2 / S,
    the loss of correlation by noise of variance sigma^2 in subsets of variance S.

    Slow drifts by 1.0 to 1.3 px, as in a slide, are not detected: they change the subset too little. A subset without
    neighbours, whose motion would deform it, is not checked. Where most points are being lost, gradients are poor, and
    correct positions fail too.

    Dust that rests on the glass pulls a point towards where it was, and a window is large beside a speck: correlations
    hardly show it. Where a residual of the window stands out, the window is shifted to where most of its samples match
    (`window_match.shifted_alike`). A shift by more than a third of a pixel rejects the point; a smaller one is added
    to its variance. On the shipped press with 300 specks of half the light 99 % of the positions that are wrong by more
    than 0.5 px are rejected, and without dust none of 27,000 positions (`python -m tests.silent points`).
    """

    def __init__(self, engine: Engine, image: Images, points: Array) -> None:
        """Sample the window of each point (N, 2) px in the key frame `image` (1, 1, h, w)."""
        self._engine = engine
        first = engine.windows(image, np.zeros(len(points), np.int64), points, identities(len(points)))
        self._first = first - first.mean(1, keepdims=True)  # fits have an offset, which makes up for it
        self._variance = self._first.var(1, ddof=1)
        nothing = np.zeros(len(points), dtype=bool)
        self.latest = Verified(nothing, nothing, np.zeros(len(points), np.float32))
        self.correlation = np.full(len(points), np.nan, np.float32)

    def check(self, images: Images, points: Array, status: Array, warp: Array) -> Verified:
        """Verify the points in several images, and return which points to reject in these images.

        Positions are (n, N, 2) px, images (n, 1, h, w). Each point is checked once, in the last image in which it is
        tracked. A point that fails there, or failed at the check before, may have left its skin in any of these images.
        `latest` is the result of this check alone, `correlation` (N,) the correlation of each, NaN where unknown.
        `warp` (N, 2, 2) is the deformation gradient in the last image, NaN where it is not known.
        """
        frames = len(images)
        # Number of the last image with the point tracked, counted from 1; 0 if there is none.
        last = ((status == TRACKED) * np.arange(1, frames + 1)[:, None]).max(0)
        number = np.maximum(last - 1, 0)
        positions = np.where((last > 0)[:, None], points[number, np.arange(len(number))], np.float32(np.nan))

        def sample(number: Array, positions: Array, warp: Array) -> Array:
            return self._engine.windows(images, number, positions, warp)

        correlation, *residuals = compare(self._first, sample(number, positions, warp))
        loss = 1 - correlation
        noise = noise_of(self._engine, images[frames - 1 :])
        with np.errstate(divide="ignore", invalid="ignore"):
            noise_part = noise**2 / self._variance  # infinite or NaN for a blank window, which then never fails
        limit = np.clip(_USUAL * _lower_median(loss), _ALIKE, _MOST) + _NOISE * noise_part
        suspect = (loss > limit).nonzero()[0]
        if len(suspect):
            # Fit the deformation: skin deforms unevenly near the border, and a correct subset may then exceed the
            # limit.
            first, present = self._first[suspect], (number[suspect], positions[suspect])
            better = deformed_alike(first, sample, *present, warp[suspect], self._engine.settings.window_px, STEP)
            again = 1 - compare(first, sample(*present, better))[0]
            loss[suspect] = np.where(np.isnan(again), loss[suspect], np.minimum(again, loss[suspect]))
        before, unknown = self.latest, np.isnan(loss)
        shift, deviations, largest = self._shifts(sample, number, positions, warp, residuals, noise)
        away = np.square(shift).sum(1)
        held = (away > _HELD_PX**2) & (deviations > _HELD_DEVIATIONS) & (largest > _HELD_PEAK)
        self.correlation = (1 - loss).astype(np.float32)
        # Robust weights find 0.7 of the distance by which dust pulls a point, so that the variance of a coordinate is
        # the square of the shift, less what its own error explains; where every sample has a weight nothing pulls it.
        pull = (largest > TUKEY) * away * np.maximum(1 - 2 / np.maximum(deviations, 1) ** 2, 0)
        # A point that cannot be checked keeps its previous result.
        verified = Verified(loss > limit, held, pull.astype(np.float32))
        self.latest = Verified(*(np.where(unknown, *pair) for pair in zip(before, verified, strict=True)))
        return Verified(*(np.maximum(*pair) for pair in zip(before, self.latest, strict=True)))

    def _shifts(
        self, sample: Sampler, number: Array, positions: Array, warp: Array, residuals: list[Array], noise: float
    ) -> tuple[Array, Array, Array]:
        """Return the shifts (N, 2) px by which windows match those of the key frame best, their lengths (N,) in their
        standard deviations and the largest residuals (N,) in theirs, where single residuals stand out, as those of dust
        do; all are 0 for other windows. `residuals` are their root mean squares (N,) and largest magnitudes (N,).
        """
        shift, (deviations, largest_left) = np.zeros((len(number), 2)), np.zeros((2, len(number)))
        square, largest = residuals
        usual = max(float(_lower_median(square)), math.sqrt(2) * noise)
        suspect = (largest > _PEAK * usual).nonzero()[0]
        if len(suspect):
            present = (number[suspect], positions[suspect], warp[suspect], math.sqrt(2) * noise)
            fit = shifted_alike(self._first[suspect], sample, *present)
            shift[suspect], _, deviations[suspect], largest_left[suspect] = fit
        return shift, deviations, largest_left


def _lower_median(values: Array) -> Any:
    """Return the lower median of the finite ones of some values (N,); 0 if there are none."""
    finite = np.sort(values[np.isfinite(values)])
    return finite[(len(finite) - 1) // 2] if len(finite) else 0.0
