"""The whole experiment of Willemet et al. 2021 from the skin chain: what a trial measures, by two analyses.

Every press of the experiment has the true numbers of its skin, and errors as large as those measured on the presses
that were rendered as pictures.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from bench.papers.chain import SimulatedPresses, energy_mj, script_curl, strain_percent
from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.manifest import REFERENCE
from fingerflow.study.row import CURVES, FORCE_GRID
from fingerflow.study.simulated_trials import Design, Presses, answer_table, simulate_skin
from fingerflow.study.table import averaged, differences
from fingerflow.study.trial_files import MEASURED

Values = NDArray[np.float64]
Skins = dict[float, SimulatedPresses]  # by softness, at the frictions of all amplitudes
PRINTED, OWN = "printed", "own"  # analyses: of the lab's script, and of this engine
_RATES = {"strain_rate": "strain", "strain_energy_rate": "strain_energy"}
_GRID_N = np.arange(0.0, 18.05, 0.1)  # N, forces of the curves: a rate is that of 0.2 N, in which contact grows evenly
_OF_SKIN = ("gross_contact_area", "divergence", "curl", "strain", "strain_energy")


def simulate_skins(design: Design) -> Skins:
    """Simulate a press to the largest force for each softness of the skin and the friction of each amplitude."""
    friction = tuple(design.friction_for(np.array((0.0, *design.amplitudes))))
    skins = {}
    for softness in design.softness:
        force, chain = simulate_skin(friction, softness, design.force_range[1])
        skins[softness] = SimulatedPresses(friction, chain.time[:, 0].numpy(), force, chain)
    return skins


class Experiment:
    """Presses of an experiment as one analysis would measure them.

    The printed analysis counts strain and energy since the first frame with contact force, and divergence since onset
    in the dilated contact; its curl takes the x displacement twice. The other counts all since each point's own onset.
    """

    def __init__(self, design: Design, presses: Presses, skins: Skins, analysis: str) -> None:
        self.presses, self._design = presses, design
        self._skins = [
            (soft, int(np.abs(np.subtract(skins[soft].friction, friction)).argmin()))
            for soft, friction in zip(presses.softness.tolist(), presses.friction, strict=True)
        ]
        self._curves = {softness: _curves_of(skin, analysis) for softness, skin in skins.items()}

    def against_force(self, metric: str, force: Values) -> Values:
        """Return a metric (N, G) of N presses at normal forces (G,) or (N, G), NaN where a press does not reach one."""
        presses, source = self.presses, {**_RATES, "real_contact_area": "gross_contact_area"}.get(metric, metric)
        force = np.broadcast_to(force, (len(presses.force), np.shape(force)[-1]))
        factor = np.ones(len(force))
        if metric in _RATES:
            factor = presses.force / presses.time_to_peak
        if metric == "real_contact_area":
            factor = presses.real_contact_area / presses.gross_contact_area
        values = np.empty(force.shape)
        for row, at, (softness, level), by in zip(values, force, self._skins, factor, strict=True):
            curve = self._curves[softness][source][:, level]
            row[:] = by * np.interp(at, _GRID_N, np.gradient(curve, _GRID_N) if metric in _RATES else curve)
        return np.where(force <= presses.force[:, None] * (1 + 1e-9), values, np.nan)

    def frame(self, errors: Mapping[str, float], seed: int) -> Any:
        """Return the table of presses, with the columns of a study's, and with normal errors of the given standard
        deviations.
        """
        import pandas as pd

        presses = self.presses
        count = len(presses.force)
        own = presses.participant[1:] != presses.participant[:-1]
        first = np.maximum.accumulate(np.concatenate(([0], np.where(own, np.arange(1, count), 0))))
        trial = np.arange(count) - first + 1
        compared = np.arange(count) % 2 == 1
        answers = np.repeat(answer_table(self._design, *presses.pairs()), 2).astype(object)
        answers[~compared] = None
        numbers = {
            "max_force": presses.force, "time_to_max_force": presses.time_to_peak, "duration": presses.duration,
            "force_rate": presses.force / presses.time_to_peak, "force_angle": presses.angle,
            "global_displacement": np.hypot(*presses.shift.T), "real_contact_area": presses.real_contact_area,
            **{name: self.against_force(name, presses.force[:, None])[:, 0] for name in _OF_SKIN},
        }  # fmt: skip
        rates = {name: self.against_force(name, _GRID_N) for name in _RATES}
        numbers |= {name: np.nanmax(values, axis=1) for name, values in rates.items()}
        for area in ("gross_contact_area", "real_contact_area"):
            for force in (1, 3):
                numbers[f"{area}_at_{force}n"] = self.against_force(area, np.array([float(force)]))[:, 0]
        draw = np.random.default_rng((seed, 2))
        measured = {name: column + errors.get(name, 0.0) * draw.standard_normal(count)
                    for name, column in numbers.items()}  # fmt: skip
        truth = {f"true_{name}": numbers[name] for name in ("divergence", "real_contact_area", "gross_contact_area")}
        truth |= {"true_force": presses.force, "true_displacement": numbers["global_displacement"]}
        frame = pd.DataFrame({
            "participant": [f"{one + 1:02d}" for one in presses.participant], "trial": [f"{k:03d}" for k in trial],
            "condition": presses.amplitude, "status": MEASURED,
            "answer": answers,
            REFERENCE: np.where(compared, [f"{k - 1:03d}" for k in trial], ""),
            **dict.fromkeys(NUMBERS, np.nan), **measured, **truth,
            **{f"force_of_{name}": _GRID_N[np.nanargmax(values, axis=1)] for name, values in rates.items()},
            "true_softness": presses.softness,
        })  # fmt: skip
        return pd.concat((frame, pd.DataFrame(differences(frame))), axis=1)

    def curves(self) -> Any:
        """Return the metrics averaged over participants, by condition and normal force, with the columns of
        `curves.csv`.
        """
        import pandas as pd

        people = [SimpleNamespace(participant=who, condition=f"{level:g}")
                  for who, level in zip(self.presses.participant, self.presses.amplitude, strict=True)]  # fmt: skip
        tables = []
        for names in (dict.fromkeys(CURVES), {source: rate for rate, source in _RATES.items()}):
            series = {name: self.against_force(other or name, FORCE_GRID) for name, other in names.items()}
            trials = [SimpleNamespace(status=MEASURED, curves={name: values[k] for name, values in series.items()})
                      for k in range(len(people))]  # fmt: skip
            rows: Any = list(zip(people, trials, strict=True))
            tables.append(pd.DataFrame(averaged(rows)).replace({"metric": {k: v for k, v in names.items() if v}}))
        return pd.concat(tables, ignore_index=True).astype({"condition": float})


def _curves_of(presses: SimulatedPresses, analysis: str) -> dict[str, Values]:
    """Return the metrics (G, K) of the skin at the forces `_GRID_N` by an analysis, in the units of a study's table."""
    spread, strained = (presses.dilated, presses.printed) if analysis == PRINTED else (presses.own, presses.own)
    divergence = np.nan_to_num(spread.area_median.numpy())
    curves = {
        "gross_contact_area": 1e6 * presses.own.contact_area.numpy(), "divergence": divergence,
        "curl": script_curl(spread) if analysis == PRINTED else 0 * divergence,
        "strain": strain_percent(strained) / 100, "strain_energy": energy_mj(strained),
    }  # fmt: skip
    return {name: make_interp_spline(presses.force, values, k=1)(_GRID_N) for name, values in curves.items()}


def measured_errors(measured: Any, truth: Any) -> Any:
    """Return the errors of measured against true numbers of the same presses: a DataFrame of the root of their mean
    square, `rms`, and of their mean, `bias`, a row for each number.
    """
    both = measured.merge(truth, on=["participant", "trial"], suffixes=("", "_truth"))
    names = [name for name in NUMBERS if f"{name}_truth" in both]
    off = both[names].astype(float) - both[[f"{name}_truth" for name in names]].to_numpy(float)
    return (off**2).mean().pow(0.5).to_frame("rms").assign(bias=off.mean()).dropna()
