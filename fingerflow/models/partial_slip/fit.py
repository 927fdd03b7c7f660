"""Coefficients of static and kinetic friction, with intervals, from a measured stuck area share against T/N."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fingerflow.models.partial_slip.curve_families import PARTIAL_SLIP, CurveFamily

Values = NDArray[np.float64]
Interval = tuple[float, float]

STUDENT_FREEDOM = 4.0  # degrees of freedom of Student's t-distribution of the residuals

_FEWEST = 10  # least number of frames
_ROUNDS = 15  # iterations of reweighting
_STREAM = 0xF17  # added to the seed: data simulated with the same seed must not share random numbers
_EXACT = 1e-9  # standard deviation below which values count as exact
_WIDEST = 1.0  # widest interval of mu_k / mu_s that is informative


@dataclass(frozen=True)
class FrictionFit:
    """Friction coefficients with intervals, fitted by `fit_friction`; NaN if the data do not determine them.

    Attributes:
        mu_s, mu_k: coefficients of static and kinetic friction; mu_k is not below 0.
        ratio: mu_k / mu_s.
        critical_area: d^2_critic = (mu_s - mu_k) / (2 mu_s - mu_k); 0 where mu_k >= mu_s.
        mu_s_interval, mu_k_interval, ratio_interval, critical_area_interval: percentile intervals of the bootstrap.
        identified: True if the data determine both coefficients; `reason` says why not, and is empty if they do.
        area_noise, load_noise: standard deviations of d^2 and T/N from frame to frame.
        frames: number of frames that the fit used, or could have used where nothing is identified.
        level, resamples, seed: of the intervals.
    """

    mu_s: float
    mu_k: float
    ratio: float
    critical_area: float
    mu_s_interval: Interval
    mu_k_interval: Interval
    ratio_interval: Interval
    critical_area_interval: Interval
    identified: bool
    reason: str
    area_noise: float
    load_noise: float
    frames: int
    level: float
    resamples: int
    seed: int


def fit_friction(
    stuck_area: ArrayLike, load_ratio: ArrayLike, level: float = 0.95, resamples: int = 1000, seed: int = 0
) -> FrictionFit:
    """Fit the coefficients of static and kinetic friction in equation 5 of Terekhov & Hayward (2011) to the stuck area
    share d^2 and the load ratio T/N (tangential over normal force) in frames of slow loading.

    Both d^2 and T/N are measured with noise. The noise is estimated from their second differences, so the frames must
    be in order of time; the estimate depends on the ratio of the two. A frame's distance from the curve is its T/N
    residual, over the standard deviation that the two noises cause together. Errors follow Student's t with 4 degrees
    of freedom, so outlying frames have little weight. The intervals come from a bootstrap of blocks of frames, because
    errors of neighbouring frames are correlated. Measured on simulated trials: intervals of 95 % contain the truth in
    93 to 96 % with independent errors and in about 90 % where T/N swings by 1 %, which the area follows only upwards.
    mu_k / mu_s is 1 % low at a noise of d^2 up to 0.02, and 2 % low at 0.03.

    Args:
        stuck_area: (F,) d^2, the stuck area over the contact area; frames with a NaN are left out.
        load_ratio: (F,) T/N. Give the frames before the collapse alone (`TrialVerdict.loading`): during it the area
            does not follow the load.
        level: of the intervals, between 0 and 1.
        resamples: of the bootstrap.
        seed: of the bootstrap.

    Returns:
        `FrictionFit`. Frames in which the whole contact sticks carry no information. A fit without enough others, or
        whose area has not shrunk far enough to determine mu_k, is not identified.

    Raises:
        ValueError: the arrays differ in length, or level or resamples are out of range.
    """
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    if resamples < 100:
        raise ValueError(f"{resamples} resamples are too few for an interval: give 100 or more")
    area, load, noise, too_few = frames_of_slip(stuck_area, load_ratio)

    def fit(values: Values, intervals: Values, reason: str) -> FrictionFit:
        mu_s, mu_k, ratio, critical = map(float, values)
        of_s, of_k, of_ratio, of_critical = ((float(low), float(high)) for low, high in intervals.T)
        numbers = mu_s, mu_k, ratio, critical, of_s, of_k, of_ratio, of_critical
        return FrictionFit(*numbers, not reason, reason, *noise, area.size, level, resamples, seed)

    if too_few:
        return fit(np.full(4, np.nan), np.full((2, 4), np.nan), too_few)
    estimates, (estimate,) = (
        _friction_numbers(fit_family(PARTIAL_SLIP, area, load, noise, weights)[0])
        for weights in (_block_weights(area.size, resamples, seed), np.ones((1, area.size)))
    )
    intervals = np.quantile(estimates, [(1 - level) / 2, (1 + level) / 2], axis=0)
    width = intervals[1, 2] - intervals[0, 2]
    if width < _WIDEST and estimate[0] > 0:
        return fit(estimate, intervals, "")
    estimate[1:], intervals[:, 1:] = np.nan, np.nan
    reach = f"d² falls to {np.quantile(area, 0.02):.2f} only"
    reason = f"mu_k is not determined: {reach}, and the interval of mu_k/mu_s is {width:.1f} wide"
    return fit(estimate, intervals, reason)


def fit_family(
    family: CurveFamily, area: Values, load: Values, noise: tuple[float, float], weights: Values
) -> tuple[Values, Values]:
    """Fit the friction coefficients of one model curve T/N(d^2) to stuck area shares `area` (F,) and load ratios `load`
    (F,) with the given noise (standard deviations), by reweighted least squares, for R sets of frame weights (R, F).

    Returns:
        The coefficients (R, P) and the squared distances (R, F), in units of the noise.
    """
    # Noise of d^2 shifts the mean of a curved function; without this correction the fit is biased towards less
    # friction.
    basis = family.load(area) - family.curvature(area) * noise[0] ** 2 / 2
    count = basis.shape[1]
    robust = np.ones_like(weights)
    likely = np.broadcast_to(area, weights.shape)
    variance = np.full_like(weights, np.maximum(noise[1], _EXACT) ** 2)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(-1, count * count)
    for _ in range(_ROUNDS):
        total = weights * robust / variance
        normal = (total @ products).reshape(-1, count, count)
        # The ridge of 1e-12 keeps the matrix regular where the frames determine only one coefficient.
        normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(count)
        coefficients = np.linalg.solve(normal, (total @ (basis * load[:, None]))[..., None])[..., 0]
        residual = load - coefficients @ basis.T
        slope = (family.slope(likely) @ coefficients[..., None])[..., 0]
        variance = np.maximum(noise[1], _EXACT) ** 2 + (slope * np.maximum(noise[0], _EXACT)) ** 2
        # The most likely area of a frame lies between the measured one and the one that its load implies.
        likely = np.clip(area + slope * noise[0] ** 2 * residual / variance, 0, 1)
        squared = residual**2 / variance
        robust = student_weights(squared, weights * robust)
    return np.asarray(coefficients), np.asarray(squared)


def student_weights(squared: Values, weights: Values) -> Values:
    """Return the factors (R, F) by which a robust fit weights its frames, from squared residuals and frame weights (R,
    F): those of Student's t-distribution at the residuals' scale, small for outliers.
    """
    scale = (weights * squared).sum(-1, keepdims=True) / weights.sum(-1, keepdims=True)
    return (STUDENT_FREEDOM + 1) / (STUDENT_FREEDOM + squared / np.maximum(scale, 1e-300))


def student_scale(squared: Values) -> float:
    """Return the squared scale of the Student's t-distribution under which residuals, given squared (F,), are most
    likely.
    """
    scale = float(np.median(squared)) or float(squared.mean())
    for _ in range(4 * _ROUNDS):
        weights = (STUDENT_FREEDOM + 1) / (STUDENT_FREEDOM + squared / max(scale, 1e-300))
        scale = float((weights * squared).sum() / weights.sum())
    return max(scale, 1e-300)


def frames_of_slip(stuck_area: ArrayLike, load_ratio: ArrayLike) -> tuple[Values, Values, tuple[float, float], str]:
    """Select the frames in which the stuck area shrinks; return their stuck area share d^2 and load ratio T/N, the
    noise of both (standard deviations), and a message if there are too few frames, else empty.

    Raises:
        ValueError: the two differ in length.
    """
    area, load = (np.asarray(values, dtype=np.float64) for values in (stuck_area, load_ratio))
    if area.shape != load.shape or area.ndim != 1:
        raise ValueError(f"d² and T/N have shapes {area.shape} and {load.shape}: give one value a frame of each")
    both = np.isfinite(area) & np.isfinite(load)
    area, load = area[both], load[both]
    noise = frame_noise(area), frame_noise(load)
    if area.size < _FEWEST:
        return area, load, noise, f"{area.size} frames with d² and T/N, {_FEWEST} are needed"
    used = _is_shrinking(area, load, noise)
    reason = "" if used.sum() >= _FEWEST else f"the area shrinks in {used.sum()} frames, {_FEWEST} are needed"
    return area[used], load[used], noise, reason


def frame_noise(values: Values) -> float:
    """Return the standard deviation of white noise in a series, from second differences, which ignore slow changes.

    Values that are not finite are left out.
    """
    second = np.diff(values[np.isfinite(values)], 2)
    return float(1.4826 * np.median(np.abs(second)) / math.sqrt(6)) if second.size else math.nan


def _is_shrinking(area: Values, load: Values, noise: tuple[float, float]) -> NDArray[np.bool_]:
    """Return a mask (F,) of the frames in which the stick region shrinks: their load ratio implies a stuck area share
    d^2 below 1 by more than three standard deviations of its noise.

    The load selects the frames: a selection by the noisy area itself would keep frames with errors to one side.
    """
    partly = (area > 0.5) & (area < 1 - 5 * noise[0])
    if not partly.any():
        return partly
    # Near d^2 = 1, T/N = 2 mu_s (1 - d^2).
    return load > 3 * noise[0] * np.median(load[partly] / (1 - area[partly]))


def _block_weights(frames: int, resamples: int, seed: int) -> Values:
    """Return how often each frame occurs in R bootstrap samples of circular blocks, (R, F)."""
    length = math.ceil(frames ** (1 / 3))
    starts = np.random.default_rng([seed, _STREAM]).integers(0, frames, (resamples, math.ceil(frames / length)))
    chosen = ((starts[..., None] + np.arange(length)) % frames).reshape(resamples, -1)[:, :frames]
    counts = np.zeros((resamples, frames))
    np.add.at(counts, (np.arange(resamples)[:, None], chosen), 1)
    return counts


def _friction_numbers(coefficients: Values) -> Values:
    """Return the coefficients of static and kinetic friction, their ratio mu_k / mu_s, and the critical stuck area
    share, (R, 4), for R sets of fitted coefficients (R, 2).
    """
    mu_s, mu_k = coefficients[:, 0], np.maximum(coefficients[:, 1], 0)
    ratio = mu_k / mu_s
    # Resamples without a critical area count as 0: NaN would drop them from its interval.
    critical = np.where(ratio < 1, (1 - ratio) / np.where(ratio < 1, 2 - ratio, 1), 0)
    return np.stack([mu_s, mu_k, ratio, critical], 1)
