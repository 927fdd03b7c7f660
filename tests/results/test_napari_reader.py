"""Tests of napari's reader plug-in: layers against the arrays of recording and result, and in napari if installed."""

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from fingerflow import process
from fingerflow.plot import field_map
from fingerflow.recordings.frames.open_recording import READERS
from fingerflow.results.napari_reader import get_reader
from fingerflow.results.result import save_result
from tests.small_trials import TINY_PRESS, write_small

MANIFEST = Path(__file__).resolve().parents[2] / "fingerflow" / "napari.yaml"
Layers = dict[str, tuple[Any, dict[str, Any]]]


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, xr.Dataset]:
    folder = tmp_path_factory.mktemp("napari") / "press"
    result = process(write_small(folder, TINY_PRESS))
    save_result(result, folder / "result.h5")
    return folder, result


def layers(path: Path) -> Layers:
    read = get_reader(str(path))
    assert read is not None
    return {settings["name"]: (data, settings) for data, settings, _ in read(str(path))}


def test_a_result_is_views_tracks_and_points(trial: tuple[Path, xr.Dataset]) -> None:
    folder, result = trial
    found = layers(folder / "result.h5")
    assert list(found) == ["contact view", "topography view", "tracks", "divergence (µm/mm)"]
    topography, _ = found["topography view"]
    half = TINY_PRESS.frame_shape[1] // 2
    frames = np.load(folder / "frames.npy")
    assert topography.shape == (8, 96, half)
    np.testing.assert_array_equal(topography[3], frames[3, :, :half])
    np.testing.assert_array_equal(topography[2:5, 10:20, 7], frames[2:5, 10:20, 7])
    np.testing.assert_array_equal(np.asarray(topography), frames[..., :half])
    tracks, _ = found["tracks"]
    of_five = tracks[tracks[:, 0] == 5]
    known = np.isfinite(result["position_px"].values[:, 5]).all(-1)
    np.testing.assert_array_equal(of_five[:, 1], np.flatnonzero(known))
    np.testing.assert_allclose(of_five[:, [3, 2]], result["position_px"].values[known, 5], rtol=1e-6)
    points, settings = found["divergence (µm/mm)"]
    frame, point = np.nonzero(np.isfinite(result["divergence"].values))
    assert len(points) == len(frame)
    values = dict(zip(map(tuple, points[:, 0:1].astype(int)), points, strict=False))
    assert len(values) == len(np.unique(frame))
    expected = np.sort(1e3 * result["divergence"].values[frame, point].astype(float))
    np.testing.assert_allclose(np.sort(settings["features"]["divergence (µm/mm)"]), expected, rtol=1e-6)


def test_spread_has_one_colour_everywhere(trial: tuple[Path, xr.Dataset]) -> None:
    """napari, the report's maps, the page and the live page show spread in red and compression in blue."""
    folder, result = trial
    name = layers(folder / "result.h5")["divergence (µm/mm)"][1]["face_colormap"]
    drawn = field_map(result, "divergence", 7).collections[0].get_cmap()
    assert drawn is not None
    assert drawn.name == name
    table = (MANIFEST.parent / "view" / "page" / "colours.js").read_text(encoding="utf-8")
    page = [to_rgb(colour) for colour in re.findall("#[0-9a-f]{6}", table.partition("DIVERGING")[2])[:7]]
    live = (MANIFEST.parent / "player" / "page" / "page.js").read_text(encoding="utf-8")
    ends = re.findall(r"\[(\d+), (\d+), (\d+)\]", live.partition("function colour")[2])[:2]
    for colours in (colormaps[name]([0.0, 1.0]), page, np.array(ends, float)):
        assert colours[0][0] < colours[0][2]
        assert colours[-1][0] > colours[-1][2]


def test_the_contact_view_lies_on_the_topography(trial: tuple[Path, xr.Dataset]) -> None:
    """A pixel of the contact view is drawn at the calibrated position in the topography view."""
    folder, result = trial
    affine = layers(folder / "result.h5")["contact view"][1]["affine"]
    position, pixels = result["position"].values, result["position_px"].values
    known = np.isfinite(pixels).all(-1)
    in_contact = position[known] / float(result.attrs["mm_per_px"])
    drawn = affine @ np.column_stack((np.zeros(len(in_contact)), in_contact[:, ::-1], np.ones(len(in_contact)))).T
    np.testing.assert_allclose(drawn[[2, 1]].T, pixels[known], atol=1e-3)


def test_a_recording_is_one_image(trial: tuple[Path, xr.Dataset], tmp_path: Path) -> None:
    frames = np.load(trial[0] / "frames.npy")
    with h5py.File(tmp_path / "frames.h5", "w") as file:
        file.create_dataset("frames", data=frames).attrs["frame_rate"] = 8.0
    ((data, settings),) = layers(tmp_path / "frames.h5").values()
    np.testing.assert_array_equal(np.asarray(data), frames)
    assert settings["contrast_limits"] == (0.0, 255.0)
    assert settings["metadata"] == {"frame_rate_hz": 8.0}


def test_what_is_neither_is_left_to_others(tmp_path: Path) -> None:
    (tmp_path / "notes.h5").write_text("no HDF5")
    assert get_reader(str(tmp_path / "notes.h5")) is None
    assert get_reader([str(tmp_path), str(tmp_path)]) is None
    assert get_reader(str(tmp_path)) is None


def test_a_result_without_its_recording_has_its_points(trial: tuple[Path, xr.Dataset], tmp_path: Path) -> None:
    _, result = trial
    moved = result.assign_attrs(settings=result.attrs["settings"].replace("frames.npy", "gone.npy"))
    save_result(moved, tmp_path / "result.h5")
    assert list(layers(tmp_path / "result.h5")) == ["tracks", "divergence (µm/mm)"]


def test_the_manifest_is_valid_and_names_what_is_read() -> None:
    npe2 = pytest.importorskip("npe2", reason="npe2 is not installed: pip install -e '.[dev]'")
    manifest = npe2.PluginManifest.from_file(MANIFEST)
    (reader,) = manifest.contributions.readers
    suffixes = {suffix for some in READERS.values() for suffix in some} | {".zarr"}
    assert {pattern.removeprefix("*") for pattern in reader.filename_patterns} <= suffixes
    (one,) = manifest.contributions.commands
    module, name = one.python_name.split(":")
    assert (module, name) == (get_reader.__module__, get_reader.__name__)
