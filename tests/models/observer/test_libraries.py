"""Each statistic beside that of statsmodels or SciPy on the same trials of 7 participants."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.formula.api import mixedlm, ols
from statsmodels.genmod.families import Binomial, links
from statsmodels.genmod.generalized_linear_model import GLM
from statsmodels.stats.anova import AnovaRM
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from fingerflow.models import observer
from fingerflow.study.statistics import holm

DRAW = np.random.default_rng(9)
WHO, GROUP = np.repeat(np.arange(7), 8), np.tile(np.repeat(np.arange(4), 2), 7)
X = DRAW.standard_normal(56) + 2 * DRAW.standard_normal(7)[WHO] + 0.4 * GROUP
Y = np.round(X + DRAW.standard_normal(56), 1)
ANSWER = np.median(Y) < Y
TABLE = pd.DataFrame({"x": X, "y": Y, "who": WHO, "group": GROUP, "answer": ANSWER.astype(float)})
GAPS = np.where((WHO < 3) & (GROUP == WHO), np.nan, X)
SPLIT = Y[ANSWER], Y[~ANSWER], (WHO[ANSWER], WHO[~ANSWER])


def random_effects() -> float:
    """F of Wald for the groups in a mixed model with an intercept of each participant, of the means of cells."""
    cells = TABLE.assign(x=GAPS).dropna().groupby(["who", "group"], as_index=False)["x"].mean()
    fit = mixedlm("x ~ C(group)", cells, groups="who").fit()
    effect, spread = fit.fe_params.to_numpy()[1:], fit.cov_params().to_numpy()[1:4, 1:4]
    return float(effect @ np.linalg.solve(spread, effect) / 3)


def psychometric() -> tuple[float, float]:
    """Threshold and width of a probit regression, for answers without lapses that go from 0 to 1."""
    fit = GLM(np.stack((YES, 400 - YES), 1), np.stack((np.ones(7), STIMULI), 1), Binomial(links.Probit())).fit()
    return (stats.norm.ppf(0.75) - fit.params[0]) / fit.params[1], 1 / fit.params[1]


STIMULI = np.linspace(-3, 3, 7)
YES = DRAW.binomial(400, stats.norm.cdf(STIMULI / 0.8))
FITTED = observer.fit_psychometric(STIMULI, YES, np.full(7, 400), np.arange(7))
ONE_WAY = observer.one_way_anova(X, GROUP)
FULL, WITH_GAPS = observer.repeated_anova(X, GROUP, WHO), observer.repeated_anova(GAPS, GROUP, WHO)
PAIR = observer.repeated_anova(X[GROUP < 2], GROUP[GROUP < 2], WHO[GROUP < 2])
RM = AnovaRM(TABLE, "x", "who", ["group"], aggregate_func="mean").fit().anova_table
MEANS = X.reshape(7, 4, 2).mean(2)
SLOPE = observer.clustered_regression(X, ANSWER, GROUP, WHO)
OLS = ols("answer ~ x + C(who):C(group)", TABLE).fit(cov_type="cluster", cov_kwds={"groups": WHO}, use_t=True)
# statsmodels takes the 28 intercepts for estimated numbers, which lie within the clusters here.
OLS_ERROR = OLS.bse["x"] * math.sqrt(OLS.df_resid / (56 - 1))
P = {"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.8, "e": 0.9}  # beside one that is unknown
CASES = {
    "one-way": ((ONE_WAY.f, ONE_WAY.p), tuple(stats.f_oneway(*(X[k == GROUP] for k in range(4))))),
    "repeated F": (FULL.f, RM["F Value"].iloc[0]),
    "repeated degrees": (FULL.degrees, (RM["Num DF"].iloc[0], RM["Den DF"].iloc[0])),
    "two groups": (PAIR.p, stats.ttest_rel(MEANS[:, 0], MEANS[:, 1]).pvalue),
    "area": (observer.auc(*SPLIT).value, stats.mannwhitneyu(*SPLIT[:2]).statistic / (SPLIT[0].size * SPLIT[1].size)),
    "criterion": (observer.criterion_for_hits(Y, WHO).value, np.quantile(Y, 0.25)),
    "false alarms": (observer.share_above(9, Y, WHO).interval, proportion_confint(0, 56, 0.05, "wilson")),
    "Holm": ([*holm(P | {"f": math.nan}).values()][:-1], multipletests(list(P.values()), method="holm")[1]),
    "repeated F with gaps": (WITH_GAPS.f, random_effects(), 0.03),
    "clustered slope": (SLOPE.value, OLS.params["x"]),
    "its error": ((SLOPE.interval[1] - SLOPE.value) / stats.t.ppf(0.975, 6), OLS_ERROR),
    "threshold": (FITTED.threshold, psychometric()[0], 0.02),
    "width": (FITTED.width, psychometric()[1], 0.04),
}


@pytest.mark.parametrize("name", CASES)
def test_a_statistic_is_that_of_a_library(name: str) -> None:
    ours, theirs, *tolerance = CASES[name]
    assert ours == pytest.approx(theirs, rel=sum(tolerance) or 1e-9, abs=1e-12)
