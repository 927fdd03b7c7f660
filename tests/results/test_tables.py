"""Tests of tables and maps: their content against the arrays they are made of, read back by other libraries."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import tifffile
import xarray as xr
from scipy.spatial import Delaunay
from typer.testing import CliRunner

from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.dictionary import dictionary
from fingerflow.pipeline.plan import VARIABLES
from fingerflow.results.tables import export_map, export_table
from fingerflow.results.tables.grid_maps import described, interpolate_maps
from fingerflow.schema.variable_record import IN_PERCENT
from fingerflow.schema.variables import shown_unit

FRAMES, POINTS, FIRST = 3, 200, 10
GRADIENT = np.array([[0.2, -0.1], [0.05, 0.3]])


@pytest.fixture(scope="module")
def result() -> xr.Dataset:
    """Return drifting points on 4 x 3 mm with fields linear in position; one point is lost in the last frame."""
    start = np.random.default_rng(3).uniform((0, 0), (4, 3), (POINTS, 2))
    position = start + 0.1 * np.arange(FRAMES)[:, None, None]
    position[2, 7] = np.nan
    triangles = Delaunay(start).simplices.astype(np.int32)

    def variable(dims: tuple[str, ...], values: Any, units: str = "1") -> xr.Variable:
        return xr.Variable(dims, values, {"units": units, "long_name": "something"})

    of_points, onset = ("frame", "point"), np.full(POINTS, FIRST + 1, np.int32)
    onset[3] = -1
    return xr.Dataset(
        {
            "position": variable((*of_points, "xy"), position, "mm"),
            "position_px": variable((*of_points, "xy"), 20 * position, "px"),
            "divergence": variable(of_points, position @ [0.3, -0.2] + 1),
            "displacement": variable((*of_points, "xy"), position @ GRADIENT.T, "mm"),
            "onset_frame": variable(("point",), onset),
            "triangles": variable(("triangle", "corner"), triangles),
            "strain_energy_density": variable(
                ("frame", "triangle"), np.tile(np.arange(len(triangles), dtype=np.float32), (FRAMES, 1)), "mJ/mm3"
            ),
            "real_contact_area": variable(("frame",), np.arange(FRAMES) / 3, "mm2"),
        },
        {"time": ("frame", np.arange(FRAMES) / 50, {"units": "s"}), "frame": np.arange(FRAMES) + FIRST, "xy": [*"xy"]},
        {
            "fingerflow_version": "0",
            "settings": json.dumps({"path": "a", "forces": None, "fields": {"gauge_length_mm": 1.6}}),
            "warnings": json.dumps(["one", "two"]),
        },
    )


def read(path: Path) -> tuple[list[str], np.ndarray]:
    names = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    return names, np.genfromtxt(path, delimiter=",", skip_header=1)


def test_a_row_a_frame(result: xr.Dataset, tmp_path: Path) -> None:
    export_table(result, tmp_path / "frames.csv")
    names, rows = read(tmp_path / "frames.csv")
    assert names == ["frame", "time (s)", "real_contact_area (mm²)"]
    np.testing.assert_allclose(rows[:, 2], result["real_contact_area"], rtol=1e-8)


def test_a_row_a_point(result: xr.Dataset, tmp_path: Path) -> None:
    export_table(result, tmp_path / "points.csv", "point")
    names, rows = read(tmp_path / "points.csv")
    assert rows.shape == (FRAMES * POINTS, len(names))
    column = {name: rows[:, k].reshape(FRAMES, POINTS) for k, name in enumerate(names)}
    np.testing.assert_array_equal(column["frame"][:, 0], result["frame"])
    np.testing.assert_allclose(column["time (s)"][:, 5], result["time"])
    np.testing.assert_array_equal(column["point"][1], np.arange(POINTS))
    np.testing.assert_allclose(column["divergence (µm/mm)"], 1e3 * result["divergence"], rtol=1e-8)
    np.testing.assert_allclose(column["displacement_y (µm)"], 1e3 * result["displacement"][..., 1], rtol=1e-7)
    np.testing.assert_array_equal(column["onset_frame"][2], result["onset_frame"])


def test_tracks_as_napari_takes_them(result: xr.Dataset, tmp_path: Path) -> None:
    """Tracks have the columns ID, t, y, x, sorted by ID and time, and only finite positions, as napari requires."""
    export_table(result, tmp_path / "tracks.csv", "track", ["divergence"])
    names, rows = read(tmp_path / "tracks.csv")
    assert names == ["track_id", "t", "y", "x", "divergence (µm/mm)"]
    assert len(rows) == FRAMES * POINTS - 1
    assert np.isfinite(rows).all()
    assert (np.lexsort((rows[:, 1], rows[:, 0])) == np.arange(len(rows))).all()
    of_five = rows[rows[:, 0] == 5]
    np.testing.assert_allclose(of_five[:, [3, 2]], result["position_px"][:, 5], rtol=1e-8)
    np.testing.assert_allclose(of_five[:, 4], 1e3 * result["divergence"][:, 5], rtol=1e-8)
    np.testing.assert_array_equal(rows[rows[:, 0] == 7][:, 1], [FIRST, FIRST + 1])


def test_one_switch_shows_deformation_in_percent(
    result: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables, maps, axes and pages show deformation in % on one switch; variables without a unit in % keep theirs."""
    monkeypatch.setenv(IN_PERCENT, "1")
    export_table(result, tmp_path / "tracks.csv", "track", ["divergence", "displacement"])
    names, rows = read(tmp_path / "tracks.csv")
    assert names[4:] == ["divergence (%)", "displacement_x (µm)", "displacement_y (µm)"]
    np.testing.assert_allclose(rows[rows[:, 0] == 5, 4], 100 * result["divergence"][:, 5], rtol=1e-8)
    maps = interpolate_maps(result, "divergence", 0.2)
    assert "divergence in %" in described(maps)
    assert VARIABLES["median_divergence_rate"].axis_label == "median divergence rate (%/s)"
    assert VARIABLES["divergence"].shown()["percent"] is None
    monkeypatch.delenv(IN_PERCENT)
    assert VARIABLES["divergence"].shown()["percent"] == {"unit": "%", "factor": 100.0}
    np.testing.assert_allclose(interpolate_maps(result, "divergence", 0.2).values, 10 * maps.values, rtol=1e-5)


def test_matlab_counts_from_one_and_has_the_settings(result: xr.Dataset, tmp_path: Path) -> None:
    export_table(result.assign(key_frame=result["frame"]), tmp_path / "all.mat")
    found = scipy.io.loadmat(tmp_path / "all.mat", simplify_cells=True)
    np.testing.assert_array_equal(found["triangles"] - 1, result["triangles"])
    assert found["onset_frame"][3] == 0
    for name in ("frame", "key_frame"):
        np.testing.assert_array_equal(found[name], result["frame"] + 1)
    at_onset = found["frame"] == found["onset_frame"][0]  # position(frame == onset_frame(1), 1, :)
    np.testing.assert_array_equal(found["position"][at_onset, 0], result["position"][1:2, 0])
    assert list(found["components"]["position"]) == ["x", "y"]
    assert found["attributes"] == {"fingerflow_version": "0"}
    assert found["settings"]["fields"]["gauge_length_mm"] == 1.6
    assert found["settings"]["forces"].size == 0
    assert list(found["warnings"]) == ["one", "two"]
    assert found["units"]["divergence"] == "1"
    assert "count from 1" in found["about"]


def test_a_linear_field_is_mapped_exactly(result: xr.Dataset) -> None:
    """A linear field is mapped exactly, to the rounding of float32, as interpolation is linear."""
    maps = interpolate_maps(result, "displacement", 0.2)
    assert [*maps.component.values] == ["displacement_x", "displacement_y"]
    x, y = np.meshgrid(maps.x, maps.y)
    truth = np.stack([x, y], -1) @ GRADIENT.T
    for frame in range(FRAMES):
        known = np.isfinite(maps.values[frame, 0])
        # 4 x 3 mm in cells of 0.04 mm^2, without the border that no triangle covers.
        assert 0.8 * 300 < known.sum() <= 336
        np.testing.assert_allclose(maps.values[frame].transpose(1, 2, 0)[known], 1e3 * truth[known], atol=1e-3)


def test_where_no_point_is_near_nothing_is_known(result: xr.Dataset) -> None:
    """Maps are NaN further than half a gauge length, 0.8 mm, from all points; triangles across a wider gap are not
    used.
    """
    cut = result.copy(deep=True)
    cut["divergence"].values[np.abs(result["position"].values[..., 0] - 2) < 1.2] = np.nan
    maps = interpolate_maps(cut, "divergence", 0.1)
    assert np.isnan(maps.values[0][..., np.abs(maps.x - 2) < 0.3]).all()
    assert np.isfinite(maps.values[0][..., np.abs(maps.x - 0.5) < 0.2]).mean() > 0.5


def test_triangles_are_mapped_as_they_lie(result: xr.Dataset) -> None:
    maps = interpolate_maps(result, "strain_energy_density", 0.1)
    x, y = np.meshgrid(maps.x, maps.y)
    drifted = Delaunay(result["position"].values[0])
    found = drifted.find_simplex(np.stack([x, y], -1))
    assert (np.sort(drifted.simplices, 1) == np.sort(result["triangles"].values, 1)).all()
    values = np.where(np.isnan(maps.values[0, 0]), -1, (maps.values[0, 0] / 1e3).round()).astype(int)
    assert (values == found).mean() > 0.999  # a position on a side belongs to either triangle


def test_imagej_reads_scale_and_interval(result: xr.Dataset, tmp_path: Path) -> None:
    export_map(result, tmp_path / "map.tif", "divergence", 0.2)
    export_map(result, tmp_path / "parts.tif", "displacement", 0.2)
    with tifffile.TiffFile(tmp_path / "map.tif") as file:
        assert file.is_imagej
        assert file.series[0].axes == "TYX"
        numerator, denominator = file.pages.first.tags["XResolution"].value
        assert numerator / denominator == pytest.approx(5, rel=1e-6)  # pixels per mm
        about = file.imagej_metadata
        assert about is not None
        assert about["unit"] == "mm"
        assert about["finterval"] == pytest.approx(0.02)
        assert "the first pixel is at x = " in about["Info"]
        np.testing.assert_array_equal(file.asarray(), interpolate_maps(result, "divergence", 0.2).values[:, 0])
    with tifffile.TiffFile(tmp_path / "parts.tif") as file:
        assert file.series[0].axes == "TCYX"
        np.testing.assert_array_equal(file.asarray(), interpolate_maps(result, "displacement", 0.2).values)


def test_a_map_as_a_table(result: xr.Dataset, tmp_path: Path) -> None:
    export_map(result, tmp_path / "map.csv", "divergence", 0.2)
    names, rows = read(tmp_path / "map.csv")
    assert names == ["frame", "time (s)", "x (mm)", "y (mm)", "divergence (µm/mm)"]
    np.testing.assert_allclose(rows[:, 4], 1e3 * (rows[:, 2:4] @ [0.3, -0.2] + 1), atol=1e-3)
    assert set(rows[:, 0]) == {FIRST, FIRST + 1, FIRST + 2}


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda result, folder: export_table(result, folder / "a.csv", "pixel"), "'pixel'.*frame, point, track"),
        (lambda result, folder: export_table(result, folder / "a.csv", "point", ["area"]), "no area.*divergence"),
        (lambda result, folder: export_table(result, folder / "a.csv", "point", ["real_contact_area"]), "of frame"),
        (lambda result, folder: export_table(result, folder / "a.xlsx"), r"\.xlsx"),
        (lambda result, folder: export_table(result, folder / "a.mat", "point"), r"a\.mat: a \.mat file holds"),
        (lambda result, folder: export_map(result, folder / "a.tif", "curl"), "no curl.*process -v curl"),
        (lambda result, folder: export_map(result, folder / "a.tif", "real_contact_area"), "each of frame"),
        (lambda result, folder: export_map(result, folder / "a.tif", "divergence", 0.0), "step of 0 mm"),
        (lambda result, folder: export_map(result, folder / "a.tif", "divergence", 1e-5), "larger one"),
        (lambda result, folder: export_map(result, folder / "a.png", "divergence"), r"\.tif or \.csv, not \.png"),
    ],
)
def test_what_cannot_be_written_is_refused(act: Any, said: str, result: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(FingerflowError, match=said):
        act(result, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_dictionary_has_every_output() -> None:
    entries = {entry["name"]: entry for entry in dictionary()}
    assert set(VARIABLES) <= set(entries)
    assert all(shown_unit(name, variable.units) == variable.shown_unit for name, variable in VARIABLES.items())
    assert all(all(entry[name] for name in ("units", "definition", "equation", "stage")) for entry in entries.values())
    assert entries["divergence"]["stage"] == "deformation"
    assert entries["divergence"]["equation"] == "u_x + v_y, the divergence of the displacement"
    assert "forces.tangential" in entries["load_ratio"]["needs"]


def test_outputs_command() -> None:
    said = CliRunner().invoke(app, ("outputs", "status")).stdout
    assert "status  [1]  (frame, point)  stage tracking" in said
    assert "0 tracked, 1 not_finite" in said
    everything = json.loads(CliRunner().invoke(app, ("outputs", "--json")).stdout)
    assert {one["name"] for one in everything} == {entry["name"] for entry in dictionary()}
    wrong = CliRunner().invoke(app, ("outputs", "colour"))
    assert "no variable is called colour" in str(wrong.exception)
