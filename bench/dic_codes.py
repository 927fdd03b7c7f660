"""Measure two digital image correlation programs (al-dic, pyvale) on the image pairs of `speed_against_error`.

Both ask for opencv-python, which installs its own cv2 over the one that serves here, and Qt, pyvale for VTK too: they
are installed in an environment of their own. The suite reads their figures from dic_codes.json.

    python -c "from bench.suites.speed_against_error import write_pairs; write_pairs('pairs.npz')"
    python -m venv dic
    dic/bin/pip install al-dic pyvale
    OMP_NUM_THREADS=1 dic/bin/python -m bench.dic_codes pairs.npz

Points are a grid of 20 px, since pyvale lays a grid itself; they start from zero displacement, and time is one way.

- al-dic: its local step alone (inverse compositional Gauss-Newton, affine), gradients and subsets of the reference
  included, without the global step that smooths; a subset of 20 px has 21 samples a side.
- pyvale: raster scan, translation alone (affine takes longer, and finds 1.01 of the bound where this finds 0.97), its
  cubic spline after its Gaussian filter of 5 px; the text file of results that it writes is included.
"""

import argparse
import importlib
import json
import os
import tempfile
from collections.abc import Callable
from datetime import date
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.timing import time_in_turns

RESULTS = Path(__file__).with_suffix(".json")
WINDOW = 21
STEP = 20
THREADS = int(os.environ.get("OMP_NUM_THREADS", os.cpu_count() or 1))
_WRONG = 0.5  # px

Array = NDArray[Any]


def al_dic(previous: Array, current: Array, points: Array) -> Array:
    """Return displacements (N, 2) px of points (N, 2)."""
    importlib.import_module("numba").set_num_threads(THREADS)
    settings = importlib.import_module("al_dic.core.data_structures").DICPara(winsize=WINDOW - 1)
    first, second = previous / 255, current / 255
    gradients = importlib.import_module("al_dic.io.image_ops").compute_image_gradient(first, np.ones_like(first))
    solve = importlib.import_module("al_dic.solver.local_icgn").local_icgn
    found = solve(np.zeros(points.size), points.astype(float), gradients, first, second, settings, 1e-4)
    displacement: Array = found[0].reshape(-1, 2)
    return displacement


def pyvale(previous: Array, current: Array, points: Array) -> Array:
    """Return displacements (N, 2) px of points (N, 2) on a grid, NaN where none was accepted."""
    dic = importlib.import_module("pyvale.dic")
    low, high = points.min(0) - WINDOW // 2, points.max(0) + WINDOW // 2 + 1
    region = np.zeros(previous.shape, bool)
    region[low[1] : high[1], low[0] : high[0]] = True
    with tempfile.TemporaryDirectory() as folder:
        dic.calculate_2d(
            *(previous, current[None], region, [tuple(points[0].tolist())]),
            subset_size=WINDOW,
            subset_step=STEP,
            shape_function="RIGID",
            method="RASTER",
            max_displacement=8,
            num_threads=THREADS,
            output_basepath=folder,
            print_level=0,
        )
        found = dic.import_2d(f"{folder}/*", print_level=0, delimiter=",", layout="column")
    places = zip(found.ss_x, found.ss_y, found.u_px[0], found.v_px[0], strict=True)
    known = {(int(x), int(y)): (u, v) for x, y, u, v in places}
    return np.array([known.get((int(x), int(y)), (np.nan, np.nan)) for x, y in points])


CODES: dict[str, Callable[[Array, Array, Array], Array]] = {"al-dic": al_dic, "pyvale": pyvale}


def main(arguments: list[str] | None = None) -> None:
    """Write times and errors of both codes into dic_codes.json."""
    parser = argparse.ArgumentParser("python -m bench.dic_codes", description="Two DIC codes on pairs of pictures.")
    parser.add_argument("pairs", type=Path, help="the file of write_pairs")
    pairs = np.load(parser.parse_args(arguments).pairs)
    previous, current, points = pairs["previous"], pairs["current"], pairs["points"]
    one = {name: partial(code, previous[1], current[1], points) for name, code in CODES.items()}
    times = time_in_turns(one, next(iter(CODES)), rounds=21)
    rows = []
    for name, code in CODES.items():
        moved = np.stack([code(*pair, points) for pair in zip(previous, current, strict=True)])
        errors = moved - pairs["moved"]
        accepted = np.isfinite(errors).all(-1)
        good = np.linalg.norm(errors, axis=-1) <= _WRONG
        rms = float(np.sqrt(np.square(errors[good]).mean()))
        bound = float(np.sqrt(np.broadcast_to(pairs["variance"], good.shape)[good].mean()))
        rows.append(
            {
                "window_px": WINDOW,
                "tracker": f"{name} {version(name)}",
                "rms_px": rms,
                "over_bound": rms / bound,
                "accepted": float(accepted.mean()),
                "wrong": float((accepted & ~good).mean()),
                "us_per_point": 1e3 * times[name].median_ms / len(points),
            }
        )
    record = {"date": date.today().isoformat(), "cpu": str(pairs["cpu"]), "threads": THREADS, "rows": rows}
    RESULTS.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
