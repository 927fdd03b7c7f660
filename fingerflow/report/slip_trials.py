"""Text and figures about trials of tangential loading, as in Terekhov & Hayward 2011."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fingerflow.models.partial_slip import FrictionFit, TrialVerdict
from fingerflow.plot.axes_style import ONE_COLUMN_MM, TWO_COLUMNS_MM, figure_style, new_figure
from fingerflow.plot.captions import describe
from fingerflow.plot.figure_files import PNG, FigureFiles
from fingerflow.plot.panels import join_captions, row_of_panels
from fingerflow.report.slip_figures import draw_motion, draw_over_time, draw_trial, draw_trials
from fingerflow.schema.rounding import format_uncertainty


@dataclass(frozen=True)
class SlipTrial:
    """Processed trial of tangential loading: name, result data set, verdict on slip, and friction fit or None."""

    name: str
    result: xr.Dataset
    verdict: TrialVerdict
    fit: FrictionFit | None

    @classmethod
    def read(cls, result: xr.Dataset, name: str) -> "SlipTrial":
        """Return the trial stored in a result data set with the variable `stuck_ratio`."""
        stored = result["stuck_ratio"].attrs
        verdict = TrialVerdict(**_numbers(stored["verdict"]))
        fit = FrictionFit(**_numbers(stored["friction_fit"])) if "friction_fit" in stored else None
        return cls(name, result, verdict, fit)

    @property
    def words(self) -> str:
        """Return a short name of the trial: the stem of its scene file, or the folder of a file `scene.toml`."""
        path = Path(self.name)
        return path.parent.resolve().name if path.stem == "scene" else path.stem

    def load_ratio(self) -> NDArray[np.float64]:
        """Return the load ratio (F,), tangential over normal force, in each of F frames; NaN without forces."""
        return np.asarray(self.result.get("load_ratio", np.full(self.result.sizes["frame"], np.nan)))


def verdict_line(trial: SlipTrial) -> str:
    """Return one line of text on how a trial loses its stuck area (abruptly, gradually or undecided): by change-point
    detection, by the rule printed in the paper, and by the fitted model.
    """
    verdict = trial.verdict
    numbers = [f"as printed: {verdict.printed_outcome}", f"by the model: {verdict.model_outcome}", verdict.reason]
    if math.isfinite(verdict.loss_load_ratio):
        numbers.append(f"T/N {verdict.loss_load_ratio:.2f} at the loss")
    if verdict.outcome == "vanishes abruptly":
        numbers.append(
            f"extent d {verdict.critical_extent:.2f}, "
            f"collapse {format_uncertainty(verdict.collapse_ms, verdict.collapse_ms_std)} ms, "
            f"{format_uncertainty(verdict.collapse_rate, verdict.collapse_rate_std)} per second"
        )
    return f"{trial.name}: {verdict.outcome} ({'; '.join(numbers)})"


def summary(trials: Sequence[SlipTrial], failed: int = 0) -> str:
    """Return one line that counts the trials by verdict on the loss of the stuck area, by change-point detection and by
    the rule printed in the paper, and the `failed` trials without verdict.
    """
    lines = []
    for rule, by_rule in (("", "outcome"), ("as printed: ", "printed_outcome")):
        outcomes = [getattr(trial.verdict, by_rule) for trial in trials]
        counts = {name: outcomes.count(name) for name in ("vanishes abruptly", "diminishes", "inconclusive")}
        lines.append(rule + ", ".join(f"{name} {count}" for name, count in counts.items()))
    if failed:
        lines.append(f"not judged: {failed}")
    return f"{len(trials)} {'trial' if len(trials) == 1 else 'trials'}: " + "; ".join(lines)


def write_figures(trials: Sequence[SlipTrial], folder: Path, overwrite: bool = False, files: FigureFiles = PNG) -> Path:
    """Write a figure for each trial and a figure `trials` of all trials; return the folder.

    Raises:
        FingerflowError: without ``overwrite``, a file would be replaced that fingerflow has not written; nothing is
            written then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names: list[str] = []
    for trial in trials:
        spellings = chain((trial.words,), (f"{trial.words}-{number}" for number in count(2)))
        names.append(next(name for name in spellings if name not in ("trials", *names)))
    for name in (*names, "trials"):
        files.keep_others(folder, name, overwrite)
    for trial, name in zip(trials, names, strict=True):
        files.save(trial_figure(trial, files.width_mm or TWO_COLUMNS_MM), folder, name)
    with figure_style(files.width_mm or ONE_COLUMN_MM):
        figure = new_figure(0.8)
        shown = [(trial.result["stuck_ratio"], trial.load_ratio(), trial.verdict) for trial in trials]
        draw_trials(figure.subplots(), shown)
    files.save(figure, folder, "trials")
    return folder


def trial_figure(trial: SlipTrial, width_mm: float) -> Figure:
    """Draw a trial: skin motion with stick region, and relative stuck area d^2 against load ratio and against time."""
    result, verdict, area = trial.result, trial.verdict, np.asarray(trial.result["stuck_ratio"])
    with figure_style(width_mm):
        figure, parts = row_of_panels(3, width_mm)
        left, middle, right = (part.subplots() for part in parts)
        # Show the last frame of slow loading, as the stick region has almost vanished later.
        frame = verdict.collapse_frame if verdict.collapse_frame >= 0 else len(area) // 2
        draw_motion(left, result, frame)
        draw_trial(middle, area, trial.load_ratio(), verdict, trial.fit, result.get("printed_stuck_ratio"))
        draw_over_time(right, result, verdict)
    captions = join_captions(parts)
    captions[0] += f" At {float(result['time'][frame]):.2f} s, the end of slow loading."
    describe(figure, "\n".join((f"Trial {verdict_line(replace(trial, name=trial.words))}.", *captions)))
    return figure


def _numbers(stored: str) -> dict[str, Any]:
    """Parse the JSON of a result's attribute, with NaN for null and tuples for lists."""

    def read(value: Any) -> Any:
        if isinstance(value, list):
            return tuple(read(part) for part in value)
        return math.nan if value is None else value

    return {name: read(value) for name, value in json.loads(stored).items()}
