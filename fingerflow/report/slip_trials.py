"""Results of trials of tangential loading: text of verdicts, counts, and figures as in Terekhov & Hayward 2011."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fingerflow.models.partial_slip import FrictionFit, TrialVerdict
from fingerflow.plot.outlines import contact_outline, stuck_outline
from fingerflow.report.picture_files import save_figure
from fingerflow.report.slip_figures import draw_motion, draw_over_time, draw_trial, draw_trials
from fingerflow.results.atomic_write import is_marked, keep_others


@dataclass(frozen=True)
class SlipTrial:
    """Processed trial of tangential loading: name, data set, verdict, and friction fit or None."""

    name: str
    result: xr.Dataset
    verdict: TrialVerdict
    fit: FrictionFit | None

    @classmethod
    def of(cls, result: xr.Dataset, name: str) -> "SlipTrial":
        """Return the trial stored in a data set that contains `stuck_ratio`."""
        stored = result["stuck_ratio"].attrs
        verdict = TrialVerdict(**_numbers(stored["verdict"]))
        fit = FrictionFit(**_numbers(stored["friction_fit"])) if "friction_fit" in stored else None
        return cls(name, result, verdict, fit)

    def load_ratio(self) -> NDArray[np.float64]:
        """Return the load ratio T/N in each frame (F,), NaN without forces."""
        if "load_ratio" in self.result:
            return np.asarray(self.result["load_ratio"])
        return np.full(self.result.sizes["frame"], np.nan)


def verdict_line(trial: SlipTrial) -> str:
    """Return as one line the verdicts on a trial by change point, published rule and model, with their numbers."""
    found = trial.verdict
    numbers = [f"as printed: {found.printed_outcome}", f"by the model: {found.model_outcome}", found.reason]
    if math.isfinite(found.loss_load_ratio):
        numbers.append(f"T/N {found.loss_load_ratio:.2f} at the loss")
    if found.outcome == "vanishes abruptly":
        numbers.append(
            f"extent d {found.critical_extent:.2f}, collapse {found.collapse_ms:.0f} ± {found.collapse_ms_std:.0f} ms, "
            f"{found.collapse_rate:.1f} ± {found.collapse_rate_std:.1f} per second"
        )
    return f"{trial.name}: {found.outcome} ({'; '.join(numbers)})"


def summary(trials: Sequence[SlipTrial], failed: int = 0) -> str:
    """Return as one line the number of trials of each verdict, by the change point and by the published rule."""
    lines = []
    for rule, outcomes in (
        ("", [trial.verdict.outcome for trial in trials]),
        ("as printed: ", [trial.verdict.printed_outcome for trial in trials]),
    ):
        counts = {name: outcomes.count(name) for name in ("vanishes abruptly", "diminishes", "inconclusive")}
        lines.append(rule + ", ".join(f"{name} {count}" for name, count in counts.items()))
    if failed:
        lines.append(f"not judged: {failed}")
    return f"{len(trials)} {'trial' if len(trials) == 1 else 'trials'}: " + "; ".join(lines)


def write_figures(trials: Sequence[SlipTrial], folder: Path, overwrite: bool = False) -> Path:
    """Write one figure per trial (`trial_figure`), and `trials.png` with all trials; return the folder.

    Raises:
        FingerflowError: without ``overwrite``, a file would be replaced that fingerflow has not written; nothing is
            written then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    for trial in trials:
        path = Path(trial.name)
        stem = name = path.parent.resolve().name if path.stem == "scene" else path.stem
        number = 1
        while name == "trials" or folder / f"{name}.png" in paths:
            number += 1
            name = f"{stem}-{number}"
        paths.append(folder / f"{name}.png")
    for path in (*paths, folder / "trials.png"):
        keep_others(path, is_marked, overwrite)
    for trial, path in zip(trials, paths, strict=True):
        save_figure(trial_figure(trial), path)
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    draw_trials(
        figure.subplots(), [(trial.result["stuck_ratio"], trial.load_ratio(), trial.verdict) for trial in trials]
    )
    save_figure(figure, folder / "trials.png")
    return folder


def trial_figure(trial: SlipTrial) -> Figure:
    """Draw a trial: skin motion and stick region at the end of slow loading, d^2 against T/N, and d^2 against time."""
    result, verdict = trial.result, trial.verdict
    area, load = np.asarray(result["stuck_ratio"]), trial.load_ratio()
    figure = Figure(figsize=(15, 4.5), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    # The last frame of slow loading: later the stick region has almost vanished.
    frame = verdict.collapse_frame if verdict.collapse_frame >= 0 else len(area) // 2
    position, one = np.asarray(result["position"]), result.isel(frame=frame)
    draw_motion(left, position[0], position[frame] - position[0], contact_outline(one), stuck_outline(one))
    left.set_title(f"{float(result['time'][frame]):.2f} s", loc="left")
    printed, deviation = (result.get(name) for name in ("printed_stuck_ratio", "stuck_ratio_std"))
    draw_trial(middle, area, load, verdict, trial.fit, printed)
    draw_over_time(right, result["time"], area, verdict, deviation, printed)
    figure.suptitle(f"{trial.name}: {verdict.outcome}, as printed: {verdict.printed_outcome}")
    return figure


def _numbers(stored: str) -> dict[str, Any]:
    """Return numbers stored as JSON in an attribute of a result, as a dataclass; null becomes NaN, lists tuples."""

    def read(value: Any) -> Any:
        if isinstance(value, list):
            return tuple(read(part) for part in value)
        return math.nan if value is None else value

    return {name: read(value) for name, value in json.loads(stored).items()}
