"""Analysis of variance of a metric over groups of trials, with or without participants as a random effect."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Anova:
    """Result of an analysis of variance: F statistic, degrees of freedom, p-value, effect size eta^2, trials per group.

    eta^2 is the share of the variance that lies between groups. `participants` is 0 where trials count as independent.
    `epsilon` scales both degrees of freedom for p.
    """

    f: float
    degrees: tuple[int, int]
    p: float
    eta_squared: float
    trials: dict[str, int]
    missing: int
    reason: str = ""
    participants: int = 0
    epsilon: float = 1.0


def repeated_anova(values: ArrayLike, groups: ArrayLike, participants: ArrayLike) -> Anova:
    """Test whether a metric differs between groups of trials, with participants as a random effect.

    y_pg is the mean of participant p in group g, r_pg = y_pg - y_p. - y_.g + y_.. For P participants and G groups

        F(G - 1, (P - 1)(G - 1)) = P sum_g (y_.g - y_..)^2 (P - 1) / sum_pg r_pg^2.

    The effect is compared with its own variation over participants, so that trials of one participant need not be
    independent. With two groups this is the paired t test, F = t^2. Differences between groups need not vary alike:
    both degrees of freedom are multiplied by Huynh & Feldt's epsilon for p. With S = r^T r / (P - 1), d = G - 1 and
    e = tr(S)^2 / (d tr(S^2)), epsilon = (P d e - 2) / (d (P - 1 - d e)), at least 1 / d and at most 1.

    Args:
        values: (T,) the metric; NaN is left out.
        groups: (T,) condition or answer of each trial.
        participants: (T,) of the trials. One without a value in some group is left out.

    Returns:
        `Anova`; `missing` counts the trials left out, eta^2 is the partial one. NaN with the reason for fewer than two
        groups or participants, or values that do not vary.

    Raises:
        ValueError: lengths differ.
    """
    numbers = np.asarray(values, dtype=np.float64).reshape(-1)
    names, who = (_labels(one, numbers.size) for one in (groups, participants))
    known = np.isfinite(numbers)
    found, group = np.unique(names[known], return_inverse=True)
    people, person = np.unique(who[known], return_inverse=True)
    counts = np.zeros((people.size, found.size), dtype=np.intp)
    sums = np.zeros(counts.shape)
    np.add.at(counts, (person, group), 1)
    np.add.at(sums, (person, group), numbers[known])
    whole = (counts > 0).all(1)
    cells = sums[whole] / counts[whole]
    number, kinds = cells.shape
    trials = dict(zip(map(str, found.tolist()), counts[whole].sum(0).tolist(), strict=True))
    missing, between = numbers.size - sum(trials.values()), kinds - 1
    degrees = (between, (number - 1) * between)

    def nothing(reason: str) -> Anova:
        return Anova(math.nan, degrees, math.nan, math.nan, trials, missing, reason, number)

    if min(degrees) < 1:
        return nothing(f"{kinds} groups, {number} participants with trials in each: 2 of both are needed")
    own = cells - cells.mean(1, keepdims=True)
    rest = own - own.mean(0)
    effect, error = number * float((own.mean(0) ** 2).sum()), float((rest**2).sum())
    if error <= 1e-14 * float(((cells - cells.mean()) ** 2).sum()) or error == 0:
        return nothing("the differences between groups do not vary over participants")
    covariance = rest.T @ rest
    sphericity = float(np.trace(covariance)) ** 2 / (between * float((covariance**2).sum()))
    left = number - 1 - between * sphericity
    epsilon = (number * between * sphericity - 2) / (between * left) if left > 0 else 1.0
    epsilon = min(max(epsilon, 1 / between), 1.0)
    f = effect / degrees[0] / (error / degrees[1])
    p = float(stats.f.sf(f, epsilon * degrees[0], epsilon * degrees[1]))
    return Anova(f, degrees, p, effect / (effect + error), trials, missing, "", number, epsilon)


def one_way_anova(values: ArrayLike, groups: ArrayLike) -> Anova:
    """Test whether groups of trials differ in their mean, with independent trials as in Willemet et al. 2021.

    Their F(6, 1593) has the degrees of freedom of trials. Trials of one participant resemble each other: use
    `repeated_anova` for p. NaN values are left out and counted. The result is NaN, with the reason, for fewer than two
    groups of two trials, or no variation within any group.

    Raises:
        ValueError: values and groups differ in length.
    """
    numbers = np.asarray(values, dtype=np.float64).reshape(-1)
    names = _labels(groups, numbers.size)
    known = np.isfinite(numbers)
    split = {str(name): numbers[known & (names == name)] for name in np.unique(names)}
    counts, missing = {name: some.size for name, some in split.items()}, int((~known).sum())
    parts = [some for some in split.values() if some.size]
    degrees = (len(parts) - 1, sum(some.size for some in parts) - len(parts))
    if sum(some.size >= 2 for some in parts) < 2:
        reason = f"{len(parts)} groups with trials: two of two trials at least are needed"
        return Anova(math.nan, degrees, math.nan, math.nan, counts, missing, reason)
    within = sum(float(((some - some.mean()) ** 2).sum()) for some in parts)
    total = float(((numbers[known] - numbers[known].mean()) ** 2).sum())
    if within <= 1e-14 * total or total == 0:
        return Anova(math.nan, degrees, math.nan, math.nan, counts, missing, "the values do not vary within the groups")
    found = stats.f_oneway(*parts)
    return Anova(float(found.statistic), degrees, float(found.pvalue), 1 - within / total, counts, missing)


def _labels(of: ArrayLike, number: int) -> NDArray[Any]:
    names = np.asarray(of).reshape(-1)
    if names.size != number:
        raise ValueError(f"{number} values in {names.size} groups: name the group of every value")
    return names
