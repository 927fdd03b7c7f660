"""Tests of the values, ranges and tables that the page reads from a result."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.kernels.arrays import nanmedian
from fingerflow.results.result import load_result
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.view.results import Results


@pytest.fixture(scope="module")
def results(processed: Path) -> Iterator[Results]:
    found = Results(processed / "result.h5")
    yield found
    found.close()


@pytest.fixture(scope="module")
def stored(processed: Path) -> xr.Dataset:
    return load_result(processed / "result.h5")


def test_a_frame_is_what_the_file_has(results: Results, stored: xr.Dataset) -> None:
    for frame in (0, 7):
        numbers, arrays = results.frame(frame, "strain:eyy")
        np.testing.assert_array_equal(arrays["shown"], stored["strain"].values[frame, :, 1].astype(np.float32))
        np.testing.assert_array_equal(arrays["position"], stored["position"].values[frame].astype(np.float32))
        np.testing.assert_array_equal(arrays["status"], stored["status"].values[frame])
        assert numbers["time"] == float(stored["time"][frame])
        np.testing.assert_equal(numbers["gross_contact_area"], stored["gross_contact_area"].values[frame])
        np.testing.assert_equal(numbers["ellipse_center"], stored["ellipse_center"].values[frame])
        area, spread = (float(stored[f"gross_contact_area{of}"][frame]) for of in ("", "_std"))
        assert numbers["text"]["gross_contact_area"] == format_uncertainty(area, spread)
        assert numbers["text"]["frame_status"] == "usable"
        assert not [name for name in numbers["text"] if name.endswith("_std")]
    _, arrays = results.frame(9, "displacement:length")
    expected = np.linalg.norm(stored["displacement"].values[9], axis=-1)
    np.testing.assert_allclose(arrays["shown"], expected, rtol=1e-6)  # sent as float32
    for frame in (-1, 12):
        with pytest.raises(FingerflowError, match=f"frame {frame} is not among the 12"):
            results.frame(frame, None)


def test_everything_that_has_a_place_or_a_course_is_listed(results: Results, stored: xr.Dataset) -> None:
    facts = results.facts()
    maps, curves = {one["key"] for one in facts["maps"]}, {one["key"] for one in facts["curves"]}
    assert {"divergence", "curl", "strain:exx", "displacement:length", "displacement:x", "divergence_std"} <= maps
    assert {"strain_energy_density", "status", "position_std_px", "strain_std:exy"} <= maps
    assert {"principal_strains:major", "principal_angle", "shear:along_axes", "rigid_residual:length"} <= maps
    assert {"normal_force", "median_divergence", "median_strain:exx", "ellipse_semi_axes:major"} <= curves
    for key in maps:
        assert results.frame(5, key)[1]["shown"].shape in ((stored.sizes["point"],), (stored.sizes["triangle"],))
    for key in curves:
        assert results.course(key).shape == (12,)
    assert facts["flags"]["status"][0] == "tracked"
    for wrong in ("nothing", "strain:ezz"):
        with pytest.raises(FingerflowError, match=wrong):
            results.frame(5, wrong)


def test_history_and_medians_of_points(results: Results, stored: xr.Dataset) -> None:
    values = stored["divergence"].values.astype(np.float64)
    np.testing.assert_array_equal(results.point_courses("divergence", [3])[:, 0], values[:, 3])
    points = [9, 2, 5, 6]
    known = np.isfinite(values[:, points]).any(axis=1)
    found = nanmedian(results.point_courses("divergence", points))
    np.testing.assert_allclose(found[known], np.nanmedian(values[known][:, points], axis=1), rtol=1e-12)
    np.testing.assert_array_equal(np.isfinite(found), known)
    for wrong in ([], [10**6], [-1]):
        with pytest.raises(FingerflowError, match="not among"):
            results.point_courses("divergence", wrong)
    with pytest.raises(FingerflowError, match="not of points"):
        results.point_courses("strain:exx", [1])


def test_colours_lie_about_zero_where_values_do(results: Results) -> None:
    low, high = results.value_range("divergence")
    assert low == -high < 0
    low, high = results.value_range("displacement:length")
    assert 0 == low < high


def test_tables_are_what_is_shown(results: Results, stored: xr.Dataset) -> None:
    lines = results.table_of_courses(["normal_force", "median_strain:exy"], [4], "divergence").splitlines()
    assert lines[0] == "frame,time (s),normal_force (N),median_strain:exy (µm/mm),divergence of point 4 (µm/mm)"
    rows = np.genfromtxt(lines, delimiter=",", skip_header=1)
    np.testing.assert_allclose(rows[:, 2], stored["normal_force"].values, rtol=1e-8)
    np.testing.assert_allclose(rows[:, 4], 1e3 * stored["divergence"].values[:, 4], rtol=1e-6)
    rows = np.genfromtxt(results.table_of_frame(8, "curl").splitlines(), delimiter=",", skip_header=1)
    np.testing.assert_allclose(rows[:, 4], 1e3 * stored["curl"].values[8], rtol=1e-6)
    header, *lines = results.table_of_frame(8, "strain:exx").splitlines()
    assert header == "triangle,x (mm),y (mm),strain:exx (µm/mm)"
    assert len(lines) == stored.sizes["triangle"]
