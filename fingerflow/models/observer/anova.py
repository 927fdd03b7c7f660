"""Analysis of variance of a metric over groups of trials, with or without participants as a random effect.

`AnovaRM` of statsmodels has the same F where every participant has trials in every group, and refuses other tables.
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

    y_pg is the mean of participant p in group g, a_p + b_g + r_pg. Participants without trials in a group
    count with the others, so that F is that of two fits by least squares, without and with b_g (Yates 1933):

        F(G - 1, n - P - G + 1) = (sum r_p^2 - sum r_pg^2) (n - P - G + 1) / (sum r_pg^2 (G - 1))

    for n cells of P participants and G groups. The effect is compared with its own variation over participants, so that
    trials of one participant need not be independent. With two groups this is the paired t test, F = t^2. Differences
    between groups need not vary alike: both degrees of freedom are multiplied by Huynh & Feldt's epsilon for p. With
    S = r^T r, r_pg = 0 in an empty cell, d = G - 1, e = tr(S)^2 / (d tr(S^2)), and P one more than the second degree of
    freedom over d, epsilon = (P d e - 2) / (d (P - 1 - d e)), at least 1 / d and at most 1.

    Of 500 studies without effect of 16 participants and 7 groups, 7 of whom lack a group, p was below 0.05 in 6 %,
    and F is within some percent of that of a random-effects model (MixedLM of statsmodels)
    (`python -m tests.models.observer.error_rates`).

    Args:
        values: (T,) the metric; NaN is left out.
        groups: (T,) condition or answer of each trial.
        participants: (T,) of the trials. One with values in a single group is left out.

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
    counts[(counts > 0).sum(1) < 2] = 0  # a participant in one group shows no difference between groups
    filled, number, between = counts > 0, int(counts.any(1).sum()), labels.size - 1
    trials = {str(name): int(count) for name, count in zip(labels, counts.sum(0), strict=True)}
    left = int(filled.sum()) - number - between
    nothing = Anova((between, left), trials, numbers.size - sum(trials.values()), participants=number)
    if min(between, number - 1, left) < 1:
        reason = f"{labels.size} groups, {number} participants with trials in two of them: 2 of both are needed"
        return replace(nothing, reason=reason)
    person, group = np.nonzero(filled)
    cells = sums[filled] / counts[filled]
    cells -= cells.mean()
    each = np.eye(people.size)[person]
    (alone, rank), (resid, full_rank) = (_residuals(cells, design) for design in (
        each, np.hstack((each, np.eye(labels.size)[group]))))  # fmt: skip
    effect, error = alone @ alone - resid @ resid, resid @ resid
    if full_rank - rank < between:
        return replace(nothing, reason="groups without a participant in common cannot be compared")
    if error <= 1e-14 * (cells @ cells) or error == 0:
        return replace(nothing, reason="the differences between groups do not vary over participants")
    rest = np.zeros(shape)
    rest[filled] = resid
    covariance = rest.T @ rest
    sphericity = float(np.trace(covariance)) ** 2 / float((covariance**2).sum())  # d e
    freedom = left / between - sphericity
    epsilon = ((left + between) / between * sphericity - 2) / (between * freedom) if freedom > 0 else 1.0
    epsilon = min(max(epsilon, 1 / between), 1.0)
    f = float(effect / between / (error / left))
    p = float(stats.f.sf(f, epsilon * between, epsilon * left))
    return replace(nothing, f=f, p=p, eta_squared=float(effect / (effect + error)), epsilon=epsilon)


def _residuals(values: NDArray[np.float64], design: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Return what least squares leaves of values (n,) by a design (n, k), and the rank of the design."""
    fitted, _, rank, _ = np.linalg.lstsq(design, values)
    return values - design @ fitted, int(rank)


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
    flat = tuple(column.reshape(-1) for column in (np.asarray(values, dtype=np.float64), *map(np.asarray, labels)))
    if len({column.size for column in flat}) > 1:
        raise ValueError(
            f"{flat[0].size} values in {[column.size for column in flat[1:]]} groups: name that of every value"
        )
    return flat
