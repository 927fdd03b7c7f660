"""Web page of a study: trials with thumbnails and links to their reports, figures and statistics."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment

from fingerflow.errors import FingerflowError
from fingerflow.plot.figure_files import FigureFiles
from fingerflow.recordings import open_recording
from fingerflow.report import write_report
from fingerflow.report.trial_metrics import METRICS
from fingerflow.report.view_painter import ViewPainter
from fingerflow.results.atomic_write import write_atomically, write_text
from fingerflow.results.largest_load import frame_of_largest
from fingerflow.results.result import load_result, open_result
from fingerflow.schema.rounding import format_interval, format_uncertainty
from fingerflow.schema.scene import Scene
from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.cluster import run_on_workers
from fingerflow.study.figures import write_figures
from fingerflow.study.manifest import Manifest, TrialEntry
from fingerflow.study.spreadsheet_cell import plain_cell
from fingerflow.study.statistics import read_sample, study_statistics
from fingerflow.study.table import write_tables
from fingerflow.study.trial_files import MEASURED, read_row

_THUMBNAIL_PX = 220  # px, width of a thumbnail
_SHOWN = ("max_force", "divergence", "strain_energy", "gross_contact_area", "global_displacement")
_FEWEST_ALIKE = 5  # least number of trials of a condition for the detection of outliers
_MAD = 1.4826  # ratio of the standard deviation of a Gaussian to its median absolute deviation


def write_study_report(
    manifest: Manifest, scheduler: str | None, workers: int | None, figure_files: FigureFiles
) -> Path:
    """Write the page of a study (`index.html`), `statistics.json`, figures, and a report of each trial.

    Reports and thumbnails newer than the row of their trial are kept; workers write the others, as in
    `run_study`. Figures and statistics use the table alone.

    Raises FingerflowError if nothing has been measured, the cluster is not available, or a file cannot be written.
    """
    import pandas as pd

    trials_path, curves_path = write_tables(manifest)
    frame, curves = pd.read_parquet(trials_path), pd.read_csv(curves_path).map(plain_cell)
    sample = read_sample(frame)
    waiting = {entry.name: replace(manifest, trials=(entry,)) for entry in _without_pages(manifest)}
    written = run_on_workers(
        write_page, waiting.items(), len(waiting), "{}: {}".format, scheduler, workers, progress=bool(waiting)
    )
    failed = [failure for failure in written if failure]
    figures = write_figures(frame, sample, curves, manifest.results / "figures", manifest.design, figure_files)
    statistics = study_statistics(sample)
    write_text(manifest.results / "statistics.json", json.dumps(statistics, indent=1, ensure_ascii=False))
    template = Environment(autoescape=True).from_string(files(__package__).joinpath("index.html").read_text("utf-8"))
    html = template.render(
        study=manifest.path.parent.name,
        rows=_rows(manifest, frame),
        shown=[(name, NUMBERS[name].axis_label) for name in _SHOWN if name in frame],
        counted=statistics["counted"],
        statuses=frame["status"].value_counts().to_dict(),
        answered=sample.answered,
        figures=figures,
        statistics=statistics,
        metrics=NUMBERS,
        pages_failed=failed,
        format_interval=_interval_text,
        format_uncertainty=format_uncertainty,
    )
    path = manifest.results / "index.html"
    write_text(path, html)
    return path


def _interval_text(value: float, interval: Sequence[float | None]) -> str:
    """Return an estimate and its interval as text; an unknown number is None, as read from JSON."""
    low, high = (math.nan if limit is None else limit for limit in interval)
    return format_interval(value, low, high)


def write_page(manifest: Manifest) -> str:
    """Write the report and thumbnail of a manifest with one trial; return an error message, or "" on success."""
    (entry,) = manifest.trials
    folder = manifest.results / entry.name
    stored = read_row(folder)
    if stored is None or stored.result is None:
        return ""
    try:
        scene = manifest.build_scene(entry)
        write_report(load_result(folder / stored.result), scene, folder, brief=True)
        _write_thumbnail(folder / stored.result, scene, folder / "thumbnail.jpg")
    except FingerflowError as error:
        return f"{entry.name}: {error}"
    return ""


def outliers(frame: Any) -> list[tuple[float, str]]:
    """Return for each trial, a row of `frame`, how far it lies from the median of its condition in the metric that
    deviates most, and that metric's name.

    The unit is 1.4826 times the median absolute deviation of the condition; 0 for fewer than five trials.
    """
    metrics = [name for name in METRICS if name in frame]
    conditions = frame["condition"]
    away = (frame[metrics] - frame.groupby(conditions)[metrics].transform("median")).abs()
    alike = away.groupby(conditions)
    spread = _MAD * alike.transform("median")
    score = (away / spread).where((spread > 0) & (alike.transform("count") >= _FEWEST_ALIKE)).fillna(0.0)
    largest = zip(score.max(axis=1), score.idxmax(axis=1), strict=True)
    return [(float(most), str(metric) if most > 0 else "") for most, metric in largest]


def _without_pages(manifest: Manifest) -> Iterator[TrialEntry]:
    for entry in manifest.trials:
        folder = manifest.results / entry.name
        stored = read_row(folder)
        if stored is None or stored.status != MEASURED:
            continue
        row = (folder / "row.json").stat().st_mtime_ns
        pages = [folder / "report.html", folder / "thumbnail.jpg"]
        if not all(page.exists() and page.stat().st_mtime_ns >= row for page in pages):
            yield entry


def _write_thumbnail(result: Path, scene: Scene, path: Path) -> None:
    with (
        open_result(result) as opened,
        open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording,
    ):
        largest = frame_of_largest(opened, ("gross_contact_area",)) or 0
        picture = ViewPainter(opened, scene, recording).paint(largest)
    height = round(_THUMBNAIL_PX * picture.shape[0] / picture.shape[1])
    small = cv2.resize(picture, (_THUMBNAIL_PX, height), interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    write_atomically(path, lambda part: part.write_bytes(encoded.tobytes()))


def _rows(manifest: Manifest, frame: Any) -> list[dict[str, Any]]:
    """Return the entries of the trials for the page: failed trials first, then by decreasing deviation."""
    rows = []
    for entry, (deviation, metric), (_, values) in zip(manifest.trials, outliers(frame), frame.iterrows(), strict=True):
        folder = manifest.results / entry.name
        measured = values["status"] == MEASURED
        row = {
            **vars(entry),
            "answer": "" if entry.answer is None else "more slippery" if entry.answer else "not",
            "status": values["status"],
            "verdict": values["slip_verdict"] or "",
            "reason": values["reason"],
            "warnings": (values["warnings"] or "").splitlines() if measured else [],
            "usable": values["usable_frames"] / values["frames"] if measured else None,
            "coverage": values["coverage"] if measured and np.isfinite(values["coverage"]) else None,
            "outlier": deviation if measured else None,
            "by": NUMBERS[metric].words if metric else "",
            "page": f"{entry.name}/report.html" if (folder / "report.html").exists() and measured else "",
            "thumbnail": f"{entry.name}/thumbnail.jpg" if (folder / "thumbnail.jpg").exists() and measured else "",
            # With standard deviations, NaN where there is none.
            "values": {
                name: NUMBERS[name].shown_values(values.reindex((name, f"{name}_std")).to_numpy(float))
                for name in _SHOWN
                if name in frame
            },
        }
        rows.append(row)
    return sorted(rows, key=lambda row: (row["status"] == MEASURED, -(row["outlier"] or 0.0)))
