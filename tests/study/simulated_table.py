"""A table of trials with known truth, without recordings, for the statistics alone.

Divergence is that of the skin chain at the friction of a condition and the softness of a participant, times a factor
per participant, plus variation from trial to trial.
"""

from functools import cache
from typing import Any

import numpy as np
import torch

from fingerflow.engines.engine import Array
from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import parameter_set

_LOAD_N = 3.0
_SPREAD = 0.003  # standard deviation of a trial's divergence around that of its participant and condition


_AMPLITUDES = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])  # µm of vibration, one per condition
_FRICTION = 0.9, 0.03  # coefficient without vibration and at the largest amplitude; between, it falls geometrically


@cache
def divergences(softness: float) -> Array:
    """Return the divergence (C,) by condition at 3 N of skin whose printed stiffnesses are divided by `softness`."""
    friction = torch.from_numpy(_FRICTION[0] * (_FRICTION[1] / _FRICTION[0]) ** (_AMPLITUDES / _AMPLITUDES.max()))
    return press(friction, parameter_set("paper").softer(softness), load_n=_LOAD_N, elements=101).divergence


def simulate_table(
    participants: int = 16, trials: int = 14, softness: tuple[float, float] = (1.0, 2.2), seed: int = 0
) -> dict[str, Any]:
    """Return a table of trials in the form of `write_tables`, without recordings, for the statistics alone.

    The observer answers "more slippery" where the divergence, felt with a noise of standard deviation 0.006, is above
    0.022. Divergence is that of the chain times a factor of the participant (SD 0.03). Strain and its energy follow it
    with added noise, so they predict the answer less well. Global displacement, force angle, areas, curl, rates and
    force are independent of it.

    Args:
        participants: the second half of them has softer skin.
        trials: of each participant in each condition.
        softness: of firmer and softer skin.
        seed: of all random numbers.
    """
    draw = np.random.default_rng(seed)
    levels = np.arange(participants), np.arange(_AMPLITUDES.size), np.arange(trials)
    who, condition, trial = map(np.ravel, np.meshgrid(*levels, indexing="ij"))
    count = who.size
    factor = 1 + 0.03 * draw.standard_normal(participants)
    mean = np.stack([*map(divergences, softness)])[(who >= participants // 2).astype(int), condition]
    divergence = mean * factor[who] + _SPREAD * draw.standard_normal(count)
    answer = divergence + 0.006 * draw.standard_normal(count) > 0.022
    force = draw.normal(5.5, 1.0, count).clip(1.0)
    return {
        "participant": np.array([f"{number + 1:02d}" for number in range(participants)])[who],
        "trial": condition * trials + trial + 1, "condition": _AMPLITUDES[condition], "answer": answer,
        "status": np.full(count, "measured"), "divergence": divergence,
        "strain": 0.5 * divergence + draw.normal(0, 2 * _SPREAD, count),
        "strain_rate": draw.normal(0.1, 0.03, count),
        "strain_energy": 0.5 * (divergence / 0.03) ** 2 + draw.normal(0, 0.3, count),
        "strain_energy_rate": draw.normal(1.0, 0.3, count), "curl": draw.normal(0, 0.002, count),
        "global_displacement": np.abs(draw.normal(0, 0.06, count)),
        "force_angle": np.abs(draw.normal(0.1, 0.05, count)), "max_force": force,
        "time_to_max_force": draw.normal(1.47, 0.39, count).clip(0.2),
        "duration": draw.normal(1.8, 0.3, count).clip(0.5), "force_rate": draw.normal(3.6, 1.5, count).clip(0.3),
        "max_displacement": draw.normal(0.25, 0.05, count).clip(0.01),
        "real_contact_area": draw.normal(45, 6, count) * np.cbrt(force / 5.5),
        "gross_contact_area": draw.normal(90, 10, count) * np.cbrt(force / 5.5),
    }  # fmt: skip
