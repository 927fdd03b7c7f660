"""Error rates of the tests by simulation: `python -m tests.models.observer.error_rates` prints all.

Participants differ in how they press and in how well they answer, with a correlation between both, and where
`own_slope` is not 0 in the slope of their answers with the force rate. Without an effect the mean slope is 0.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import stats

from fingerflow.engines.engine import Array
from fingerflow.models import observer

AMPLITUDES = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
ALPHA = 0.05


def answered(seed: int, people: int, trials: int = 14, slope: float = 0.0, own_slope: float = 0.3) -> dict[str, Any]:
    """Return trials whose logit of a correct answer rises by `slope` (SD `own_slope`) per 2 N/s of the rate."""
    draw = np.random.default_rng(seed)
    who = np.repeat(np.arange(people), trials * AMPLITUDES.size)
    amplitude = np.tile(np.repeat(AMPLITUDES, trials), people)
    skill = draw.standard_normal(people)
    speed = 0.7 * skill + 0.5**0.5 * draw.standard_normal(people)
    rate = 3.6 + 1.5 * speed[who] + 2 * draw.standard_normal(who.size)
    slopes = slope + own_slope * draw.standard_normal(people)
    logit = 0.2 + 0.9 * amplitude + 0.8 * skill[who] + slopes[who] * (rate - 3.6 - 1.5 * speed[who]) / 2
    answer = draw.random(who.size) < 1 / (1 + np.exp(-logit))
    return {"metric": rate, "answer": answer, "condition": amplitude, "participants": who}


def measured(
    seed: int, people: int, groups: int, effect: float = 0.0, trials: int = 2, gaps: int = 0
) -> dict[str, Any]:
    """Return trials of a metric that rises by `effect` over the groups; participants differ in level and response, and
    the first of them, `gaps`, lack one group each.
    """
    draw = np.random.default_rng(seed)
    who, group = (
        one.ravel() for one in np.meshgrid(np.arange(people), np.repeat(np.arange(groups), trials), indexing="ij")
    )
    place = group / (groups - 1) - 0.5
    level, response = 2 * draw.standard_normal(people), effect + draw.standard_normal(people)
    metric = level[who] + response[who] * place + draw.standard_normal(who.size)
    metric[(who < gaps) & (group == (seed + who) % groups)] = np.nan
    return {"values": metric, "groups": group, "participants": who}


def related(seed: int, people: int, own: float = 1.0, effect: float = 0.0) -> tuple[Array, Array, Array]:
    """Return 7 pairs of each participant, correlated by `effect` within and between participants (SD 1, `own`)."""
    draw = np.random.default_rng(seed)
    who = np.repeat(np.arange(people), 7)

    def pair(size: int) -> tuple[Array, Array]:
        first, other = draw.standard_normal((2, size))
        return first, effect * first + (1 - effect**2) ** 0.5 * other

    (between_x, between_y), (x, y) = pair(people), pair(who.size)
    return own * between_x[who] + x, own * between_y[who] + y, who


def counted(seed: int, guess: float | None, people: int = 8, trials: int = 14) -> tuple[dict[str, Any], float]:
    """Return blocks of answers at 7 amplitudes, and the stimulus that all participants together answer correctly in 75
    %.

    Thresholds are normal over participants, so the common curve has the combined width of both distributions. Without a
    guess rate of the design a tenth of the answers is yes at no stimulus.
    """
    draw = np.random.default_rng(seed)
    lowest = 0.1 if guess is None else guess
    height = 1 - lowest - 0.03
    middles = 1.3 + 0.4 * draw.standard_normal((people, 1))
    stimuli = np.linspace(0, 3, 7)
    answers = draw.binomial(trials, lowest + height * stats.norm.cdf((stimuli - middles) / 0.5))
    blocks = {
        "stimulus": np.tile(stimuli, people),
        "answers": answers.ravel(),
        "trials": np.full(answers.size, trials),
        "participants": np.repeat(np.arange(people), 7),
    }
    return blocks, 1.3 + float(np.hypot(0.4, 0.5) * stats.norm.ppf((0.75 - lowest) / height))


def compared(seed: int, people: int = 8, trials: int = 1) -> dict[str, Any]:
    """Return trials at 7 amplitudes: a metric (µm/mm) that rises with them, and whether an observer with a noise of 8
    answers that it is larger than in a reference press. Participants differ by a factor of it (SD 20 %), presses by
    another (SD 30 %): few answers are wrong, most of them at small amplitudes.
    """
    draw = np.random.default_rng(seed)
    levels = np.array([1.5, 3.0, 6.0, 12.0, 20.0, 25.0, 29.0])
    who = np.repeat(np.arange(people), trials * levels.size)
    factor = np.exp(0.2 * draw.standard_normal(people))[who]
    metric, reference = (
        level * factor * np.exp(0.3 * draw.standard_normal(who.size))
        for level in (np.tile(np.repeat(levels, trials), people), levels[0])
    )
    answer = metric - reference + 8 * draw.standard_normal(who.size) > 0
    return {"metric": metric, "answer": answer, "participants": who}


def classes(table: dict[str, Any]) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return the metric of right and of wrong answers in a table of `compared`, and the participants of both."""
    metric, answer, who = table["metric"], table["answer"], table["participants"]
    return metric[answer], metric[~answer], (who[answer], who[~answer])


def hold_the_truth(studies: int) -> dict[str, float]:
    """Return the share of intervals that hold the true d', area under the ROC, criterion and false alarms of studies of
    `compared`, one a seed. The truth is that of 560,000 trials.
    """
    right, wrong, _ = classes(compared(10**6, people=20_000, trials=4))
    truths = {
        "d'": (right.mean() - wrong.mean()) / np.sqrt((right.var() + wrong.var()) / 2),
        "area": np.searchsorted(np.sort(wrong), right).mean() / wrong.size,
        "criterion": np.quantile(right, 0.25),
    }
    held = dict.fromkeys((*truths, "false alarms"), 0)
    for seed in range(studies):
        correct, incorrect, who = classes(compared(seed))
        found = [
            observer.d_prime(correct, incorrect, who),
            observer.auc(correct, incorrect, who),
            observer.criterion_for_hits(correct, who[0]),
        ]
        found.append(observer.share_above(found[-1].value, incorrect, who[1]))
        expected = (*truths.values(), (wrong > found[2].value).mean())
        for name, truth, one in zip(held, expected, found, strict=True):
            held[name] += one.interval[0] <= truth <= one.interval[1]
    return {name: count / studies for name, count in held.items()}


def share(people: int, p_of: Callable[[int, int, float], float], effect: float, studies: int) -> float:
    """Return the share of studies, one per seed, whose p is below 0.05."""
    return float(np.mean([p_of(seed, people, effect) < ALPHA for seed in range(studies)]))


def regression(own_slope: float, seed: int, people: int, slope: float) -> float:
    return observer.clustered_regression(**answered(seed, people, slope=slope, own_slope=own_slope)).p


def anova(groups: int, lacking: float, seed: int, people: int, effect: float) -> float:
    return observer.repeated_anova(**measured(seed, people, groups, effect, gaps=int(lacking * people))).p


def one_way(groups: int, seed: int, people: int, effect: float) -> float:
    table = measured(seed, people, groups, effect)
    return observer.one_way_anova(table["values"], table["groups"]).p


def correlation(kind: Callable[..., Any], seed: int, people: int, effect: float) -> float:
    return float(kind(*related(seed, people, effect=effect)).p)


def of_pairs(kind: Callable[..., Any], seed: int, people: int, effect: float) -> float:
    return float(kind(*related(seed, people, effect=effect)[:2]).pvalue)


# Each test by seed, participants and effect, an effect that it finds in 16 participants, a smaller one, and where there
# is one the test that takes trials as independent.
P_OF = {
    "regression, equal slopes": (partial(regression, 0.0), 0.6, 0.25, None),
    "regression, slopes of their own": (partial(regression, 0.3), 0.6, 0.25, None),
    "ANOVA, 2 groups": (partial(anova, 2, 0.0), 2.0, 1.0, partial(one_way, 2)),
    "ANOVA, 7 groups": (partial(anova, 7, 0.0), 2.0, 1.0, partial(one_way, 7)),
    "ANOVA, 7 groups, 7 of 16 people lack one": (partial(anova, 7, 7 / 16), 2.0, 1.0, None),
    "Pearson": (partial(correlation, observer.pearson), 0.7, 0.5, partial(of_pairs, stats.pearsonr)),
    "Spearman": (partial(correlation, observer.spearman), 0.7, 0.5, partial(of_pairs, stats.spearmanr)),
}


def main(studies: int) -> None:
    """Print the share of studies with p < 0.05, and of intervals that hold the truth."""
    for name, (p_of, _, small, independent) in P_OF.items():
        for people in (4, 16):
            rows = (("no effect", p_of, 0.0), ("effect", p_of, small), ("trials as independent", independent, 0.0))
            shares = [f"{what} {share(people, of, effect, studies):.3f}" for what, of, effect in rows if of]
            print(f"{name}, {people} participants: {', '.join(shares)}", flush=True)
    held = hold_the_truth(studies)
    print(", ".join(f"{name} {part:.3f}" for name, part in held.items()), "of intervals of 8 participants hold")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
