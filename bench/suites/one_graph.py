"""Compare `process` with the exported recipes in the player, on a simulated press and a simulated slide.

The player gets the scene as it is, and so measures the threshold while the contact grows, where `process` takes that of
the frame with most of it. Both choose points in `[stream] region`, as many as their settings say. Differences are the
largest of all frames with 5 mm2 of gross contact and more, nothing where one is not known in one of them: areas as a
share of those of `process`, the median divergence in 1e-3 (um a mm), and `rms` the root mean square of the latter.
`same` says whether every number of every frame equals, to rounding of float32, that of the first run of the recipe by
the same engine, at another pace (`rate_hz`, none: as fast as it goes). `error` is the largest difference of the median
divergence to the truth, in the same unit; that of `process` stands in the first row.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.drawing import RED, Mark, cells, draw_dots, saved_axes
from bench.recordings import write_quietly
from bench.rows import Row, number
from bench.streams import exported_recipes, play
from fingerflow import load_scene, process
from fingerflow.player import read_results
from fingerflow.synthetic import Press, Slide

RUNS = (("native", None), ("native", 100), ("onnx", None), ("onnx", 30))
_LEAST_AREA = 5.0  # mm2
_CLOCK = ("time", "latency")


def run(quick: bool) -> list[Row]:
    """Return a row for `process` and four per recipe, for each recording."""
    frames = 60 if quick else 300
    recordings: dict[str, Press | Slide] = {"press": Press(n_frames=frames), "slide": Slide(n_frames=frames)}
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, exported_recipes() as bundles:
        for name, recording in recordings.items():
            write_quietly(Path(folder) / name, recording)
            scene = Path(folder) / name / "scene.toml"
            rows += [
                {"recording": name, **row} for row in _rows(scene, recording, bundles, Path(folder) / f"of-{name}")
            ]
    return rows


def _rows(scene: Path, recording: Press | Slide, bundles: Mapping[str, Path], folder: Path) -> Iterator[Row]:
    result = process(load_scene(scene))
    counted = result["gross_contact_area"].values >= _LEAST_AREA
    truth = 1e3 * np.array([recording.truth.medians(frame).divergence for frame in range(recording.n_frames)])
    ours = 1e3 * result["median_divergence"].values
    yield {"by": "process", "error": _largest(ours - truth, counted)}
    for recipe, bundle in bundles.items():
        firsts: dict[str, Any] = {}
        for engine, pace in RUNS:
            results = folder.with_name(f"{folder.name}-{recipe}-{engine}-{pace}")
            play(bundle, engine, scene=scene, results=results, rate=pace)
            records = read_results(results).records
            first = firsts.setdefault(engine, records)
            divergence = 1e3 * records["median_divergence"]
            yield {
                "by": recipe,
                "engine": engine,
                "rate_hz": pace,
                "real_area": _largest(records["real_contact_area"] / result["real_contact_area"] - 1, counted),
                "gross_area": _largest(records["gross_contact_area"] / result["gross_contact_area"] - 1, counted),
                "divergence": _largest(divergence - ours, counted),
                "rms": _rms(divergence - ours, counted),
                "error": _largest(divergence - truth, counted),
                "same": all(
                    np.allclose(records[name], first[name], rtol=1e-5, atol=1e-6, equal_nan=True)
                    for name in records.dtype.names or ()
                    if name not in _CLOCK
                ),
            }


def _largest(differences: Any, counted: np.ndarray) -> float | None:
    """Return the largest of the counted differences, None where one of them is unknown."""
    return _known(np.abs(np.asarray(differences)[counted]).max())


def _rms(differences: Any, counted: np.ndarray) -> float | None:
    return _known(np.sqrt(np.mean(np.asarray(differences)[counted] ** 2)))


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


_MARKS = {"native": Mark(RED), "onnx": Mark(RED, "s", filled=False)}
_DRAWN = {"real_area": 100, "gross_area": 100, "divergence": 1}  # columns, and factors to % and µm/mm


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the largest differences between stream and `process`, a row per recording and recipe."""
    first = list({(row["recording"], row["by"], row.get("engine")): row for row in reversed(rows)}.values())[::-1]
    names = list(dict.fromkeys(f"{row['recording']}, {row['by']}" for row in first if "engine" in row))
    named = [{**row, "name": f"{row['recording']}, {row['by']}"} for row in first]
    titles = "real area (%)", "gross area (%)", "median divergence (µm/mm)"
    with saved_axes(path, 2.2, 3, width=9.5, sharey=True) as panels:
        for axes, (column, factor), title in zip(panels, _DRAWN.items(), titles, strict=True):
            scaled = [{**row, column: factor * number(row, column)} for row in named if column in row]
            values = {engine: cells(scaled, column, "name", names, engine=engine) for engine in _MARKS}
            draw_dots(axes, names, values, _MARKS)
            axes.set(xlabel=title, xlim=(0, None))
        panels[-1].legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
