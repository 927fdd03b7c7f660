"""A simulated study with known truth: skin of two stiffnesses, friction by condition, observer of known sensitivity.

Divergence is that of the skin chain (Willemet et al. 2021) at the friction of a condition and the softness of a
participant, times a factor per participant, plus variation from trial to trial. The observer perceives it with
noise and answers "more slippery" if it exceeds a criterion. The true values of the statistics therefore follow
by integration: `truth_of`.
"""

import csv
import io
import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import norm

from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import named
from fingerflow.results.atomic_write import write_atomically
from fingerflow.synthetic import Camera, ChainPress, write_recording

Values = NDArray[np.float64]
_LOAD_N = 3.0
_RECORDED_N = 2.0  # force in recordings, at which a contact of softer skin fits in the views
_POINTS = 4001  # of the integrals, over eight deviations beyond the means
_FRAMES, _FRAME_SHAPE, _FINGER = 40, (224, 560), (3.6, 3.4)


@dataclass(frozen=True)
class Design:
    """Design of a simulated study.

    Attributes:
        participants: the second half of them has softer skin.
        trials: of each participant in each condition.
        amplitudes: µm of vibration, one per condition.
        friction: coefficient without vibration, and at the largest amplitude; between them it falls geometrically.
        softness: of the softer skin: divisor of the chain's stiffnesses.
        own: standard deviation of a participant's factor.
        spread: standard deviation of a trial's divergence around that of its participant and condition.
        criterion: divergence above which the observer answers "more slippery".
        noise: standard deviation of the perceived divergence.
        seed: of all random numbers.
    """

    participants: int = 16
    trials: int = 14
    amplitudes: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    friction: tuple[float, float] = (0.9, 0.03)
    softness: float = 2.2
    own: float = 0.03
    spread: float = 0.003
    criterion: float = 0.022
    noise: float = 0.006
    seed: int = 0

    @cached_property
    def frictions(self) -> Values:
        """Return the friction coefficients (C,) of the conditions."""
        low, high = self.friction
        amplitudes = np.asarray(self.amplitudes)
        result: Values = low * (high / low) ** (amplitudes / max(amplitudes.max(), 1e-9))
        return result

    @cached_property
    def divergences(self) -> Values:
        """Return the divergence (2, C) of firmer and softer skin by condition, at 3 N."""
        friction = torch.from_numpy(self.frictions)
        found = [press(friction, named("paper").softer(soft), load_n=_LOAD_N).divergence for soft in (1, self.softness)]
        result: Values = torch.stack(found).numpy()
        return result

    def is_soft(self) -> NDArray[np.bool_]:
        """Return True for participants (P,) with softer skin."""
        return np.arange(self.participants) >= self.participants // 2


@dataclass(frozen=True)
class ObserverTruth:
    """True statistics of the whole population, as `fingerflow.models.observer` defines them."""

    d_prime: float
    auc: float
    criterion: float
    share_correct: float


def truth_of(design: Design, hits: float = 0.75) -> ObserverTruth:
    """Compute the true statistics by integration.

    f(x) is the density of the divergence over all trials, a mixture of Gaussians, and h(x) = Phi((x - criterion) /
    noise) the probability of the answer. Correct trials have the density f h / P and incorrect ones f (1 - h) / (1 -
    P), P the integral of f h.
    """
    means = design.divergences.ravel()
    deviations = np.hypot(design.own * means, design.spread)
    soft = design.is_soft().mean()
    weights = np.repeat([1 - soft, soft], len(design.amplitudes)) / len(design.amplitudes)
    reach = 8 * deviations.max()
    x = np.linspace(means.min() - reach, means.max() + reach, _POINTS)
    density = (weights[:, None] * norm.pdf(x, means[:, None], deviations[:, None])).sum(0)
    answers = norm.cdf((x - design.criterion) / design.noise)
    share = float(np.trapezoid(density * answers, x))
    correct, incorrect = density * answers / share, density * (1 - answers) / (1 - share)
    (mean_1, variance_1), (mean_0, variance_0) = (_moments(x, one) for one in (correct, incorrect))
    step = x[1] - x[0]
    below_1, below_0 = (np.cumsum((one[1:] + one[:-1]) / 2) * step for one in (correct, incorrect))
    return ObserverTruth(
        d_prime=(mean_1 - mean_0) / np.sqrt((variance_1 + variance_0) / 2),
        auc=float(np.trapezoid(correct[1:] * below_0, x[1:])),
        criterion=float(np.interp(1 - hits, below_1, x[1:])),
        share_correct=share,
    )


def simulate_table(design: Design) -> dict[str, Any]:
    """Return a table of trials in the form of `write_tables`, without recordings, for the statistics alone.

    Strain and its energy follow the divergence with added noise, so they predict the answer less well. Global
    displacement, force angle, areas, curl, rates and force are independent of it.
    """
    draw = np.random.default_rng(design.seed)
    who, condition, trial = (
        one.ravel()
        for one in np.meshgrid(
            np.arange(design.participants), np.arange(len(design.amplitudes)), np.arange(design.trials), indexing="ij"
        )
    )
    count = who.size
    factor = 1 + design.own * draw.standard_normal(design.participants)
    mean = design.divergences[design.is_soft().astype(int)[who], condition]
    divergence = mean * factor[who] + design.spread * draw.standard_normal(count)
    answer = _answers(design, divergence, draw)
    force = draw.normal(5.5, 1.0, count).clip(1.0)
    return {
        "participant": np.array([f"{number + 1:02d}" for number in range(design.participants)])[who],
        "trial": condition * design.trials + trial + 1,
        "condition": np.asarray(design.amplitudes)[condition],
        "answer": answer,
        "status": np.full(count, "measured"),
        "divergence": divergence,
        "strain": 0.5 * divergence + draw.normal(0, 2 * design.spread, count),
        "strain_rate": draw.normal(0.1, 0.03, count),
        "strain_energy": 0.5 * (divergence / 0.03) ** 2 + draw.normal(0, 0.3, count),
        "strain_energy_rate": draw.normal(1.0, 0.3, count),
        "curl": draw.normal(0, 0.002, count),
        "global_displacement": np.abs(draw.normal(0, 0.06, count)),
        "force_angle": np.abs(draw.normal(0.1, 0.05, count)),
        "max_force": force,
        "time_to_max_force": draw.normal(1.47, 0.39, count).clip(0.2),
        "duration": draw.normal(1.8, 0.3, count).clip(0.5),
        "force_rate": draw.normal(3.6, 1.5, count).clip(0.3),
        "max_displacement": draw.normal(0.25, 0.05, count).clip(0.01),
        "real_contact_area": draw.normal(45, 6, count) * np.cbrt(force / 5.5),
        "gross_contact_area": draw.normal(90, 10, count) * np.cbrt(force / 5.5),
    }


def write_recordings(folder: Path, design: Design) -> None:
    """Write one `ChainPress` recording per trial with its scene, `answers.csv` and `truth.json`, into a new folder.

    A trial's divergence varies through its force, 2 N with a standard deviation of a tenth. The observer perceives the
    chain's divergence at this force.

    Raises FingerflowError if a recording cannot be written.
    """
    draw = np.random.default_rng(design.seed)
    rows = []
    for number in range(design.participants):
        softness = design.softness if design.is_soft()[number] else 1.0
        for place, (amplitude, friction) in enumerate(zip(design.amplitudes, design.frictions, strict=True)):
            for repeat in range(design.trials):
                trial = place * design.trials + repeat + 1
                load = _RECORDED_N * min(max(1 + 0.1 * draw.standard_normal(), 0.7), 1.2)
                recorded = ChainPress(
                    friction=float(friction), softness=softness, force=load, n_frames=_FRAMES, frame_rate=_FRAMES,
                    frames_before_trigger=2, frame_shape=_FRAME_SHAPE, finger=_FINGER, elements=501,
                    camera=Camera(seed=int(draw.integers(1 << 30))),
                )  # fmt: skip
                felt = float(press(float(friction), named("paper").softer(softness), load_n=load).divergence)
                name = f"p{number + 1:02d}/{amplitude:g}um/trial{trial:03d}"
                write_recording(folder / name, recorded)
                answer = bool(_answers(design, np.array([felt]), draw)[0])
                rows.append((f"{number + 1:02d}", f"{trial:03d}", int(answer), f"{friction:.4g}", f"{softness:g}"))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("participant", "trial", "answer", "true_friction", "true_softness"))
    writer.writerows(rows)
    write_atomically(folder / "answers.csv", lambda part: part.write_text(text.getvalue(), encoding="utf-8"))
    write_atomically(folder / "truth.json", lambda part: part.write_text(json.dumps(asdict(design)), encoding="utf-8"))


def _answers(design: Design, divergence: Values, draw: np.random.Generator) -> NDArray[np.bool_]:
    felt = divergence + design.noise * draw.standard_normal(divergence.size)
    return np.asarray(felt > design.criterion)


def _moments(x: Values, density: Values) -> tuple[float, float]:
    mean = float(np.trapezoid(density * x, x))
    return mean, float(np.trapezoid(density * (x - mean) ** 2, x))
