"""Tests of result stores: a file holds the same values as memory."""

from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray as xr

from fingerflow.pipeline.plan import VARIABLES
from fingerflow.results.result import load_result, read_own
from fingerflow.results.store import FileStore, MemoryStore, Store

FRAMES = 20
NAMES = ("position", "status", "in_contact", "real_contact_area", "normal_force", "strain", "strain_energy_density")


def _fill(store: Store, points: int) -> None:
    random = np.random.default_rng(1)
    store.create("position", point=points)
    store.create("status", point=points)
    for some in np.split(np.arange(FRAMES), [8, 16]):
        store["position"][some] = random.normal(size=(len(some), points, 2))
        if some[0] != 8:  # the other frames are never written
            store["status"][some] = random.integers(0, 9, (len(some), points))
    store.put("in_contact", random.random((FRAMES, points)) < 0.5)
    store.put("real_contact_area", random.normal(size=FRAMES))
    store.put("normal_force", random.normal(size=FRAMES), {"verdict": "text", "limit": 0.5})
    store.put("strain", random.normal(size=(FRAMES, 2 * points, 3)), triangle=2 * points)
    store.put("strain_energy_density", random.normal(size=(FRAMES, 2 * points)))
    attributes = {"fingerflow_version": "0", "settings": "s" * 5000, "mm_per_px": 0.03}
    store.finish(np.arange(FRAMES) / 10, np.arange(FRAMES) + 7, attributes)


def _both(folder: Path, points: int) -> tuple[xr.Dataset, Path]:
    memory = MemoryStore(VARIABLES, FRAMES)
    _fill(memory, points)
    path = folder / "result.h5"
    with FileStore(VARIABLES, FRAMES, path) as file:
        _fill(file, points)
    return memory.dataset, path


@pytest.mark.parametrize("points", [0, 300])
def test_a_file_holds_what_memory_does(points: int, tmp_path: Path) -> None:
    expected, path = _both(tmp_path, points)
    stored = load_result(path)
    xr.testing.assert_identical(stored.drop_attrs(), expected.drop_attrs())
    assert list(stored.data_vars) == list(NAMES)
    for name in expected.variables:
        assert stored[name].dtype == expected[name].dtype or name in ("xy", "strain_component")
        for key, value in expected[name].attrs.items():
            np.testing.assert_array_equal(stored[name].attrs[key], value)
    assert {name: stored.attrs[name] for name in expected.attrs} == expected.attrs
    with h5py.File(path, "a") as earlier:
        del earlier["in_contact"].attrs["dtype"]
    xr.testing.assert_equal(load_result(path)["in_contact"], expected["in_contact"])


def test_points_may_be_added(tmp_path: Path) -> None:
    """Points can be added later: earlier frames are filled with NaN, or with the given value."""
    memory, path = MemoryStore(VARIABLES, FRAMES), tmp_path / "result.h5"
    with FileStore(VARIABLES, FRAMES, path) as file:
        for store in (memory, file):
            store.create("position", point=300)
            store.create("status")
            first, last = np.arange(8), np.arange(8, FRAMES)
            store["position"][first] = np.ones((8, 300, 2))
            store.grow(310, {"status": 3})
            store["position"][last] = np.full((len(last), 310, 2), 2.0)
            store.finish(np.arange(FRAMES) / 10, np.arange(FRAMES), {"fingerflow_version": "0"})
    stored = load_result(path)
    xr.testing.assert_identical(stored.drop_attrs(), memory.dataset.drop_attrs())
    assert (stored["status"].values[:, 300:] == 3).all()
    assert np.isnan(stored["position"].values[:8, 300:]).all()


def test_the_file_is_netcdf4(tmp_path: Path) -> None:
    """The file is netCDF4 for a reader that knows dimensions only by their scales."""
    _, path = _both(tmp_path, 300)
    with h5netcdf.File(path) as file:
        sizes = {name: one.size for name, one in file.dimensions.items()}
        assert sizes == {"frame": FRAMES, "point": 300, "xy": 2, "triangle": 600, "strain_component": 3}
        assert set(file.variables) == {*NAMES, "frame", "time", "xy", "strain_component"}
        assert file["strain"].dimensions == ("frame", "triangle", "strain_component")
        assert file["strain"].attrs["coordinates"] == "time"


def test_some_variables_of_a_file_are_those_of_the_whole(tmp_path: Path) -> None:
    _, path = _both(tmp_path, 300)
    whole, some = load_result(path), read_own(path, ("status", "normal_force", "no_such_variable"), ("normal_force",))
    assert set(some) == {"status", "normal_force", "time", "frame"}
    for name in some:
        np.testing.assert_array_equal(some[name].values, whole[name].values)
    assert some["normal_force"].attrs == whole["normal_force"].attrs
    assert not some["status"].attrs
    assert some.attrs["settings"] == whole.attrs["settings"]
