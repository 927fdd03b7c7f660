"""Printed results of Willemet et al. 2021, each with the function that computes it from the simulated study.

An effect is compared by its size and direction, as its p grows with the trials. A missing effect needs a bound: a test
without power finds none.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bench.papers.presses import DIVERGENCE_UNIT, PressStudy
from bench.papers.printed import SETTING, Interval, Obtained, Row, exactly, likely, predicted, put_in, rounded, within
from fingerflow.models.observer import Estimate, auc, one_way_anova, pearson, printed_observer, repeated_anova, spearman
from fingerflow.models.observer.estimate import jackknife
from fingerflow.models.observer.printed import BIN
from fingerflow.report.supplement import OBSERVED
from fingerflow.report.trial_metrics import participant_lines
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.trial_columns import DIFFERENCE, NUMBERS
from fingerflow.study.statistics import correlate_with_answers

Values = NDArray[np.float64]
_ALPHA = 0.05
_WEAK = 0.3  # rank correlation, either way, within which its whole interval counts as none
_SMALL_PERCENT = 10.0  # difference of an area between amplitudes, either way, likewise
_FELT = 13.1  # µm/mm, the criterion of divergence in print
_LINEAR = 0.2  # difference from 1 of the exponent of an area over the force, either way, that counts as almost linear
_SMALL_UM = 1.0  # µm, largest amplitude at which the groups differ in the paper


def _mean(values: Values) -> tuple[float, float, Interval]:
    """Return mean and standard deviation of the known values, and the 95 % confidence interval of the mean."""
    known = values[np.isfinite(values)]
    mean, deviation = float(known.mean()), float(known.std(ddof=1))
    return mean, deviation, likely(mean, deviation / math.sqrt(known.size))


def _with_limits(found: Estimate) -> str:
    low, high = found.interval
    return f"{found.value:.2f} ({low:.2f} to {high:.2f})"


# Rows on distributions over presses


def _distribution(study: PressStudy, metric: str, unit: str) -> tuple[str, tuple[Interval, ...]]:
    """Return mean ± standard deviation of a metric over all measured presses as text, and the 95 % confidence intervals
    of mean and of standard deviation.
    """
    values = study.values(metric)
    values = values[np.isfinite(values)]
    mean, deviation, interval = _mean(values)
    # The variance of a variance is (fourth moment - squared variance) / n, for any distribution.
    fourth = float(((values - mean) ** 4).mean())
    error = math.sqrt(max(fourth - deviation**4, 0.0) / values.size) / (2 * deviation)
    text = f"{format_uncertainty(mean, deviation)} {unit} in {values.size} presses"
    return text, (interval, likely(deviation, error))


def _forces(study: PressStudy) -> Obtained:
    values = study.values("max_force")
    text, numbers = _distribution(study, "max_force", "N")
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return Obtained(
        f"{low:.1f} to {high:.1f} N, {text}", (*exactly(low, high), numbers[0]), _truth(study, "true_force", "N"),
        "a few presses differ in mean from many",
    )  # fmt: skip


def _durations(study: PressStudy) -> Obtained:
    values, (shortest, longest) = study.values("duration"), study.design.duration
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    truth, because = f"{shortest:g} to {longest:g} s", "frames round the duration"
    return Obtained(f"{low:.2f} to {high:.2f} s", exactly(low, high), truth, because)


def _as_designed(study: PressStudy, metric: str, unit: str, design: tuple[float, float], because: str) -> Obtained:
    """Compare mean and standard deviation of a metric over all measured presses with the values `design` from which the
    simulation drew them; `because` explains a difference.
    """
    return Obtained(*_distribution(study, metric, unit), f"{design[0]:g} ± {design[1]:g} {unit}", because)


def _global_displacements(study: PressStudy) -> Obtained:
    truth = f"{_truth(study, 'true_displacement', 'mm')}, of the skin as a whole"
    return Obtained(*_distribution(study, "global_displacement", "mm"), truth, "none above 0.5 mm are drawn")


def _truth(study: PressStudy, column: str, unit: str) -> str:
    values = study.frame[column].to_numpy(float)
    return f"{np.nanmean(values):.3g} ± {np.nanstd(values, ddof=1):.2g} {unit}"


_CHANCE = "the presses of this study are few"


# Rows on contact areas


def _area(study: PressStudy, metric: str) -> Obtained:
    """Return mean and SD over participants of a contact area (mm²) at the largest force, taken for each participant as
    the median of the presses.
    """
    own = study.frame.groupby("participant")[[metric, f"true_{metric}"]].median()
    found, truth = own.to_numpy(float).T
    mean, deviation, interval = _mean(found)
    text = f"{mean:.1f} ± {deviation:.1f} mm² over {found.size} participants, at the largest force"
    because = "the median of a participant depends on the forces of the few presses"
    return Obtained(text, (interval,), f"{truth.mean():.1f} ± {truth.std(ddof=1):.1f} mm²", because)


def _slopes(study: PressStudy) -> Obtained:
    """Compute Spearman's rank correlation, over presses, between vibration amplitude and the slope of real contact area
    against normal force from 1 to 3 N.

    The area is normalised by the median of the participant.
    """
    frame = study.measured
    median = frame.groupby("participant")["real_contact_area"].transform("median")
    slope = (frame["real_contact_area_at_3n"] - frame["real_contact_area_at_1n"]) / 2 / median
    found = spearman(frame["condition"], slope, participants=frame["participant"])
    text = f"{_with_limits(found)}, p = {found.p:.2g}, {found.trials} presses that reach 3 N"
    return Obtained(text, (found.interval,), because="few participants leave a wide interval")


def _area_reduction(study: PressStudy) -> Obtained:
    """Compute by how many percent the largest vibration amplitude reduces the real contact area at 3 N against the
    smallest: mean and 95 % interval over participants.
    """
    text, interval = _fall(study, "real_contact_area_at_3n")
    return Obtained(f"{text} at 3 N", (interval,), f"{100 * study.design.real_area_fall:g} %", _CHANCE)


def _fall(study: PressStudy, area: str) -> tuple[str, Interval]:
    """Return by how many percent an area is smaller at the largest amplitude than at the smallest: the mean over
    participants as text, and its 95 % interval.
    """
    means = study.measured.groupby(["participant", "condition"])[area].mean().unstack()
    fall = 100 * (1 - means.iloc[:, -1] / means.iloc[:, 0]).dropna().to_numpy(float)
    low, high = stats.t.interval(0.95, fall.size - 1, fall.mean(), stats.sem(fall))
    return f"{fall.mean():.0f} % ({low:.0f} to {high:.0f} %), {fall.size} participants", (float(low), float(high))


def _trends(study: PressStudy) -> Obtained:
    text, (low, high) = _fall(study, "gross_contact_area_at_3n")
    at_1n, at_3n = (study.measured[f"real_contact_area_at_{force}n"] for force in (1, 3))
    exponents = (np.log(at_3n / at_1n) / math.log(3)).groupby(study.measured["participant"]).mean().to_numpy(float)
    mean, _, (least, most) = _mean(exponents)
    falls = _bounded(low / _SMALL_PERCENT, high / _SMALL_PERCENT)
    linear = _bounded((least - 1) / _LINEAR, (most - 1) / _LINEAR)
    return Obtained(
        f"apparent area at 3 N falls by {text}; real area from 1 to 3 N grows with the force to the power of "
        f"{mean:.2f} ({least:.2f} to {most:.2f})",
        agrees=_both(falls, linear),
        because="the real area is a share of the apparent one here; in proportion to the pressure, the power is 1",
    )


def _both(*verdicts: bool | None) -> bool | None:
    """Return True if all verdicts are, False if one is, else None."""
    return False if False in verdicts else True if all(verdicts) else None


def _bounded(low: float, high: float) -> bool | None:
    """Return True if an interval lies within -1 to 1, False if outside, else None: the effect is not decided."""
    return True if low > -1 and high < 1 else False if low > 1 or high < -1 else None


# Rows on hypothesis tests


def _p(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "no p"
    return "p < 0.001" if value < 1e-3 else f"p = {value:.2g}"


def _anovas(values: Any, groups: Any, who: Any) -> dict[str, Any]:
    return asdict(repeated_anova(values, groups, who)) | {"as_printed": asdict(one_way_anova(values, groups))}


def _anova_text(test: dict[str, Any]) -> str:
    """Return the F tests of an ANOVA as text: with participants as units, and with trials as units as in the paper."""
    if not math.isfinite(test["f"]):
        return f"no F: {test['reason']}"
    printed = test["as_printed"]
    return _f_text(test) + (f"; trials as independent {_f_text(printed)}" if math.isfinite(printed["f"]) else "")


def _f_text(test: dict[str, Any]) -> str:
    return f"F({', '.join(map(str, test['degrees']))}) = {test['f']:.1f}, {_p(test['p'])}"


def _no_effects(study: PressStudy) -> Obtained:
    trials, texts, effects = study.sample.trials, [], []
    for name in ("max_force", "time_to_max_force", "duration"):
        columns = trials.metrics[name], trials.answer, trials.participant
        test, rank = _anovas(*columns), spearman(*columns)
        texts.append(f"{NUMBERS[name].words}: {_anova_text(test)}, Spearman's rho {_with_limits(rank)}")
        # By the test in print, which takes trials as independent, each at a third of the level.
        effects.append((rank.interval, test["as_printed"]["p"] < _ALPHA / 3))
    return Obtained(
        "; ".join(texts), agrees=_absent(*effects),
        because="divergence grows with force: felt at 3 N in all presses, F(1, 808) falls from 121 to 0.2",
    )  # fmt: skip


def _rate_on_answers(study: PressStudy) -> Obtained:
    found = study.statistics["force_rate"]
    low, high = found["interval"]
    return Obtained(
        f"{found['value']:+.3f} ({low:+.3f} to {high:+.3f}) {found['unit']}, {_p(found['p'])}, "
        f"{found['trials']} trials",
        agrees=found["value"] > 0 if found["p"] < _ALPHA else None,
        because="evidence that grows with the rate shows only where the divergence differs",
    )


def _unrelated(study: PressStudy, *metrics: str, because: str) -> Obtained:
    """Test that none of the metrics is correlated with the share of "more slippery" answers (Spearman, over pairs of
    participant and condition); `because` explains a difference from the paper.
    """
    trials = study.sample.trials
    found = {metric: correlate_with_answers(trials, study.column_of_sample(metric)) for metric in metrics}
    if unknown := [f"{_words(metric)}: {one.reason}" for metric, one in found.items() if not math.isfinite(one.value)]:
        return Obtained("", because=f"no coefficient of {'; '.join(unknown)}")
    text = "; ".join(
        f"{_words(metric)}: {one.value:.2f}, {_p(one.p)}, {one.trials} dots" for metric, one in found.items()
    )
    return Obtained(text, agrees=_absent(*((one.interval, one.p < _ALPHA) for one in found.values())), because=because)


def _absent(*found: tuple[Interval, bool]) -> bool | None:
    """Return False if a test finds an effect, True if all intervals of rank correlations are weak, else None."""
    return _both(*(False if effect else _bounded(low / _WEAK, high / _WEAK) for (low, high), effect in found))


def _words(metric: str) -> str:
    own = NUMBERS[metric.removesuffix(DIFFERENCE)].words
    return f"{own} difference" if metric.endswith(DIFFERENCE) else own


def _by_amplitude(study: PressStudy, metric: str, because: str = _CHANCE) -> Obtained:
    """Test whether a metric of all presses, the reference presses being a level, differs between the amplitudes."""
    columns: Any = [study.measured[name].to_numpy() for name in (metric, "condition", "participant")]
    size = _effect(lambda x, groups, _: one_way_anova(x, groups), *columns)
    return Obtained(f"{_anova_text(_anovas(*columns))}; effect {_with_limits(size)}", (size.interval,), because=because)


def _size(f: float, groups: int, trials: int) -> float:
    """Compute the effect size, Cohen's f, from an F statistic and its degrees of freedom, less the F of 1 that is
    expected without an effect.
    """
    return math.sqrt(max(f - 1, 0.0) * groups / trials)


def _effect(test: Callable[..., Any], values: Any, levels: Any, who: Any) -> Estimate:
    """Compute the effect size, Cohen's f, of levels (T,) on values (T,) by an analysis of variance `test`, with its
    interval by the jackknife over participants. It is negative if values fall as levels rise.
    """

    def signed(chosen: Any) -> float:
        found = test(values[chosen], levels[chosen], who[chosen])
        return math.copysign(_size(found.f, *found.degrees), np.cov(values[chosen], levels[chosen])[0, 1])

    known = np.isfinite(values)
    size, without = signed(known), [signed(known & (who != name)) for name in np.unique(who)]
    return Estimate(size, jackknife(size, without)[0]) if any(without) else Estimate(0.0, (0.0, 0.0))


def _angle_at(study: PressStudy, place: int) -> Obtained:
    """Return mean ± SD over presses of the angle (degrees) between force and surface normal, at the smallest (`place`
    0) or largest (-1) vibration amplitude.
    """
    frame = study.measured
    amplitude = sorted(set(frame["condition"]))[place]
    own = np.degrees(frame.loc[frame["condition"] == amplitude, "force_angle"].to_numpy(float))
    mean, deviation, interval = _mean(own)
    text = f"{mean:.1f}° ± {deviation:.1f}° at {amplitude:g} µm, {np.isfinite(own).sum()} presses"
    return Obtained(text, (interval,), f"{study.design.angle[place]:g}° in the mean", _CHANCE)


# Rows on strain and energy


def _strain_curve(study: PressStudy) -> Obtained:
    own = study.curves[study.curves["metric"] == "strain"]
    force = (0.5, 1.0, 2.0, 3.0)
    curves = [curve for _, curve in own.groupby("condition") if curve["normal_force_N"].max() >= force[-1]]
    at = 100 * np.array([np.interp(force, curve["normal_force_N"], curve["mean"]) for curve in curves])
    early, late = (at[:, 1] - at[:, 0]) / 0.5, at[:, 3] - at[:, 2]
    text = "; ".join(
        f"{values.min():.2f} to {values.max():.2f} % at {where:g} N" for where, values in zip(force, at.T, strict=True)
    )
    return Obtained(
        f"{text}, over amplitudes; slope up to 1 N {_signed(early)}, from 2 to 3 N {_signed(late)}",
        agrees=bool((late < early / 5).all() and at.min() > 0),
        because="at low friction skin slides: with friction from 0.4 to 0.15 the late slope is up to 0.21 of the early",
    )


def _signed(values: Values) -> str:
    return f"{values.min():+.2f} to {values.max():+.2f} %/N"


def _peak_force(study: PressStudy, rate: str) -> Obtained:
    """Return the force (N) at which a rate is largest: the median over presses of each amplitude, as mean ± standard
    deviation over amplitudes.
    """
    mean, deviation, interval = _mean(study.measured.groupby("condition")[f"force_of_{rate}"].median().to_numpy(float))
    return Obtained(f"{format_uncertainty(mean, deviation)} N over the amplitudes", (interval,))


def _strain_against_divergence(study: PressStudy) -> Obtained:
    trials = study.sample.trials
    columns = 1000 * trials.metrics["divergence"], 100 * trials.metrics["strain"], trials.participant
    found, lines = pearson(*columns), participant_lines(*columns)
    (slope, _, of_slope), (strain, _, of_strain) = (_mean(values) for values in (lines[:, 0], lines @ (_FELT, 1.0)))
    return Obtained(
        f"r = {_with_limits(found)}, R² = {found.value**2:.2f}; mean line of the participants y = {slope:.3f} x "
        f"{strain - _FELT * slope:+.3f} (% and {DIVERGENCE_UNIT}), {strain:.2f} % at {_FELT:g}; {found.trials} trials",
        (found.interval, of_slope, of_strain),
        because="strain counts from the first frame with force, divergence from onset in the dilated contact; both "
        f"since a point's own onset, it is 0.65 % at {_FELT:g} {DIVERGENCE_UNIT}",
    )


def _energy(study: PressStudy) -> Obtained:
    text, numbers = _distribution(study, "strain_energy", "mJ")
    text = f"{text}, median {float(np.nanmedian(study.values('strain_energy'))):.2g} mJ"
    return Obtained(text, numbers[:1], because="few presses have most: 0.64 mJ with friction from 0.4 to 0.15")


def _peak_energy_rate(study: PressStudy) -> Obtained:
    medians = study.measured.groupby("condition")["strain_energy_rate"].median().to_numpy(float)
    mean, deviation, interval = _mean(medians)
    force = _peak_force(study, "strain_energy_rate")
    because = "at low friction skin slides on: with friction from 0.4 to 0.15 it is largest at 2.4 ± 2.2 N"
    text = f"{format_uncertainty(mean, deviation)} mJ/s at {force.text}"
    return Obtained(text, (interval, *force.numbers), because=because)


def _energy_slope(study: PressStudy) -> Obtained:
    trials = study.sample.trials
    slopes = participant_lines(trials.metrics["divergence"], trials.metrics["strain_energy"], trials.participant)[:, 0]
    mean, deviation, interval = _mean(slopes)
    return Obtained(
        f"{mean:.2g} ± {deviation:.2g} mJ per unit of divergence ({mean / 1000:.2g} mJ per {DIVERGENCE_UNIT}), "
        f"{len(slopes)} participants",
        (interval,),
        because=f"the divergence's unit is not said: per 0.1 the slope is {mean / 10:.1f} ± {deviation / 10:.1f} mJ",
    )


def _rate_of_strain_on_answers(study: PressStudy) -> Obtained:
    right = float(stats.f.sf(2.12, 5, 70))
    # F(5, 70) is that of 15 participants and 6 levels.
    answered = study.measured.dropna(subset=["answer", "strain_rate"])
    sixth = np.ceil(6 * answered.groupby("participant")["strain_rate"].rank(pct=True)).to_numpy()
    columns = answered["answer"].to_numpy(float), sixth, answered["participant"].to_numpy()
    test, size = repeated_anova(*columns), _effect(repeated_anova, *columns)
    return Obtained(
        f"answers by sixths of each participant's strain rates: {_f_text(asdict(test))}; effect {_with_limits(size)}",
        (size.interval,),
        because=f"both grow with force: felt at 3 N in all, the effect is 0.00; F(5,70) = 2.12 gives p = {right:.3f}",
    )


# Rows on the ideal observer


def _normalisation(study: PressStudy) -> Obtained:
    correct, incorrect = study.sample.trials.split("divergence")
    values = np.concatenate((correct, incorrect))
    values = values[np.isfinite(values)]
    share = float((values <= printed_observer(correct, incorrect).scale).mean())
    return Obtained(f"{share:.2f} quantile; {BIN:g}", ((share - 1 / values.size, share + 1 / values.size), (BIN, BIN)))


def _criterion(study: PressStudy) -> Obtained:
    found = study.statistics["observer"]["metrics"]["divergence"]
    one, wrong = found["criterion"], found["false_alarms"]["value"]
    low, high = one["interval"]
    truth = 1000 * study.column_of_sample("true_divergence")[study.sample.trials.answer]
    return Obtained(
        f"{one['value']:.1f} ({low:.1f} to {high:.1f}) {one['unit']}, false alarms {wrong:.2f}",
        ((low, high),),
        f"{np.quantile(truth, 0.25):.1f} {DIVERGENCE_UNIT}",
        f"it follows friction: from 0.25 to 0.155 it is 14.5 (5.6 to 22.3) {DIVERGENCE_UNIT}",
    )


_PRINTED_RANKS = {"divergence": 3, "force_angle": 2, "global_displacement": 1}  # of 0 for all others


def _ranking(study: PressStudy) -> Obtained:
    found = study.statistics["observer"]["metrics"]
    alone = {name: found[name]["auc"]["value"] for name in OBSERVED if name in found}
    answer, who = study.sample.trials.answer, study.sample.trials.participant
    pairs = {name: study.column_of_sample(name + DIFFERENCE) for name in OBSERVED}
    differences = {
        name: auc(one[answer], one[~answer], (who[answer], who[~answer])).value for name, one in pairs.items()
    }
    printed = [_PRINTED_RANKS.get(name, 0) for name in differences]
    # d' has no sign in print: a smaller angle tells as well.
    tau, p = stats.kendalltau(printed, [abs(area - 0.5) for area in differences.values()])
    return Obtained(
        f"Kendall's tau {tau:.2f}, {_p(p)}; areas under the ROC, of differences between the two presses: "
        f"{_ordered(differences)}; of the comparison alone: {_ordered(alone)}",
        agrees=tau > 0 if p < _ALPHA else None,
        truth="the observer feels the difference of divergence",
        because="energy measures the same spread; with half the weight of the displacement tau is 0.39",
    )


def _ordered(areas: dict[str, float]) -> str:
    known = sorted((name for name, area in areas.items() if area is not None), key=lambda name: -areas[name])
    return ", ".join(f"{NUMBERS[name].words} {areas[name]:.2f}" for name in known)


def _soft_advantage(study: PressStudy) -> Obtained:
    trials = study.sample.trials
    soft = study.column_of_sample("true_softness") > np.mean(study.design.softness)
    small = trials.condition.astype(float) <= _SMALL_UM
    who = trials.participant
    firmer, softer = (np.array([trials.answer[small & (who == name)].mean() for name in np.unique(who[group])])
                      for group in (~soft, soft))  # fmt: skip
    p = float(stats.ttest_ind(softer, firmer, equal_var=False).pvalue)
    groups = study.statistics["groups"]
    split = f"{groups.get('groups')} groups, {_p(groups.get('p'))}" if not groups.get("reason") else groups["reason"]
    return Obtained(
        f"p(more slippery) at α ≤ 1 µm: softer {softer.mean():.2f}, firmer {firmer.mean():.2f} (of {softer.size} and "
        f"{firmer.size} participants, {_p(p)}); split by divergence: {split}",
        agrees=bool(softer.mean() > firmer.mean()) if p < _ALPHA else None,
        truth="softer skin is pressed less",
        because="under one mean force, softness of 1.4 and 0.7 gives 0.78 and 0.63, p = 0.006",
    )


def _curl(study: PressStudy) -> Obtained:
    frame = study.measured
    found = pearson(frame["divergence"], frame["curl"], participants=frame["participant"])
    return Obtained(
        f"r = {_with_limits(found)}, {_p(found.p)}, {found.trials} presses",
        (found.interval,),
        "no curl: u_x - u_y, of which the script takes the median for curl, follows the spread: the likely cause of "
        "the printed r",
        "with errors of 3 and 6 µm/mm in both r is 0.84 and 0.60; those of the lab are not printed",
    )


def _of_skin(*columns: Any) -> Row[PressStudy]:
    """Return the row of a prediction by the printed analysis, beside its text by this engine's, from the `columns` of a
    `Row` that computes the result of one.
    """

    def of_both(study: PressStudy) -> Obtained:
        found = columns[-1](study)
        if study.own is None:
            return found
        other = columns[-1](study.own)
        return replace(found, text=f"{found.text}. Since each point's own onset: {other.text or other.because}")

    return replace(predicted(*columns), obtain=of_both)


ROWS: tuple[Row[PressStudy], ...] = (
    put_in("B5", "apparent contact area", "70.1 ± 4.5 mm²", "Friction modulation", within(70.1, 4.5),
        partial(_area, metric="gross_contact_area")),
    put_in("B6", "real contact area", "23.7 ± 4.5 mm²", "Friction modulation", within(23.7, 4.5),
        partial(_area, metric="real_contact_area")),
    put_in("B7", "slope of real area against force, by α", "Spearman -0.28, p < 0.0001", "S1E, S1F",
        rounded(-0.28, digit=0.01), _slopes),
    put_in("B8", "fall of real area", "38 %", "S1F", rounded(38, digit=1), _area_reduction),
    predicted("B9", "area trends", "apparent: no effect of α; real: almost linear in force", "S1C to S1E", (), _trends),
    put_in("B34", "normal force", "1 to 18 N, mean about 5.5 N", "S5B", ((1, 18), (1, 18), (5, 6)), _forces),
    put_in("B35", "time to peak force", "1.47 ± 0.39 s", "S5C", rounded(1.47, 0.39, digit=0.01), lambda study:
        _as_designed(study, "time_to_max_force", "s", study.design.time_to_peak, _CHANCE)),
    put_in("B36", "trial duration", "1 to 2.5 s", "S5D", ((0.9, 2.6), (0.9, 2.6)), _durations),
    predicted("B37", "effect on answers", "p = 0.31 (force), 0.99 (time), 0.91 (duration)", "S5E to S5G", (),
        _no_effects),
    put_in("B38", "force rate", "3.6 ± 3 N/s", "S5H", (*rounded(3.6, digit=0.1), *rounded(3, digit=1)), lambda study:
        Obtained(*_distribution(study, "force_rate", "N/s"), because="it is the mean rate of a press")),
    put_in("B39", "force rate on answers", "mixed model p = 0.018, α ≤ 2 µm", "S5I", (), _rate_on_answers),
    put_in("B40", "global displacement", "0.08 ± 0.10 mm", "S7A", rounded(0.08, 0.10, digit=0.01),
        _global_displacements),
    put_in("B41", "its link to answers", "Spearman 0.14, p = 0.2", "S7C", (), lambda study: _unrelated(
        study, "global_displacement", because="the displacement of the skin includes its spread")),
    put_in("B42", "force angle by α", f"F(6,1593) = 67.9, p < 0.001: effect {-_size(67.9, 6, 1593):.2f}", "S7B",
        exactly(-_size(67.9, 6, 1593)), partial(_by_amplitude, metric="force_angle")),
    put_in("B43", "peak angle, high friction", "9.9° ± 4.9°", "S7B", within(9.9, 4.9), partial(_angle_at, place=0)),
    put_in("B44", "peak angle, low friction", "4.2° ± 2.1°", "S7B", within(4.2, 2.1), partial(_angle_at, place=-1)),
    put_in("B45", "angle on answers", "Spearman 0.24, p = 0.03, not correlated", "S7D", (), lambda study: _unrelated(
        study, "force_angle" + DIFFERENCE,
        because="the angle falls with friction by design: with one mean angle for all, rho is 0.04")),
    predicted("B46", "real area on answers", "Spearman -0.07, p = 0.49", "S7E", (), lambda study: _unrelated(
        study, "real_contact_area" + DIFFERENCE,
        because="the real area falls with the amplitude by design: without that, rho is 0.00")),
    _of_skin("B47", "strain curve", "all positive; inflection at 1 N; flat above 2 N", "S8E", (), _strain_curve),
    _of_skin("B48", "force at peak strain rate", "0.37 ± 0.7 N", "S8F", within(0.37, 0.07), lambda study: replace(
        _peak_force(study, "strain_rate"), because="damping delays the stretch: if forces rise as sin², at 0.01 N")),
    _of_skin("B49", "strain against divergence", "r = 0.78; y = 0.040 x - 0.225, R² = 0.61", "S8G",
        (*rounded(0.78, digit=0.01), *exactly(0.040, 0.040 * _FELT - 0.225)), _strain_against_divergence),
    _of_skin("B50", "strain energy", "0.32 ± 0.52 mJ", "S9B", within(0.32, 0.52), _energy),
    _of_skin("B51", "energy by α", f"F(6,1481) = 3.2, p = 0.004: effect {_size(3.2, 6, 1481):.2f}", "Strain results",
        exactly(_size(3.2, 6, 1481)), partial(_by_amplitude, metric="strain_energy",
        because="skin that slides has most energy: with friction from 0.4 to 0.25 the effect is 0.00")),
    _of_skin("B52", "peak energy rate", "1.2 ± 0.2 mJ/s at 0.4 ± 0.1 N", "S9C", (*within(1.2, 0.2), *within(0.4, 0.1)),
        _peak_energy_rate),
    _of_skin("B53", "energy over divergence", "slope 3.6 ± 2.3 mJ", "S9D", within(3.6, 2.3), _energy_slope),
    _of_skin("B54", "strain rate on answers", f"F(5,70) = 2.12, p = 0.023: effect {_size(2.12, 5, 70):.2f}", "S8I",
        exactly(_size(2.12, 5, 70)), _rate_of_strain_on_answers),
    _of_skin("B55", "strain, energy differences on answers", "not correlated", "S8H, S9E", (),
        lambda study: _unrelated(study, "strain" + DIFFERENCE, "strain_energy" + DIFFERENCE,
        because="both follow friction in the chain: with friction from 0.4 to 0.25, rho is 0.09 and 0.03")),
    Row("B63", "normalisation, bins", "0.9 quantile; 0.05", "Observer", exactly(0.9, 0.05), _normalisation),
    _of_skin("B64", "divergence criterion", f"13.1 {DIVERGENCE_UNIT} gives 75 % hits", "Observer",
        rounded(_FELT, digit=0.1), _criterion),
    _of_skin("B65", "ranking", "divergence first; then force angle, global displacement", "S11B, S11C", (), _ranking),
    predicted("B66", "soft group advantage", "α ≤ 1 µm", "S12", (), _soft_advantage),
    replace(_of_skin("B67", "curl against divergence", "Pearson 0.7726, p < 0.0001", "S13C",
        rounded(0.7726, digit=0.0001), _curl), basis=SETTING),
)  # fmt: skip
