"""Analysis of variance of a metric over groups of trials, with or without participants as a random effect.

`AnovaRM` of statsmodels has the same F, but no correction of its p for differences that do not vary alike.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats


@dataclass(frozen=True)
class Anova:
    """Result of an analysis of variance: F statistic, degrees of freedom, p-value, effect size eta^2, trials per group.

    eta^2 is the share of the variance that lies between groups. `participants` is 0 where trials count as independent.
    `epsilon` scales both degrees of freedom for p.
    """

    degrees: tuple[int, int]
    trials: dict[str, int]
    missing: int
    f: float = math.nan
    p: float = math.nan
    eta_squared: float = math.nan
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
    numbers, names, who = _columns(values, groups, participants)
    valid = np.isfinite(numbers)
    labels, group = np.unique(names[valid], return_inverse=True)
    people, person = np.unique(who[valid], return_inverse=True)
    cell, shape = person * labels.size + group, (people.size, labels.size)
    counts, sums = (np.bincount(cell, by, people.size * labels.size).reshape(shape) for by in (None, numbers[valid]))
    whole = (counts > 0).all(1)
    cells = sums[whole] / counts[whole]
    number, kinds = cells.shape
    trials = {str(name): int(count) for name, count in zip(labels, counts[whole].sum(0), strict=True)}
    between = kinds - 1
    nothing = Anova((between, (number - 1) * between), trials, numbers.size - sum(trials.values()), participants=number)
    if min(nothing.degrees) < 1:
        reason = f"{kinds} groups, {number} participants with trials in each: 2 of both are needed"
        return replace(nothing, reason=reason)
    centred = cells - cells.mean(1, keepdims=True)
    rest = centred - centred.mean(0)
    effect, error = number * float((centred.mean(0) ** 2).sum()), float((rest**2).sum())
    if error <= 1e-14 * float(((cells - cells.mean()) ** 2).sum()) or error == 0:
        return replace(nothing, reason="the differences between groups do not vary over participants")
    covariance = rest.T @ rest
    sphericity = float(np.trace(covariance)) ** 2 / (between * float((covariance**2).sum()))
    left = number - 1 - between * sphericity
    epsilon = (number * between * sphericity - 2) / (between * left) if left > 0 else 1.0
    epsilon = min(max(epsilon, 1 / between), 1.0)
    f = effect / nothing.degrees[0] / (error / nothing.degrees[1])
    p = float(stats.f.sf(f, epsilon * nothing.degrees[0], epsilon * nothing.degrees[1]))
    return replace(nothing, f=f, p=p, eta_squared=effect / (effect + error), epsilon=epsilon)


def one_way_anova(values: ArrayLike, groups: ArrayLike) -> Anova:
    """Test whether groups of trials differ in their mean, with independent trials as in Willemet et al. 2021.

    Their F(6, 1593) has the degrees of freedom of trials. Trials of one participant resemble each other: use
    `repeated_anova` for p. NaN values are left out and counted. The result is NaN, with the reason, for fewer than two
    groups of two trials, or no variation within any group.

    Raises:
        ValueError: values and groups differ in length.
    """
    numbers, names = _columns(values, groups)
    valid = np.isfinite(numbers)
    parts = {str(name): numbers[valid & (names == name)] for name in np.unique(names)}
    sizes = {name: part.size for name, part in parts.items()}
    full = [part for part in parts.values() if part.size]
    nothing = Anova((len(full) - 1, int(valid.sum()) - len(full)), sizes, int((~valid).sum()))
    if sum(part.size >= 2 for part in full) < 2:
        return replace(nothing, reason=f"{len(full)} groups with trials: two of two trials at least are needed")
    within = sum(float(((part - part.mean()) ** 2).sum()) for part in full)
    total = float(((numbers[valid] - numbers[valid].mean()) ** 2).sum())
    if within <= 1e-14 * total or total == 0:
        return replace(nothing, reason="the values do not vary within the groups")
    test = stats.f_oneway(*full)
    return replace(nothing, f=float(test.statistic), p=float(test.pvalue), eta_squared=1 - within / total)


def _columns(values: ArrayLike, *labels: ArrayLike) -> tuple[NDArray[Any], ...]:
    columns = (np.asarray(values, dtype=np.float64), *map(np.asarray, labels))
    flat = tuple(column.reshape(-1) for column in columns)
    if len({column.size for column in flat}) > 1:
        raise ValueError(
            f"{flat[0].size} values in {[column.size for column in flat[1:]]} groups: name that of every value"
        )
    return flat
