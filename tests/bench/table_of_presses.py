"""Simulated table of presses with the printed effects, in place of a measured study."""

from typing import Any

import numpy as np
import pandas as pd

from bench.papers.presses import PressStudy
from fingerflow.schema.trial_columns import DIFFERENCE, NUMBERS
from fingerflow.study.simulated_trials import Design
from fingerflow.study.statistics import read_sample, study_statistics
from fingerflow.study.table import differences

DESIGN = Design()
FORCES_N = (1.0, 2.0, 3.0)


def table() -> pd.DataFrame:
    """Return pairs of presses whose numbers are those printed; the answer follows the difference of divergence."""
    draw = np.random.default_rng(6)
    pairs = pd.MultiIndex.from_product(
        (range(DESIGN.participants), DESIGN.amplitudes, range(DESIGN.trials)), names=("who", "amplitude", "repeat")
    ).to_frame(index=False)
    rows = pairs.loc[pairs.index.repeat(2)].reset_index(drop=True)
    is_comparison = np.arange(len(rows)) % 2 == 1
    count = len(rows)
    amplitude = np.where(is_comparison, rows["amplitude"], 0.0)
    share = amplitude / 3
    frame = pd.DataFrame(dict.fromkeys(NUMBERS, np.nan), index=range(count))
    own = 1 + 0.05 * draw.standard_normal(DESIGN.participants)[rows["who"]]
    values: dict[str, Any] = {
        "participant": rows["who"].map("{:02d}".format), "trial": [f"{k:04d}" for k in range(count)],
        "condition": amplitude, "status": "measured", "max_force": np.clip(draw.normal(5.5, 2.0, count), 1.0, 18.0),
        "time_to_max_force": draw.normal(1.47, 0.39, count), "duration": draw.uniform(1.0, 2.5, count),
        "force_rate": draw.gamma(1.44, 2.5, count), "global_displacement": np.exp(draw.normal(-3.0, 0.97, count)),
        "gross_contact_area": 70.1 * own, "real_contact_area": 23.7 * own * draw.normal(1, 0.05, count),
        "force_angle": np.radians((9.9 - 5.7 * share) * draw.gamma(4.0, 0.25, count)),
        "divergence": 1e-3 * (4 + 9 * share + draw.normal(0, 1.0, count)),
        "strain_energy": draw.gamma(0.4, 0.8, count) + 0.15 * share,
        "strain_energy_rate": draw.gamma(4.0, 0.3, count), "strain_rate": draw.gamma(4.0, 0.01, count),
        "force_of_strain_rate": draw.normal(0.37, 0.05, count),
        "force_of_strain_energy_rate": draw.normal(0.4, 0.05, count),
    }  # fmt: skip
    values["strain"] = 0.40 * values["divergence"] - 0.00225 + draw.normal(0, 0.00105, count)
    values["curl"] = 0.2 * values["divergence"] + draw.normal(0, 0.0005, count)
    for force in FORCES_N:
        values[f"gross_contact_area_at_{force:g}n"] = 14 * own * force * draw.normal(1, 0.02, count)
        real = 6 * own * force * (1 - 0.38 * share) * draw.gamma(12, 1 / 12, count)
        values[f"real_contact_area_at_{force:g}n"] = real
    frame = frame.assign(**values)
    frame["reference"] = np.where(is_comparison, np.roll(frame["trial"], 1), "")
    found = differences(frame)
    felt = found[f"divergence{DIFFERENCE}"] + draw.normal(0, 2e-3, count)
    frame["answer"] = np.where(is_comparison, felt > 0, None)
    for name in ("force", "divergence", "real_contact_area", "gross_contact_area", "displacement"):
        measured = {"force": "max_force", "displacement": "global_displacement"}.get(name, name)
        frame[f"true_{name}"] = frame[measured]
    frame["true_softness"] = DESIGN.softness_of_people()[rows["who"]]
    return pd.concat((frame, pd.DataFrame(found)), axis=1)


def curves() -> pd.DataFrame:
    """Return curves of strain by amplitude, flat above 2 N."""
    force = np.linspace(0.25, 4, 16)
    strain = {"metric": "strain", "normal_force_N": force, "mean": 0.01 * np.minimum(force, 2.0)}
    return pd.concat(pd.DataFrame(strain | {"condition": amplitude}) for amplitude in DESIGN.amplitudes)


def study() -> PressStudy:
    """Return the study of this table, without recordings, models or traces."""
    frame = table()
    sample = read_sample(frame)
    statistics = study_statistics(sample, resamples=100)
    # The rows that are tested read neither files nor a trace.
    return PressStudy(None, frame, frame, curves(), sample, statistics, DESIGN, None)  # type: ignore[arg-type]
