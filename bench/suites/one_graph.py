"""The shipped press as `fingerflow simulate press` writes it: `process`, and each recipe of `export/` in the player.

The player gets the scene as it is, and so measures the threshold while the contact grows, where `process` takes that of
the frame with most of it. Both choose points in `[stream] region`, as many as their settings say. Differences are the
largest of all frames with 5 mm2 of gross contact and more, nothing where one is not known in one of them: areas as a
share of those of `process`, the median divergence in 1e-3 (um a mm), and `rms` the root mean square of the latter.
`same` says whether every number of every frame equals, bit for bit, that of the first run of the recipe by the same
provider: at another pace (`rate_hz`, none: as fast as it goes), or with two frames side by side. By the compiled
kernels, in place of ONNX Runtime, sums are rounded otherwise. `error` is the largest difference of the median
divergence to the truth, in the same unit; that of `process` stands in the first row.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench.rows import Row
from bench.streams import exported, play
from fingerflow import load_scene, process
from fingerflow.player import read_results
from fingerflow.synthetic import Press, write_recording

RECIPES = Path(__file__).parents[2] / "export"
RUNS = (("cpu", None, 1), ("cpu", None, 2), ("cpu", 100, 2), ("compiled", None, 1), ("compiled", 100, 2))
_LEAST_AREA = 5.0  # mm2
_CLOCK = ("time", "latency")


def run(quick: bool) -> list[Row]:
    """A row for `process`, and five a recipe."""
    press = Press(n_frames=60 if quick else 300)
    with tempfile.TemporaryDirectory() as folder:
        write_recording(Path(folder) / "press", press)
        scene = Path(folder) / "press" / "scene.toml"
        result = process(load_scene(scene))
        counted = result["gross_contact_area"].values >= _LEAST_AREA
        truth = 1e3 * np.array([press.truth.medians(frame).divergence for frame in range(press.n_frames)])
        ours = 1e3 * result["median_divergence"].values
        rows: list[Row] = [{"by": "process", "error": _largest(ours - truth, counted)}]
        for recipe in sorted(RECIPES.glob("*.toml")):
            with exported(recipe.read_text(encoding="utf-8")) as bundle:
                firsts: dict[str, Any] = {}
                runs = (
                    ("cpu", None, 1),
                    ("cpu", None, 2),
                    ("cpu", 100, 2),
                    ("compiled", None, 1),
                    ("compiled", 100, 2),
                )
                for provider, pace, parallel in runs:
                    results = Path(folder) / f"{recipe.stem}-{provider}-{pace}-{parallel}"
                    given = ("--parallel-frames", str(parallel), *(() if pace is None else ("--rate", str(pace))))
                    play(bundle, *given, provider=provider, scene=scene, results=results)
                    records = read_results(results).records
                    first = firsts.setdefault(provider, records)
                    divergence = 1e3 * records["median_divergence"]
                    rows.append(
                        {
                            "by": recipe.stem,
                            "provider": provider,
                            "side_by_side": parallel,
                            "rate_hz": pace,
                            "real_area": _largest(
                                records["real_contact_area"] / result["real_contact_area"] - 1, counted
                            ),
                            "gross_area": _largest(
                                records["gross_contact_area"] / result["gross_contact_area"] - 1, counted
                            ),
                            "divergence": _largest(divergence - ours, counted),
                            "rms": _rms(divergence - ours, counted),
                            "error": _largest(divergence - truth, counted),
                            "same": all(
                                records[name].tobytes() == first[name].tobytes()
                                for name in records.dtype.names or ()
                                if name not in _CLOCK
                            ),
                        }
                    )
    return rows


def _largest(differences: Any, counted: np.ndarray) -> float | None:
    """None where one is not known that counts."""
    return _known(np.abs(np.asarray(differences)[counted]).max())


def _rms(differences: Any, counted: np.ndarray) -> float | None:
    return _known(np.sqrt(np.mean(np.asarray(differences)[counted] ** 2)))


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
