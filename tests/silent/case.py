"""A case that must not give a wrong result without a warning, and what several groups of cases share."""

import contextlib
import io
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fingerflow import load_scene, player
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.results.stream_result import open_stream
from fingerflow.schema.recipe import Recipe, ViewRecipe
from tests.small_trials import warnings_of, write_library_bundle

#: Warnings that recordings without a fault also give.
KNOWN = (
    "the forces do not cover",
    "is never below 1.99 N",
    "points were found: the region of",
    "a colour video",
    "mjpeg is a lossy codec",
)


class Case(NamedTuple):
    """The case, a number of its result, the true number, the statement of the result, and the verdict."""

    case: str
    number: str
    truth: str
    stated: str
    verdict: str


def without_fault(name: str, result: xr.Dataset) -> Case:
    """Judge the warnings and the dropped points of a result without a fault."""
    said = [one for one in warnings_of(result).splitlines() if not any(known in one for known in KNOWN)]
    dropped = int((result["status"].values == TrackStatus.DUST_IN_WINDOW).sum()) if "status" in result else 0
    verdict = "false alarm" if said or dropped else "right"
    number = f"{len(said)} warnings, {dropped} positions dropped"
    return Case(f"no fault: {name}", number, "0, 0", (said or ["nothing"])[0][:90], verdict)


def records_of(bundle: Path, scene: Path, *arguments: str) -> np.ndarray[Any, Any]:
    """Play a scene without a page, and return the records; results of an earlier run are replaced."""
    output = scene.parent / "results"
    shutil.rmtree(output, ignore_errors=True)
    options = ["--scene", str(scene), "--output", str(output), "--page", "off", "--threads", "1"]
    with contextlib.redirect_stdout(io.StringIO()):
        assert player.main([str(bundle), *options, *arguments]) == 0
    return np.array(player.read_results(output).records)


def played(scene: Path) -> xr.Dataset:
    """Play a scene without a page by the compiled library, and return the result of the stream."""
    view = load_scene(scene).views.topography
    assert view is not None
    recipe = Recipe(views=ViewRecipe(height=view.shape[0], width=view.shape[1]))
    records_of(write_library_bundle(scene.parent / "bundle", recipe), scene)
    return open_stream(scene.parent / "results").load()
