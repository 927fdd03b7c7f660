"""Simulated experiment of Willemet et al. 2021: recordings of a study of presses, its results and statistics."""

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bench.papers.chain import SimulatedPresses, simulate_presses
from bench.papers.experiment import OWN, PRINTED, Experiment, measured_errors, simulate_skins
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
from fingerflow.study.simulated_trials import Design, draw_presses
from fingerflow.study.statistics import Sample, read_sample, study_statistics
from fingerflow.study.table import write_tables
from fingerflow.study.trial_files import MEASURED, read_row
from fingerflow.synthetic import SyntheticScene, rebuild_scene

Values = NDArray[np.float64]
_LEAST_N = 3.0  # N, least peak force of presses that figures show

DIVERGENCE_UNIT = VARIABLES["median_divergence"].shown_unit.name
_FULL = Design(trials=1)
_QUICK = Design(participants=6, trials=1, amplitudes=(1.0, 3.0))
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
    """Simulated experiment by an analysis: its trials, metrics, curves and statistics, the settings of the simulation,
    and the study of those presses that were rendered and measured.

    Attributes:
        pictured: rows of the table of the presses that were rendered and measured.
        frame, curves: of all presses, DataFrames as in `trials.parquet` and `curves.csv`.
        statistics: as in `statistics.json`.
        design: of the simulation.
        trace: simulated tribometer trace.
        errors: of the analysis on the rendered presses, as of `measured_errors`.
        own: the same experiment by the analysis of this engine, where this is by the printed one.
    """

    manifest: Manifest
    pictured: Any
    frame: Any
    curves: Any
    sample: Sample
    statistics: dict[str, Any]
    design: Design
    trace: TribometerTrace
    errors: Any = None
    own: "PressStudy | None" = None

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

    def truth_of(self, entry: TrialEntry) -> SyntheticScene:
        """Return the synthetic scene of a press, which has its true motion."""
        return rebuild_scene(self.manifest.build_scene(entry).recording.frames.parent)

    @cached_property
    def measured(self) -> Any:
        """Return the table rows (a DataFrame) of all presses that were measured."""
        return self.frame[self.frame["status"] == MEASURED]

    def values(self, metric: str) -> Values:
        """Return a metric of each measured press, in the unit of the table."""
        return self.measured[metric].to_numpy(float)

    def column_of_sample(self, column: str) -> Values:
        """Return a column of the table for the trials in `sample`, in their order."""
        trials = self.sample.trials
        own = self.frame.set_index(["participant", "trial", "condition"])
        places = list(zip(trials.participant, trials.trial, trials.condition, strict=True))
        return np.asarray(own.loc[places, column].to_numpy(float))

    @cached_property
    def typical(self) -> "tuple[TypicalPress, TypicalPress]":
        """Return two presses of one participant at high and at low friction, with similar largest forces (3 N or more)
        and real contact areas about as far apart as those of the design.

        The reference press has high friction, one at the largest amplitude low friction.

        Raises FingerflowError if no participant has both.
        """
        frame = self.pictured[self.pictured["max_force"] >= _LEAST_N]
        still, vibrating = (frame[frame["condition"] == one] for one in (0.0, max(self.design.amplitudes)))
        pairs = still.merge(vibrating, on="participant", suffixes=("", "_vibrating"))
        if pairs.empty:
            raise FingerflowError("no participant has presses of 3 N or more at both ends of the amplitudes")
        force, area = (np.log(pairs[f"{one}_vibrating"] / pairs[one]) for one in ("max_force", "real_contact_area"))
        best = pairs.loc[(force.abs() + (area - np.log(1 - self.design.real_area_fall)).abs()).idxmin()]
        high, low = (self._typical(best["participant"], best[trial]) for trial in ("trial", "trial_vibrating"))
        return high, low

    def _typical(self, participant: str, trial: str) -> "TypicalPress":
        entry = next(one for one in self.manifest.trials if (one.participant, one.trial) == (participant, trial))
        result = result_of(self.manifest, entry)
        assert result is not None
        return TypicalPress(result, self.manifest.build_scene(entry))


def record_and_analyse(folder: Path, quick: bool = False) -> PressStudy:
    """Simulate the experiment, and a part of its presses as recordings that are processed as a study; existing files
    are kept.

    Raises FingerflowError if the folder holds a study of another design, or a file cannot be written.
    """
    import pandas as pd

    recordings, pictured = folder / "recordings", _QUICK if quick else _FULL
    known = recordings / "truth.json"
    if known.exists() and json.loads(known.read_text(encoding="utf-8")) != json.loads(json.dumps(asdict(pictured))):
        raise FingerflowError(f"{known} is of another design: name another folder, or remove {folder}")
    if not (recordings / "study.toml").exists():  # the study file is written after all recordings
        write_recordings(recordings, pictured)
        init_study(recordings, recordings / "answers.csv")
    manifest = load_manifest(recordings)
    run_study(manifest)
    measured = pd.read_parquet(write_tables(manifest)[0])
    measured = measured.astype({name: float for name in measured if name.startswith("true_")})
    design, skins = Design(), simulate_skins(Design())
    parts = manifest, measured[measured["status"] == MEASURED], design
    presses, rendered = draw_presses(design), draw_presses(pictured)
    trace = simulate_trace(design.friction_for, max(design.amplitudes))
    numbers = {OWN: parts[1], PRINTED: _measure_as_printed(manifest)}
    truth = {analysis: Experiment(pictured, rendered, skins, analysis).frame({}, 0) for analysis in numbers}
    errors = {analysis: measured_errors(table, truth[analysis]) for analysis, table in numbers.items()}
    # The script's curl is no variable of a result: it is a median of gradients of the same points as the divergence.
    errors[PRINTED].loc["curl"] = errors[PRINTED].loc["divergence"]
    errors[PRINTED] = errors[PRINTED].combine_first(errors[OWN])
    own, printed = (
        study_of(Experiment(design, presses, skins, analysis), parts, errors[analysis], trace, _RESAMPLES[quick])
        for analysis in (OWN, PRINTED)
    )
    return replace(printed, own=own)


def _measure_as_printed(manifest: Manifest) -> Any:
    """Process the rendered presses by the printed analysis, and return a table (DataFrame) of their numbers at the
    largest force, a row for each press.
    """
    import pandas as pd

    shared = {**manifest.shared, "profile": "willemet_2021"}
    manifest = replace(manifest, shared=shared, results=manifest.path.parent.with_name("printed"))
    run_study(manifest)
    rows = []
    for entry in manifest.trials:
        if (result := result_of(manifest, entry)) is not None:
            at = result.isel(frame=int(np.nanargmax(result["normal_force"])))
            strain, energy = float(at["printed_strain"][:2].mean()), float(at["printed_strain_energy"])
            rows.append((entry.participant, entry.trial, float(at["median_divergence"]), strain, energy))
    return pd.DataFrame(rows, columns=["participant", "trial", "divergence", "strain", "strain_energy"])


def result_of(manifest: Manifest, entry: TrialEntry) -> xr.Dataset | None:
    """Return the result of a press of a study; None if it was not measured."""
    folder = manifest.results / entry.name
    stored = read_row(folder)
    return None if stored is None or stored.result is None else load_result(folder / stored.result)


def study_of(
    experiment: Experiment, parts: tuple[Manifest, Any, Design], errors: Any, trace: TribometerTrace, resamples: int
) -> PressStudy:
    """Return an experiment with its statistics; `parts` are manifest and table of the rendered presses, and design, and
    `errors` those of `measured_errors`.
    """
    manifest, pictured, design = parts
    frame = experiment.frame(errors["rms"], design.seed)
    sample = read_sample(frame)
    statistics = study_statistics(sample, resamples)
    return PressStudy(manifest, pictured, frame, experiment.curves(), sample, statistics, design, trace, errors)
