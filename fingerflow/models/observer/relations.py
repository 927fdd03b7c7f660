"""Correlation, one-way analysis of variance and linear mixed model between columns of a table of trials."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from fingerflow.errors import FingerflowError
from fingerflow.models.observer.estimate import UNKNOWN, Interval

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Correlation:
    """Correlation coefficient with interval and two-sided p; `trials` pairs were used, `missing` pairs lack a value."""

    value: float
    interval: Interval
    p: float
    level: float
    trials: int
    missing: int
    reason: str = ""


@dataclass(frozen=True)
class Anova:
    """One-way ANOVA: F with degrees of freedom, p, and eta^2, the variance share between groups; `trials` per group."""

    f: float
    degrees: tuple[int, int]
    p: float
    eta_squared: float
    trials: dict[str, int]
    missing: int
    reason: str = ""


@dataclass(frozen=True)
class MixedModel:
    """Fitted mixed model: fixed effects with intervals and p (Wald), deviations between and within participants."""

    effects: dict[str, float]
    intervals: dict[str, Interval]
    p: dict[str, float]
    between: float
    within: float
    level: float
    trials: int
    participants: int
    missing: int
    converged: bool


def pearson(first: ArrayLike, second: ArrayLike, level: float = 0.95) -> Correlation:
    """Compute the linear correlation of pairs, with an interval by Fisher's transformation for independent pairs.

    The result is NaN, with the reason, for fewer than 4 pairs or a constant. Raises ValueError if the lengths differ or
    the level is not between 0 and 1.
    """
    return _correlation(first, second, level, stats.pearsonr, 1.0)


def spearman(first: ArrayLike, second: ArrayLike, level: float = 0.95) -> Correlation:
    """Compute Spearman's rank correlation of pairs; ties have mean ranks.

    The interval is Fisher's, with the variance of ranks (1 + r^2 / 2) / (n - 3) (Bonett & Wright 2000). Otherwise as
    `pearson`.
    """
    return _correlation(first, second, level, stats.spearmanr, math.nan)


def one_way_anova(values: ArrayLike, groups: ArrayLike) -> Anova:
    """Test whether groups of trials differ in the mean of a variable. NaN values are left out and counted.

    The result is NaN, with the reason, for fewer than two groups of two trials, or no variation within any group.

    Raises:
        ValueError: values and groups differ in length.
    """
    numbers, names = np.asarray(values, dtype=np.float64).reshape(-1), np.asarray(groups).reshape(-1)
    if numbers.size != names.size:
        raise ValueError(f"{numbers.size} values in {names.size} groups: name the group of every value")
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


def mixed_model(table: Mapping[str, ArrayLike], formula: str, level: float = 0.95) -> MixedModel:
    """Fit a linear mixed model with one intercept per participant, as for the force rate in Willemet et al. 2021.

    The fit is by restricted maximum likelihood (statsmodels, installed with the extra `study`).

    Args:
        table: columns, `participant` among them; rows with a NaN in a column of the formula are left out and counted.
        formula: of the fixed effects, as "force_rate ~ amplitude".
        level: of the intervals.

    Raises:
        FingerflowError: statsmodels is not installed, there is no column `participant`, or fewer than two participants.
    """
    try:
        import pandas as pd
        from statsmodels.formula.api import mixedlm
    except ImportError as error:
        message = f"a mixed model needs statsmodels ({error}): pip install 'fingerflow-engine[study]'"
        raise FingerflowError(message) from error
    frame = pd.DataFrame({name: np.asarray(table[name]) for name in table.keys()})  # noqa: SIM118 - as in read_trials
    if "participant" not in frame:
        raise FingerflowError(f"the table has no column participant: it has {', '.join(map(str, frame.columns))}")
    words = re.findall(r"\w+", formula)  # a column of another name may be a part of one of these
    used = [name for name in frame.columns if name == "participant" or str(name) in words]
    whole = frame[used].dropna()
    participants = whole["participant"].nunique()
    if participants < 2:
        raise FingerflowError(f"{participants} participants with whole rows: a mixed model needs two or more")
    found = mixedlm(formula, whole, groups=whole["participant"]).fit(reml=True)
    names = list(found.fe_params.index)
    limits = found.conf_int(1 - level)
    return MixedModel(
        effects={name: float(found.fe_params[name]) for name in names},
        intervals={name: (float(limits.loc[name, 0]), float(limits.loc[name, 1])) for name in names},
        p={name: float(found.pvalues[name]) for name in names},
        between=math.sqrt(max(float(found.cov_re.iloc[0, 0]), 0.0)),
        within=math.sqrt(float(found.scale)),
        level=level,
        trials=len(whole),
        participants=int(participants),
        missing=len(frame) - len(whole),
        converged=bool(found.converged),
    )


def _correlation(first: ArrayLike, second: ArrayLike, level: float, kind: object, variance: float) -> Correlation:
    x, y = (np.asarray(values, dtype=np.float64).reshape(-1) for values in (first, second))
    if x.size != y.size:
        raise ValueError(f"{x.size} and {y.size} values: give pairs")
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    both = np.isfinite(x) & np.isfinite(y)
    pairs, missing = int(both.sum()), int((~both).sum())
    if pairs < 4 or min(np.ptp(x[both]), np.ptp(y[both])) == 0:
        reason = f"{pairs} pairs: 4 are needed" if pairs < 4 else "one of the two is constant"
        return Correlation(math.nan, UNKNOWN, math.nan, level, pairs, missing, reason)
    assert callable(kind)
    found = kind(x[both], y[both])
    value = float(found.statistic)
    spread = math.sqrt((1 + value**2 / 2 if math.isnan(variance) else variance) / (pairs - 3))
    reach = float(stats.norm.ppf((1 + level) / 2)) * spread
    middle = math.atanh(max(min(value, 1 - 1e-15), -1 + 1e-15))
    interval = math.tanh(middle - reach), math.tanh(middle + reach)
    return Correlation(value, interval, float(found.pvalue), level, pairs, missing)
