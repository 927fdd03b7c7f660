"""Tests of the examples for other programs, run by these programs if they are installed."""

import re
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.results.result import save_result
from fingerflow.results.tables import export_map
from fingerflow.results.tables.grid_maps import maps_of
from tests.small_trials import TINY_PRESS, write_small

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
PAGE = ROOT / "docs" / "other_programs.md"
IMAGEJ = Path("/usr/share/java/ij.jar")  # from the Debian package imagej


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, xr.Dataset]:
    folder = tmp_path_factory.mktemp("examples")
    result = process(write_small(folder / "press", TINY_PRESS))
    save_result(result, folder / "result.h5")
    return folder, result


def run(*command: str) -> str:
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_the_example_for_matlab_reads_what_a_result_has(trial: tuple[Path, xr.Dataset]) -> None:
    """Every variable that the example reads is an array of the file with the unit that the example states."""
    text = (EXAMPLES / "read_result.m").read_text(encoding="utf-8")
    read = dict(re.findall(r"ncread\(path, '(\w+)'\);? *(?:% (\S+))?", text))
    assert len(read) == text.count("ncread(path") == 5
    stated = {"time": "s", "gross_contact_area": "mm^2", "median_divergence": "um/mm", "displacement": "um,"}
    assert {name: unit for name, unit in read.items() if name in stated} == stated
    units = {"time": "s", "gross_contact_area": "mm2", "median_divergence": "1", "displacement": "mm"}
    with h5py.File(trial[0] / "result.h5") as file:
        assert {name: file[name].attrs["units"] for name in units} == units
        assert {name: file[name].shape for name in read} == {name: trial[1][name].shape for name in read}


@pytest.mark.long
def test_octave_runs_the_page(trial: tuple[Path, xr.Dataset]) -> None:
    """The block for MATLAB of the page of other programs runs in Octave and prints the largest contact."""
    here = _octave()
    folder, result = trial
    (block,) = re.findall(r"```matlab\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    # The lines that draw are left out: they need a screen.
    block = re.sub(r"^(plot|xlabel).*\n", "", block, flags=re.MULTILINE).replace("'examples'", f"'{EXAMPLES}'")
    frame = int(result["gross_contact_area"].values.argmax())
    area, time, spread = (float(result[name][frame]) for name in ("gross_contact_area", "time", "median_divergence"))
    said = run(*here, f"cd('{folder}'); {block}").splitlines()[-1]
    assert said == f"{area:.1f} mm^2 at {time:.2f} s, median divergence {1e3 * spread:.1f} um/mm"

    # Octave reads a result with the file that MATLAB uses as well.
    code = f"addpath('{EXAMPLES}'); t = read_result('{folder / 'result.h5'}'); "
    said = run(*here, code + "printf('%.9g ', t.contact, t.farthest, size(t.displacement))").splitlines()
    length = 1e3 * np.linalg.norm(result["displacement"].values, axis=-1)
    tracked = (result["status"].values == 0) & np.isfinite(length)
    farthest = np.where(tracked, length, 0).max(1)
    expected = [*result["gross_contact_area"].values, *farthest, *result["displacement"].values.shape[::-1]]
    np.testing.assert_allclose(np.array(said[-1].split(), float), expected, rtol=1e-6)
    assert said[0] == f"{result.sizes['frame']} frames, {result.sizes['point']} points"


def _octave() -> list[str]:
    """Return the command that runs code in Octave with its package netcdf; skip the test where they are not here."""
    if shutil.which("octave") is None:
        pytest.skip("Octave is not installed here")
    here = ["octave", "--no-gui", "--quiet", "--eval"]
    if run(*here, "disp(numel(pkg('list', 'netcdf')))").strip() != "1":
        pytest.skip("Octave has no package netcdf here")
    return here


@pytest.mark.long
def test_imagej_measures_a_map(trial: tuple[Path, xr.Dataset]) -> None:
    missing = [name for name in ("java", "xvfb-run") if shutil.which(name) is None]
    if missing or not IMAGEJ.is_file():
        pytest.skip(f"needs ImageJ ({IMAGEJ}), java and xvfb-run; not here: {', '.join(missing) or IMAGEJ}")
    folder, result = trial
    export_map(result, folder / "divergence.tif", "divergence")
    command = ("xvfb-run", "-a", "java", f"-Duser.home={folder}", "-jar", str(IMAGEJ), "-batch")
    run(*command, str(EXAMPLES / "measure_map.ijm"), str(folder / "divergence.tif"))
    lines = (folder / "divergence.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "frame,time (s),area (mm^2),mean"
    rows = np.genfromtxt(lines, delimiter=",", skip_header=1)
    values = maps_of(result, "divergence", 0.1).values[:, 0].astype(np.float64)
    known = np.isfinite(values).sum((1, 2))
    np.testing.assert_allclose(rows[:, 2], 0.01 * known, atol=1e-6)
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(rows[:, 3], np.nansum(values, (1, 2)) / known, atol=1e-4)
    np.testing.assert_allclose(rows[:, 1], np.arange(len(rows)) / 8, atol=1e-6)
