"""Tests of mu_s and mu_k fitted to noisy trials, their intervals, and the choice between curves."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from fingerflow.models.partial_slip import compare_curves, fit_friction, load_ratio, stuck_area
from tests.slip_trials import simulate_trial


def loading(
    mu_s: float, mu_k: float, seed: int, noise: float = 0.01
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return d^2 and T/N, with independent errors, of 179 frames of slow loading up to just below the critical load."""
    trial = simulate_trial(mu_s, mu_k, seed, area_noise=noise, load_noise=noise / 2, oscillation=0)
    frames = slice(0, 179)
    return trial.stuck_area[frames], trial.load_ratio[frames]


def test_without_noise_the_coefficients_are_exact() -> None:
    areas = np.linspace(1 / 3, 1, 50)
    for mu_k in (0.0, 0.4, 0.8, 1.6, 2.0):
        fit = fit_friction(areas, load_ratio(areas, 0.8, mu_k).numpy(), resamples=100)
        assert fit.identified
        assert fit.mu_s == pytest.approx(0.8, abs=1e-5)
        assert fit.mu_k == pytest.approx(mu_k, abs=1e-5)


def test_intervals_contain_the_truth_as_often_as_they_say() -> None:
    """Intervals of 90 % contain the truth in 63 to 79 of 80 trials: 72 are expected, other numbers have a probability
    of 1 % or less.
    """
    hits = np.zeros(4)
    errors = []
    for seed in range(80):
        fit = fit_friction(*loading(0.8, 0.5, seed), level=0.9, resamples=100, seed=seed)
        intervals = (fit.mu_s_interval, fit.mu_k_interval, fit.ratio_interval, fit.critical_area_interval)
        hits += [low <= true <= high for (low, high), true in zip(intervals, (0.8, 0.5, 0.625, 0.3 / 1.1), strict=True)]
        errors.append((fit.mu_s - 0.8, fit.mu_k - 0.5))
        assert (fit.level, fit.resamples, fit.seed) == (0.9, 100, seed)
    assert ((hits >= 63) & (hits <= 79)).all(), hits
    error = np.array(errors)
    # The bias is below the standard deviation of a single trial.
    assert (np.abs(error.mean(0)) < error.std(0)).all()
    assert (error.std(0) < (0.006, 0.015)).all()


def test_wild_frames_have_little_weight() -> None:
    area, load = loading(0.8, 0.5, 2)
    clean = fit_friction(area, load, resamples=100)
    wild = area.copy()
    wild[60::12] = 0.0
    assert fit_friction(wild, load, resamples=100).ratio == pytest.approx(clean.ratio, abs=0.03)


def test_what_the_data_do_not_determine_is_nan() -> None:
    area, load = loading(0.8, 0.5, 4)
    early = fit_friction(area[:45], load[:45])
    assert not early.identified
    assert "mu_k is not determined: d² falls to 0.9" in early.reason
    assert early.mu_s_interval[0] < 0.8 < early.mu_s_interval[1]
    assert np.isnan([early.mu_k, early.ratio, early.critical_area, *early.ratio_interval]).all()
    stuck = fit_friction(np.ones(50), np.linspace(0, 0.1, 50))
    assert not stuck.identified
    assert np.isnan(stuck.mu_s)
    assert "the area shrinks in" in stuck.reason
    assert "2 frames with" in fit_friction(area[:2], load[:2]).reason
    assert not fit_friction([], []).identified


def test_settings_that_cannot_be() -> None:
    area, load = loading(0.8, 0.5, 5)
    with pytest.raises(ValueError, match=r"level is 95: give one between 0 and 1"):
        fit_friction(area, load, level=95)
    with pytest.raises(ValueError, match="10 resamples are too few"):
        fit_friction(area, load, resamples=10)
    with pytest.raises(ValueError, match="give one value a frame of each"):
        fit_friction(area, load[1:])


@pytest.mark.parametrize(
    ("curve", "name"),
    [
        (lambda load: stuck_area(load, 0.8, 0.4).numpy(), "partial slip"),
        (lambda load: stuck_area(load, 0.8, 1.2).numpy(), "partial slip"),
        (lambda load: np.sqrt(1 - load / 0.8), "equal friction"),
        (lambda load: (1 - load / 0.8) ** (2 / 3), "Tada"),
        (lambda load: np.where(load <= 0.8, 1.0, np.nan), "Coulomb"),
    ],
)
def test_the_curve_that_made_the_data_is_named(
    curve: Callable[[NDArray[np.float64]], NDArray[np.float64]], name: str
) -> None:
    draw = np.random.default_rng(6)
    load = np.linspace(0, 1.2, 300)
    with np.errstate(invalid="ignore"):  # NaN beyond full slip
        area = curve(load)
    load, area = load[np.isfinite(area)], area[np.isfinite(area)]
    # Full slip occurs in the last frames: without them a sticking contact determines no curve.
    area, load = np.append(area, area[-1] * np.array([0.7, 0.4, 0.2])), np.append(load, [load[-1]] * 3)
    area = np.clip(area + 0.01 * draw.standard_normal(area.size), 0, 1)
    comparison = compare_curves(area, load + 0.004 * draw.standard_normal(load.size))
    assert comparison.best == name
    assert sum(score.weight for score in comparison.scores.values()) == pytest.approx(1)
    criteria = {curve: score.aicc for curve, score in comparison.scores.items()}
    assert min(criteria, key=lambda curve: criteria[curve]) == name
    if name in ("equal friction", "Tada", "Coulomb"):
        assert comparison.scores[name].coefficients["mu"] == pytest.approx(0.8, abs=0.01)


def test_too_few_frames_to_compare() -> None:
    comparison = compare_curves([1.0, 0.9, 0.8], [0.0, 0.1, 0.2])
    assert comparison.best == ""
    assert comparison.scores == {}
    assert "3 frames" in comparison.reason
