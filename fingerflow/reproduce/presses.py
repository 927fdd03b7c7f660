"""The simulated experiment of Willemet et al. 2021: a study of presses, recorded, measured and analysed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray as xr
from numpy.typing import NDArray

from fingerflow.models.skin_chain import press
from fingerflow.report.simulated_presses import HIGH
from fingerflow.report.supplement import Sources
from fingerflow.report.tribometer import TribometerTrace
from fingerflow.results.result import load_result
from fingerflow.schema.scene import Scene
from fingerflow.study.manifest import Manifest, TrialEntry
from fingerflow.study.simulated_trials import Design
from fingerflow.study.statistics import Sample
from fingerflow.study.trial_files import MEASURED, read_row
from fingerflow.synthetic import SyntheticScene, rebuild_scene

Values = NDArray[np.float64]
_TRUTHS = 16  # trials whose deformation is compared with the truth
_PEAKS = 200  # trials whose rates are followed in time


@dataclass(frozen=True)
class PressStudy:
    """A measured study: manifest, table of trials, curves by condition, sample, statistics, and the simulated truth.

    Attributes:
        frame, curves: DataFrames, as in `trials.parquet` and `curves.csv`.
        statistics: as in `statistics.json`.
        design: of the simulation.
        trace: simulated tribometer trace.
        figures: folder of the study's figures.
        sources: of the figures that models give.
    """

    manifest: Manifest
    frame: Any
    curves: Any
    sample: Sample
    statistics: dict[str, Any]
    design: Design
    trace: TribometerTrace
    figures: Path
    sources: Sources

    @cached_property
    def scene(self) -> Scene:
        """Return the settings of the first trial, which all share but for their files."""
        return self.manifest.scene_of(self.manifest.trials[0])

    def result_of(self, entry: TrialEntry) -> xr.Dataset | None:
        """Return the result of a trial; None if it was not measured."""
        folder = self.manifest.results / entry.name
        stored = read_row(folder)
        return None if stored is None or stored.result is None else load_result(folder / stored.result)

    def truth_of(self, entry: TrialEntry) -> SyntheticScene:
        """Return the simulated scene of a trial."""
        return rebuild_scene(self.manifest.scene_of(entry).recording.frames.parent)

    @cached_property
    def measured(self) -> Any:
        """Return the rows of all measured presses."""
        return self.frame[self.frame["status"] == MEASURED]

    def values(self, metric: str) -> Values:
        """Return a metric of all measured presses, in the unit of the table."""
        return np.asarray(self.measured[metric].to_numpy(float))

    def of_answered(self, column: str) -> Values:
        """Return a column of the trials that statistics use, in their order."""
        trials = self.sample.trials
        own = self.frame.set_index(["participant", "trial", "condition"])
        places = list(zip(trials.participant, trials.trial, trials.condition, strict=True))
        return np.asarray(own.loc[places, column].to_numpy(float))

    @cached_property
    def forces_of_peaks(self) -> dict[str, dict[float, float]]:
        """Return for strain and strain energy the median normal force (N) at the largest rate, by amplitude."""
        found: dict[str, dict[float, list[float]]] = {"strain": {}, "strain_energy": {}}
        for entry in self.some(_PEAKS):
            result = self.result_of(entry)
            if result is None:
                continue
            force = np.asarray(result["normal_force"], dtype=float)
            strain = np.asarray(result["median_strain_rate"], dtype=float)[:, :2].mean(1)
            for name, rate in (("strain", strain), ("strain_energy", np.asarray(result["strain_energy_rate"], float))):
                known = np.isfinite(rate) & np.isfinite(force) & (np.arange(force.size) <= np.nanargmax(force))
                if known.any():
                    peak = float(force[known][rate[known].argmax()])
                    found[name].setdefault(float(entry.condition), []).append(peak)
        return {name: {where: float(np.median(some)) for where, some in own.items()} for name, own in found.items()}

    @cached_property
    def chain_area_at_3n(self) -> dict[str, float]:
        """Return the contact area (mm²) of the skin chain at 3 N, by the name of its parameters."""
        load = torch.tensor(3.0, dtype=torch.float64)
        return {
            name: math.pi * (500 * float(press(HIGH, name, load).contact_length)) ** 2 for name in ("paper", "fitted")
        }

    @cached_property
    def errors(self) -> tuple[Values, Values]:
        """Return errors (T, 2) of the median displacement (mm) and (T,) of the median divergence at the largest force,
        of 16 trials at most.
        """
        moved, spread = [], []
        for entry in self.some(_TRUTHS):
            result = self.result_of(entry)
            if result is None:
                continue
            frame = int(np.nanargmax(result["normal_force"]))
            truth = self.truth_of(entry).truth.medians(frame)
            displacement = np.asarray(result["displacement"][frame])[np.asarray(result["in_contact"][frame]) > 0]
            moved.append(np.nanmedian(displacement, axis=0) - np.array(truth[-2:]))
            spread.append(float(result["median_divergence"][frame]) - truth.divergence)
        return np.array(moved), np.array(spread)

    def some(self, most: int) -> Iterator[TrialEntry]:
        """Yield evenly spaced trials, `most` at most."""
        step = max(1, len(self.manifest.trials) // most)
        yield from self.manifest.trials[:: step][:most]
