"""Simulated experiment of Willemet et al. 2021: recordings of a study of presses, its results and statistics."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from bench.papers.chain import HIGH, SimulatedPresses, simulate_presses
from bench.papers.receptors import Depth, compute_strains_at_depth
from bench.papers.tribometer import TribometerTrace, simulate_trace
from fingerflow.errors import FingerflowError
from fingerflow.results.result import load_result
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import VARIABLES
from fingerflow.study.init import init_study
from fingerflow.study.manifest import Manifest, TrialEntry, load_manifest
from fingerflow.study.run_study import run_study
from fingerflow.study.simulated import write_recordings
from fingerflow.study.simulated_trials import Design
from fingerflow.study.statistics import Sample, read_sample, study_statistics
from fingerflow.study.table import write_tables
from fingerflow.study.trial_files import MEASURED, read_row
from fingerflow.synthetic import SyntheticScene, rebuild_scene

Values = NDArray[np.float64]
_TRUTHS = 8  # number of trials whose deformation is compared with the truth
_MARGIN = 13  # number of times left out at either end of the rates of the chain
_LEAST_N = 3.0  # N, least peak force of presses that figures show
_PEAKS = 200  # largest number of trials whose rates are followed in time
_BIN_N, _FEWEST_PRESSES = 0.5, 3  # N, width of the force bins for mean rates; least number of presses in a bin

DIVERGENCE_UNIT = VARIABLES["median_divergence"].shown_unit.name
_FULL = Design(participants=16, trials=2)
_QUICK = Design(participants=4, trials=1)
_RESAMPLES = {False: 2000, True: 400}


@dataclass(frozen=True)
class TypicalPress:
    """Press that is shown in figures: its result, and the scene of its recording."""

    result: xr.Dataset
    scene: Scene

    @cached_property
    def peak(self) -> int:
        """Return the index of the frame with the largest normal force."""
        return int(np.nanargmax(self.result["normal_force"]))

    @property
    def largest_force(self) -> float:
        """Return the largest normal force, N."""
        return float(self.result["normal_force"][self.peak])

    def frame_at(self, force: float) -> int | None:
        """Return the first frame in which the normal force reaches a value (N); None if it never does."""
        reached = np.flatnonzero(np.nan_to_num(self.result["normal_force"]) >= force)
        return int(reached[0]) if reached.size else None


@dataclass(frozen=True)
class PressStudy:
    """Simulated study after processing: its trials, metrics, curves and statistics, and the settings of the simulation.

    Attributes:
        frame, curves: DataFrames, as in `trials.parquet` and `curves.csv`.
        statistics: as in `statistics.json`.
        design: of the simulation.
        trace: simulated tribometer trace.
    """

    manifest: Manifest
    frame: Any
    curves: Any
    sample: Sample
    statistics: dict[str, Any]
    design: Design
    trace: TribometerTrace

    @cached_property
    def chain(self) -> SimulatedPresses:
        """Simulate the presses of the skin chain at several frictions."""
        return simulate_presses()

    @cached_property
    def depth(self) -> Depth:
        """Compute stress and strain below the skin surface in the simulated presses."""
        return compute_strains_at_depth(self.chain)

    @cached_property
    def scene(self) -> Scene:
        """Return the scene of the first press; those of the others differ from it in file names only."""
        return self.manifest.build_scene(self.manifest.trials[0])

    def result_of(self, entry: TrialEntry) -> xr.Dataset | None:
        """Return the result of a press; None if it was not measured."""
        folder = self.manifest.results / entry.name
        stored = read_row(folder)
        return None if stored is None or stored.result is None else load_result(folder / stored.result)

    def truth_of(self, entry: TrialEntry) -> SyntheticScene:
        """Return the synthetic scene of a press, which has its true motion."""
        return rebuild_scene(self.manifest.build_scene(entry).recording.frames.parent)

    @cached_property
    def measured(self) -> Any:
        """Return the table rows (a DataFrame) of all presses that were measured."""
        return self.frame[self.frame["status"] == MEASURED]

    def values(self, metric: str) -> Values:
        """Return a metric of each measured press, in the unit of the table."""
        return np.asarray(self.measured[metric].to_numpy(float))

    def column_of_sample(self, column: str) -> Values:
        """Return a column of the table for the trials in `sample`, in their order."""
        trials = self.sample.trials
        own = self.frame.set_index(["participant", "trial", "condition"])
        places = list(zip(trials.participant, trials.trial, trials.condition, strict=True))
        return np.asarray(own.loc[places, column].to_numpy(float))

    @cached_property
    def rates(self) -> Any:
        """Return a DataFrame with the rates of strain and of strain energy in each frame of a press while the normal
        force rises, and the force there.

        Columns: metric, condition, press, participant, normal_force_N and rate, of 200 presses at most. Metrics are
        `strain_rate`, the mean of both directions, and `strain_energy_rate`.
        """
        import pandas as pd

        parts = []
        for entry, result in self.evenly_spaced(_PEAKS):
            force = np.asarray(result["normal_force"], dtype=float)
            strain = np.asarray(result["median_strain_rate"], dtype=float)[:, :2].mean(1)
            energy = np.asarray(result["strain_energy_rate"], dtype=float)
            rising = np.isfinite(force) & (np.arange(force.size) <= np.nanargmax(force))
            for metric, rate in (("strain_rate", strain), ("strain_energy_rate", energy)):
                known = rising & np.isfinite(rate)
                columns = {"metric": metric, "condition": float(entry.condition)}
                columns |= {"press": entry.name, "participant": entry.participant}
                parts.append(pd.DataFrame({"normal_force_N": force[known], "rate": rate[known], **columns}))
        return pd.concat(parts, ignore_index=True)

    @cached_property
    def rate_curves(self) -> Any:
        """Return a DataFrame of the rates of strain and of strain energy averaged over participants, by condition and
        by normal force in steps of 0.5 N.

        Participants are the units of the intervals of 95 %, as in `curves`.
        """
        rates = self.rates
        bins = (rates["normal_force_N"] / _BIN_N).round() * _BIN_N
        own = rates.groupby(["metric", "condition", bins, "participant"]).agg(
            rate=("rate", "mean"), trials=("press", "nunique")
        )
        of_bins = own.groupby(["metric", "condition", "normal_force_N"])
        found = of_bins.agg(
            mean=("rate", "mean"), spread=("rate", "std"), participants=("rate", "size"), trials=("trials", "sum")
        )
        found = found[found["trials"] >= _FEWEST_PRESSES].reset_index()
        reach = stats.t.ppf(0.975, found["participants"] - 1) * found["spread"] / np.sqrt(found["participants"])
        return found.assign(low=found["mean"] - reach, high=found["mean"] + reach)

    @cached_property
    def forces_of_peaks(self) -> dict[str, dict[float, float]]:
        """Return the normal force (N) at which each rate in `rates` is largest, as the median over presses, by metric
        and vibration amplitude (µm).
        """
        own = self.rates
        peaks = own.loc[own.groupby(["metric", "press"])["rate"].idxmax()]
        median = peaks.groupby(["metric", "condition"])["normal_force_N"].median()
        return {metric: median[metric].to_dict() for metric in ("strain_rate", "strain_energy_rate")}

    @cached_property
    def errors(self) -> tuple[Values, Values]:
        """Return the errors, measured minus true, of the median displacement (T, 2) mm and the median divergence (T,)
        over the contact at the largest force of T presses.

        An error is the measured value minus the simulated truth. T is at most 8; divergence has no unit.
        """
        moved, spread = [], []
        for entry, result in self.evenly_spaced(_TRUTHS):
            frame = int(np.nanargmax(result["normal_force"]))
            truth = self.truth_of(entry).truth.medians(frame)
            displacement = np.asarray(result["displacement"][frame])[np.asarray(result["in_contact"][frame]) > 0]
            moved.append(np.nanmedian(displacement, axis=0) - np.array((truth.displacement_x, truth.displacement_y)))
            spread.append(float(result["median_divergence"][frame]) - truth.divergence)
        both = np.array(moved), np.array(spread)
        known = np.isfinite(both[0]).all(1) & np.isfinite(both[1])
        return both[0][known], both[1][known]

    @cached_property
    def chain_strain(self) -> tuple[Values, Values]:
        """Return, at high friction, the median radial strain (3,) % of the skin-chain model at 1, 2 and 3 N relative to
        the undeformed finger, and the forces (2,) N at which strain and strain energy change fastest.
        """
        chain, k = self.chain, self.chain.friction.index(HIGH)
        strain, inner = 100 * np.median(chain.profile()[1], axis=-1), slice(_MARGIN, -_MARGIN)
        fastest = [chain.rate(np.nan_to_num(series))[inner, k].argmax() for series in (strain, chain.energy())]
        return np.interp((1.0, 2.0, 3.0), chain.force, strain[:, k]), chain.force[inner][fastest]

    @cached_property
    def typical(self) -> "tuple[TypicalPress, TypicalPress]":
        """Return two presses of one participant with similar largest forces (3 N or more): at high and at low friction.

        Without vibration friction is high, at the largest amplitude low.

        Raises FingerflowError if no participant has both.
        """
        frame = self.measured[self.measured["max_force"] >= _LEAST_N]
        still, vibrating = (
            frame[frame["condition"] == one] for one in (min(self.design.amplitudes), max(self.design.amplitudes))
        )
        pairs = still.merge(vibrating, on="participant", suffixes=("", "_vibrating"))
        if pairs.empty:
            raise FingerflowError("no participant has presses of 3 N or more at both ends of the amplitudes")
        best = pairs.loc[(pairs["max_force"] - pairs["max_force_vibrating"]).abs().idxmin()]
        high, low = (self._typical(best["participant"], best[trial]) for trial in ("trial", "trial_vibrating"))
        return high, low

    def _typical(self, participant: str, trial: str) -> "TypicalPress":
        entry = next(one for one in self.manifest.trials if (one.participant, one.trial) == (participant, trial))
        result = self.result_of(entry)
        assert result is not None
        return TypicalPress(result, self.manifest.build_scene(entry))

    def evenly_spaced(self, most: int) -> Iterator[tuple[TrialEntry, xr.Dataset]]:
        """Yield at most `most` presses, evenly spaced in the list of all, with their results."""
        step = max(1, len(self.manifest.trials) // most)
        for entry in self.manifest.trials[::step][:most]:
            if (result := self.result_of(entry)) is not None:
                yield entry, result


def record_and_analyse(folder: Path, quick: bool = False) -> PressStudy:
    """Simulate the recordings, process them as a study, and compute its statistics; existing files are kept.

    Raises FingerflowError if the folder holds a study of another design, or a file cannot be written.
    """
    import pandas as pd

    recordings, design = folder / "recordings", _QUICK if quick else _FULL
    known = recordings / "truth.json"
    if known.exists() and json.loads(known.read_text(encoding="utf-8")) != json.loads(json.dumps(asdict(design))):
        raise FingerflowError(f"{known} is of another design: name another folder, or remove {folder}")
    if not (recordings / "study.toml").exists():  # the study file is written after all recordings
        write_recordings(recordings, design)
        init_study(recordings, recordings / "answers.csv")
    manifest = load_manifest(recordings)
    run_study(manifest)
    trials_path, curves_path = write_tables(manifest)
    frame, curves = pd.read_parquet(trials_path), pd.read_csv(curves_path)
    for column in [name for name in frame if name.startswith("true_")]:
        frame[column] = frame[column].astype(float)
    sample = read_sample(frame)
    trace = simulate_trace(design.friction_for, max(design.amplitudes))
    return PressStudy(
        manifest=manifest,
        frame=frame,
        curves=curves,
        sample=sample,
        statistics=study_statistics(sample, _RESAMPLES[quick]),
        design=design,
        trace=trace,
    )
