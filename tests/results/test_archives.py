"""Tests of complete results for other programs: NWB files and Zarr stores, read back by their own libraries."""

import importlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.results.result import load_result, save_result
from fingerflow.results.tables import export_table
from fingerflow.schema.scene_tables import RigSettings
from tests.small_trials import TINY_PRESS, write_small


@pytest.fixture(scope="module", params=[slice(None), slice(2, 7), slice(None, None, 3)])
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    scene = load_scene(write_small(tmp_path_factory.mktemp("archive") / "press", TINY_PRESS))
    return process(replace(scene, rig=RigSettings(participant="P07"))).isel(frame=request.param)


def needs(package: str) -> object:
    return pytest.importorskip(package, reason=f"{package} is not installed: pip install '.[nwb,zarr]'")


def test_nwb_holds_every_variable_with_its_unit(result: xr.Dataset, tmp_path: Path) -> None:
    pynwb = needs("pynwb")
    export_table(result, tmp_path / "trial.nwb")
    assert not pynwb.validate(path=str(tmp_path / "trial.nwb"))  # type: ignore[attr-defined]
    with pynwb.NWBHDF5IO(str(tmp_path / "trial.nwb"), "r") as io:  # type: ignore[attr-defined]
        file = io.read()
        module = file.processing["fingerflow"]
        for name, values in result.data_vars.items():
            if values.dims[0] == "frame":
                series = module[str(name)]
                np.testing.assert_array_equal(series.data[:], values.values)
                np.testing.assert_array_equal(series.timestamps[:], result["time"].values)
                assert (series.unit, series.description) == (values.attrs["units"], values.attrs["long_name"])
            else:
                np.testing.assert_array_equal(module[str(values.dims[0])][str(name)].data[:], values.values)
        assert (file.subject.subject_id, file.subject.species) == ("P07", "Homo sapiens")
        assert "components [['x', 'y']]" in module["position"].comments
        assert module["status"].comments.startswith("values 0, 1, 2 ... mean tracked not_finite")
    export_table(result, tmp_path / "trial.nwb")  # replaces its own file
    (tmp_path / "other.nwb").write_bytes(b"of another program")
    with pytest.raises(FingerflowError, match="was not written by this command"):
        export_table(result, tmp_path / "other.nwb")


def test_matlab_has_what_every_number_means(result: xr.Dataset, tmp_path: Path) -> None:
    export_table(result, tmp_path / "trial.mat")
    found = scipy.io.loadmat(tmp_path / "trial.mat", simplify_cells=True)
    assert {"frame_status", "status", "entry"} == set(found["meanings"])
    for name, values in {**result.data_vars, **result.coords}.items():
        assert found["meanings"].get(name) == values.attrs.get("flag_meanings")
        if values.ndim > 1 and values.dims[-1] in result.coords:
            assert list(found["components"][name]) == list(result[values.dims[-1]].values)
        if "units" in values.attrs:
            assert (found["units"][name], found["definitions"][name]) == (
                values.attrs["units"],
                values.attrs["long_name"],
            )
    assert found["attributes"]["mm_per_px"] == result.attrs["mm_per_px"]


@pytest.mark.long
def test_zarr_is_the_same_data_set(result: xr.Dataset, tmp_path: Path, command: Callable[..., int]) -> None:
    """A Zarr store holds the same data set, from memory, from a file and by the command, and `load_result` reads the
    store.
    """
    needs("zarr")
    save_result(result, tmp_path / "result.h5")
    assert command("export-table", tmp_path / "result.h5", tmp_path / "trial.zarr") == 0
    again = load_result(tmp_path / "trial.zarr")
    xr.testing.assert_identical(again, load_result(tmp_path / "result.h5"))
    assert again.sel(time=again["time"].values[-1]).equals(again.isel(frame=-1))
    with xr.open_zarr(tmp_path / "trial.zarr", consolidated=True) as plain:
        np.testing.assert_array_equal(plain["displacement"], result["displacement"])
    assert command("export-table", tmp_path / "trial.zarr", tmp_path / "table.csv", "--rows", "point") == 0
    export_table(result.isel(frame=slice(0, 2)), tmp_path / "trial.zarr")  # replaces its own
    assert load_result(tmp_path / "trial.zarr").sizes["frame"] == 2
    assert [one.name for one in tmp_path.iterdir() if one.name.startswith(".")] == []
    (tmp_path / "mine.zarr").mkdir()
    with pytest.raises(FingerflowError, match="is no result"):
        export_table(result, tmp_path / "mine.zarr", overwrite=True)  # a folder that is no Zarr store
    assert (tmp_path / "mine.zarr").is_dir()


@pytest.mark.parametrize(("suffix", "package"), [("nwb", "pynwb"), ("zarr", "zarr")])
def test_what_is_not_installed_is_named(
    suffix: str, package: str, result: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(importlib.import_module("sys").modules, package, None)  # type: ignore[arg-type]
    with pytest.raises(FingerflowError, match=rf"need the package \S+; install it with pip install {package}"):
        export_table(result, tmp_path / f"trial.{suffix}")
    assert not list(tmp_path.iterdir())
