"""Tests of the verdict on a trial: by the change point, by the printed rule, by the model, and trials without a
verdict.
"""

import re
from dataclasses import asdict

import numpy as np
import pytest

from fingerflow.models.partial_slip import TrialVerdict, fit_friction, friction_ratio, judge_trial, stuck_area
from tests.slip_trials import SimulatedTrial, simulate_trial


def judged(trial: SimulatedTrial) -> TrialVerdict:
    return judge_trial(trial.stuck_area, trial.load_ratio, trial.time)


def test_an_area_that_vanishes_abruptly() -> None:
    trial = simulate_trial(0.8, 0.4, seed=3, collapse_ms=250)
    verdict = judged(trial)
    assert verdict.outcome == verdict.printed_outcome == "vanishes abruptly"
    assert verdict.critical_area == pytest.approx(1 / 3, abs=0.04)
    assert verdict.critical_extent == pytest.approx(verdict.critical_area**0.5)
    assert verdict.friction_ratio == pytest.approx(0.5, abs=0.1)
    assert verdict.loss_load_ratio == pytest.approx(0.8**2 / 1.2, rel=0.02)
    assert trial.time[verdict.loss_frame] == pytest.approx(3 + 0.25, abs=0.1)
    assert verdict.collapse_ms == pytest.approx(250, abs=60)
    assert verdict.corridor_ms > verdict.collapse_ms
    assert verdict.frames_measured == trial.time.size
    assert verdict.loading() == slice(0, verdict.collapse_frame + 1)
    assert not any(isinstance(value, np.generic) for value in asdict(verdict).values())


def test_the_largest_area_in_the_corridor_is_the_papers_number() -> None:
    """Without noise the largest area in the corridor is the model's d^2 where T/N enters the corridor."""
    trial = simulate_trial(0.8, 0.4, seed=0, frame_rate=1000, area_noise=0, load_noise=0, oscillation=0)
    verdict = judged(trial)
    at_edge = stuck_area(0.95 * 0.8**2 / 1.2, 0.8, 0.4).item()
    assert verdict.corridor_area == pytest.approx(at_edge, abs=0.005)
    assert verdict.model_area == pytest.approx(1 / 3, abs=0.005)
    assert verdict.critical_area == pytest.approx(1 / 3, abs=0.02)
    assert trial.time[verdict.corridor_frames[0]] == pytest.approx(0.95 * 3, abs=0.005)
    assert verdict.collapse_ms == pytest.approx(trial.collapse_ms, abs=5)


@pytest.mark.parametrize("mu_k", [0.8, 0.9, 1.2])
def test_an_area_that_fades_is_not_taken_for_one_that_vanishes(mu_k: float) -> None:
    """A fading area diminishes. With the printed limit of 0.05, which belongs to a misprinted curve, trials with mu_k <
    1 vanish abruptly.
    """
    verdict = judged(simulate_trial(0.8, mu_k, seed=4))
    assert verdict.outcome == verdict.model_outcome == "diminishes"
    assert verdict.printed_outcome == ("vanishes abruptly" if mu_k < 1 else "diminishes")
    assert np.isnan(verdict.friction_ratio)
    assert np.isnan(verdict.collapse_ms)


@pytest.mark.parametrize(
    ("mu_k", "last", "identified"),
    [(0.4, None, True), (0.2, None, True), (0.6, None, True), (0.9, None, True),
     (0.4, 0.34, False), (0.4, 0.2, False), (0.4, 0.1, False)],
)  # fmt: skip
def test_a_fit_that_contradicts_the_verdict_is_refused(mu_k: float, last: float | None, identified: bool) -> None:
    """Equation 5 fits a straight line exactly, with mu_k = 2 mu_s and no minimal area, where the line ends at one."""
    trial = simulate_trial(0.8, mu_k, 7, last=last)
    verdict = judged(trial)
    slow = verdict.loading()
    fit = fit_friction(trial.stuck_area[slow], trial.load_ratio[slow], resamples=100)
    assert fit.identified
    checked = verdict.check_fit(fit)
    assert checked.identified == identified
    if not identified:
        assert fit.ratio > 1.3 > 1 > verdict.friction_ratio
        assert re.match(r"the fitted curve, μk/μs \d\.\d\d, loses adhesion at T/N", checked.reason)
        assert verdict.check_fit(checked) is checked


@pytest.mark.parametrize(("rate", "collapse_ms"), [(60, 310), (300, 130)])
@pytest.mark.parametrize("last", [0.10, 0.15, 0.22, 0.34])
def test_an_area_that_falls_in_a_straight_line(last: float, collapse_ms: float, rate: float) -> None:
    """An area that falls in a straight line to a value in the paper's range vanishes abruptly; by the model only 0.34
    does.
    """
    for noise in (0.0, 0.01):
        trial = simulate_trial(
            0.8, 0.4, 1, rate, collapse_ms=collapse_ms, area_noise=noise, load_noise=noise / 2, oscillation=0, last=last
        )
        verdict = judged(trial)
        assert verdict.outcome == verdict.printed_outcome == "vanishes abruptly"
        if last != 0.22:  # d^2 is then 0.26 in the corridor, the limit of the model
            assert verdict.model_outcome == ("vanishes abruptly" if last > 0.3 else "diminishes")
        assert verdict.critical_area == pytest.approx(last, abs=0.02)
        assert abs(verdict.critical_area - last) < 2 * verdict.critical_area_std < 0.05
        assert verdict.collapse_ms == pytest.approx(collapse_ms, abs=50)
        assert abs(verdict.collapse_ms - collapse_ms) < 2 * verdict.collapse_ms_std
        assert abs(verdict.collapse_rate - 1000 * last / collapse_ms) < 2 * verdict.collapse_rate_std
        assert re.match(
            r"stick ratio d² 0\.\d\d when the load reached 95%, 0\.22 had it faded; critical d² ", verdict.reason
        )


def random_trial(seed: int, linear: bool) -> tuple[SimulatedTrial, str]:
    """Return a trial of random friction, rate, duration and noise, and its outcome; one in ten has an unsteady force,
    one in ten no full slip.

    With `linear` the area falls in a straight line to 0.10 to 0.34, as in the paper.
    """
    draw = np.random.default_rng(seed)
    mu_s = draw.uniform(0.5, 1.5)
    kind = draw.choice(["plain", "unsteady", "short"], p=[0.8, 0.1, 0.1])
    trial = simulate_trial(
        mu_s, mu_s * draw.uniform(0.3, 1.6), seed, frame_rate=draw.choice([60, 300]),
        loading_s=draw.uniform(1.5, 4), collapse_ms=draw.uniform(130, 310), area_noise=draw.uniform(0.005, 0.02),
        oscillation=draw.uniform(0.08, 0.15) if kind == "unsteady" else 0.01,
        reached=draw.uniform(0.5, 0.93) if kind == "short" else 1.0,
        last=draw.uniform(0.10, 0.34) if linear else None,
    )  # fmt: skip
    if kind != "plain":
        return trial, "inconclusive"
    return trial, "vanishes abruptly" if trial.critical_stuck_area > 0.05 else "diminishes"


@pytest.mark.long
@pytest.mark.parametrize("linear", [True, False])
def test_a_hundred_random_trials(linear: bool) -> None:
    """At least 95 of 100 random trials are judged right, for straight lines and for curves of the model; d^2 and
    duration agree within their deviations.
    """
    wrong, model_wrong, areas, times, errors = [], 0, [], [], []
    for seed in range(100):
        trial, truth = random_trial(seed, linear)
        verdict = judged(trial)
        model_wrong += verdict.model_outcome != truth
        if verdict.outcome != truth:
            wrong.append((seed, trial.critical_stuck_area, truth, verdict.reason))
        elif truth == "vanishes abruptly":
            areas.append((verdict.critical_area - trial.critical_stuck_area, verdict.critical_area_std))
            times.append((verdict.collapse_ms - trial.collapse_ms, verdict.collapse_ms_std))
            if not linear:
                loading = verdict.loading()
                fit = fit_friction(trial.stuck_area[loading], trial.load_ratio[loading], resamples=100)
                errors.append(fit.ratio / friction_ratio(trial.critical_stuck_area).item() - 1)
    assert len(wrong) <= 5, wrong
    assert (model_wrong > 30) == linear
    assert len(areas) > 25
    for found, limit in ((areas, 0.025), (times, 40)):
        error, deviation = np.transpose(found)
        assert np.sqrt(np.mean(error**2)) < limit
        assert np.mean(np.abs(error) < 2 * deviation) > 0.9
    if not linear:
        assert np.mean(np.abs(errors) < 0.05) > 0.9
        assert np.std(errors) < 0.03


def test_frames_without_a_number_or_of_stick_slip_change_nothing() -> None:
    """Unknown frames are counted. In single frames of stick-slip no skin seems to stick and the force dips."""
    for frame_rate, seed in ((300, 6), (60, 7)):
        trial, draw = simulate_trial(0.8, 0.4, seed, frame_rate), np.random.default_rng(0)
        area, load = trial.stuck_area.copy(), trial.load_ratio.copy()
        if frame_rate == 300:
            area[draw.random(area.size) < 0.15] = np.nan
            load[draw.random(load.size) < 0.1] = np.nan
        else:
            jumps = [60, 100, 150, 178]
            area[jumps], load[jumps] = 0, 0.7 * load[jumps]
        verdict, whole = judge_trial(area, load, trial.time), judged(trial)
        assert verdict.outcome == whole.outcome == "vanishes abruptly"
        assert verdict.critical_area == pytest.approx(whole.critical_area, abs=0.02)
        missing = (np.isnan(area) | np.isnan(load)).sum()
        assert verdict.frames_missing == missing
        assert (missing > 100) == (frame_rate == 300)


def sawtooth(trial: SimulatedTrial) -> np.ndarray:
    """Return a T/N that builds up and drops five times per second."""
    return trial.load_ratio * (1 - 0.25 * (5 * trial.time % 1))


def test_what_cannot_be_judged_says_why() -> None:
    trial = simulate_trial(0.8, 0.4, seed=8)
    area, load, time = trial.stuck_area, trial.load_ratio, trial.time
    after_forces = np.where(time > 2.5, np.nan, load)
    gap = np.where((time > 2.9) & (time < 3.05), np.nan, area)
    cases = {
        "T/N in the 0.05 s before the complete loss at 3.": (area, after_forces),
        "too unsteady: it falls by": (area, sawtooth(trial)),
        "too noisy": (area, load + 0.02 * np.random.default_rng(0).standard_normal(load.size)),
        "no full slip: d² is 0.": (area[:150], load[:150]),
        "never sticks": (0.4 * area, load),
        "the sign of a force": (area, -load),
        "is unknown for 0.15 s, longer than 0.1 s": (gap, load),
        "no loading was recorded": (area, np.full_like(load, 0.5)),
        "d² and T/N are known in 0 frames; 15 are needed": (np.full_like(area, np.nan), load),
        "known in 14 frames": (area[:14], load[:14]),
    }
    for reason, (some_area, some_load) in cases.items():
        verdict = judge_trial(some_area, some_load, time[: some_area.size])
        assert verdict.outcome == verdict.printed_outcome == "inconclusive", reason
        assert reason in verdict.reason
        assert np.isnan(verdict.critical_area)


def test_input_that_makes_no_trial() -> None:
    with pytest.raises(ValueError, match=r"shapes \(30,\), \(29,\) and \(30,\): give one value a frame"):
        judge_trial(np.ones(30), np.ones(29), np.arange(30))
    with pytest.raises(ValueError, match="the time does not increase"):
        judge_trial(np.ones(30), np.ones(30), np.zeros(30))
