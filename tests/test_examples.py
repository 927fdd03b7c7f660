"""Tests of the examples for other programs, run by these programs if they are installed."""

import re
from pathlib import Path

import h5py
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.results.result import save_result
from tests.small_trials import TINY_PRESS, write_small

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, xr.Dataset]:
    folder = tmp_path_factory.mktemp("examples")
    result = process(write_small(folder / "press", TINY_PRESS))
    save_result(result, folder / "result.h5")
    return folder, result


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
