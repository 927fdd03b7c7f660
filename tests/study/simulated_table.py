"""A table of trials with known truth, without recordings, for the statistics alone.

Divergence is that of the skin chain at the friction of a condition and the softness of a participant, times a factor
per participant, plus variation from trial to trial.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import parameter_set

Values = NDArray[np.float64]
_LOAD_N = 3.0


_AMPLITUDES = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])  # µm of vibration, one per condition
_FRICTION = 0.9, 0.03  # coefficient without vibration and at the largest amplitude; between, it falls geometrically


@cache
def divergences(softness: float) -> Values:
    """Return the divergence (C,) by condition at 3 N of skin whose printed stiffnesses are divided by `softness`."""
    friction = torch.from_numpy(_FRICTION[0] * (_FRICTION[1] / _FRICTION[0]) ** (_AMPLITUDES / _AMPLITUDES.max()))
    return np.asarray(press(friction, parameter_set("paper").softer(softness), load_n=_LOAD_N, elements=101).divergence)


@dataclass(frozen=True)
class TableDesign:
    """Design of a study whose observer answers "more slippery" to one stimulus, and how divergence varies.

    Attributes:
        participants: the second half of them has softer skin.
        trials: of each participant in each condition.
        softness: of firmer and softer skin.
        criterion: divergence above which the observer answers "more slippery".
        noise: standard deviation of the perceived divergence.
        seed: of all random numbers.
        own: standard deviation of a participant's factor.
        spread: standard deviation of a trial's divergence around that of its participant and condition.
    """

    participants: int = 16
    trials: int = 14
    softness: tuple[float, float] = (1.0, 2.2)
    criterion: float = 0.022
    noise: float = 0.006
    own: float = 0.03
    spread: float = 0.003
    seed: int = 0

    def is_soft(self) -> NDArray[np.bool_]:
        """Return a mask (P,) of the participants with softer skin."""
        return np.arange(self.participants) >= self.participants // 2


def simulate_table(design: TableDesign) -> dict[str, Any]:
    """Return a table of trials in the form of `write_tables`, without recordings, for the statistics alone.

    Strain and its energy follow the divergence with added noise, so they predict the answer less well. Global
    displacement, force angle, areas, curl, rates and force are independent of the divergence.
    """
    draw = np.random.default_rng(design.seed)
    who, condition, trial = (
        one.ravel()
        for one in np.meshgrid(
            np.arange(design.participants), np.arange(_AMPLITUDES.size), np.arange(design.trials), indexing="ij"
        )
    )
    count = who.size
    factor = 1 + design.own * draw.standard_normal(design.participants)
    mean = np.stack([*map(divergences, design.softness)])[design.is_soft().astype(int)[who], condition]
    divergence = mean * factor[who] + design.spread * draw.standard_normal(count)
    answer = divergence + design.noise * draw.standard_normal(count) > design.criterion
    force = draw.normal(5.5, 1.0, count).clip(1.0)
    return {
        "participant": np.array([f"{number + 1:02d}" for number in range(design.participants)])[who],
        "trial": condition * design.trials + trial + 1,
        "condition": _AMPLITUDES[condition],
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
