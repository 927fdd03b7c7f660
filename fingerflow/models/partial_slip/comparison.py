"""Comparison of a trial with four models of the stuck area share d^2 as a function of the load ratio T/N."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fingerflow.models.partial_slip.curve_families import EQUAL_FRICTION, PARTIAL_SLIP, TADA
from fingerflow.models.partial_slip.fit import STUDENT_FREEDOM, fit_family, frames_of_slip, student_scale

Values = NDArray[np.float64]

COULOMB = "Coulomb"
_CANDIDATES = 401  # number of friction coefficients tried for Coulomb's curve


@dataclass(frozen=True)
class CurveScore:
    """Score of one model curve of partial slip in `compare_curves`: its fitted friction coefficients, AICc and Akaike
    weight.

    Attributes:
        coefficients: of friction, by name.
        aicc: Akaike's criterion, corrected for few frames; only differences are meaningful.
        weight: share of the evidence among the curves, exp(-difference to the best / 2) normalised.
    """

    coefficients: dict[str, float]
    aicc: float
    weight: float


@dataclass(frozen=True)
class CurveComparison:
    """Result of `compare_curves`: `scores` by curve, the `best` of them, and the number of `frames` used.

    Without enough frames `scores` is empty, `best` is "" and `reason` says why.
    """

    scores: dict[str, CurveScore]
    best: str
    frames: int
    reason: str


def compare_curves(stuck_area: ArrayLike, load_ratio: ArrayLike) -> CurveComparison:
    """Compare four model curves by AICc on the same frames: partial slip, equal friction, Tada and Coulomb.

    Each curve is fitted to the frames of slow loading as in `fit_friction`. Errors follow Student's t with 4 degrees of
    freedom, whose scale is one more parameter. Coulomb's curve has a corner: there a frame's distance is the smaller
    of those to its two legs, d^2 = 1 and T/N = mu. Frames count as independent; correlated errors make the
    weights overconfident.

    Args:
        stuck_area: (F,) d^2; frames with a NaN are left out.
        load_ratio: (F,) T/N, of the frames before the collapse alone.

    Raises:
        ValueError: the arrays differ in length.
    """
    area, load, noise, too_few = frames_of_slip(stuck_area, load_ratio)
    frames = area.size
    if too_few:
        return CurveComparison({}, "", frames, too_few)
    fits: dict[str, tuple[dict[str, float], float]] = {}
    for family in (PARTIAL_SLIP, EQUAL_FRICTION, TADA):
        coefficients, squared = fit_family(family, area, load, noise, np.ones((1, frames)))
        named = dict(zip(family.coefficients, map(float, coefficients[0]), strict=True))
        fits[family.name] = named, _aicc(squared[0], len(named))
    coulomb, squared = _fit_coulomb(area, load, noise)
    fits[COULOMB] = {"mu": coulomb}, _aicc(squared, 1)

    criteria = np.array([aicc for _, aicc in fits.values()])
    weights = np.exp(-(criteria - criteria.min()) / 2)
    scores = {
        name: CurveScore(named, float(aicc), float(weight))
        for (name, (named, aicc)), weight in zip(fits.items(), weights / weights.sum(), strict=True)
    }
    return CurveComparison(scores, max(scores, key=lambda name: scores[name].weight), frames, "")


def _fit_coulomb(area: Values, load: Values, noise: tuple[float, float]) -> tuple[float, Values]:
    candidates = np.linspace(load.min(), load.max(), _CANDIDATES)
    area_noise, load_noise = (max(value, 1e-9) for value in noise)
    below = load < candidates[:, None]
    to_full_adhesion = np.where(below, (1 - area) / area_noise, np.inf)
    squared = np.minimum(to_full_adhesion, np.abs(load - candidates[:, None]) / load_noise) ** 2
    best = int(np.argmin([_deviance(row) for row in squared]))
    return float(candidates[best]), squared[best]


def _aicc(squared: Values, coefficients: int) -> float:
    parameters = coefficients + 1  # the scale of the residuals is a parameter too
    frames = squared.size
    return _deviance(squared) + 2 * parameters + 2 * parameters * (parameters + 1) / (frames - parameters - 1)


def _deviance(squared: Values) -> float:
    """Return -2 log likelihood of residuals, given squared (F,), under Student's t-distribution of the most likely
    scale, up to a constant that is common to all curves.
    """
    scale = student_scale(squared)
    return float((np.log(scale) + (STUDENT_FREEDOM + 1) * np.log1p(squared / (STUDENT_FREEDOM * scale))).sum())
