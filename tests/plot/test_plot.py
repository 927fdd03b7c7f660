"""Tests that the figures of a result show the numbers of that result."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from fingerflow import load_scene, plot, process
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import Scene
from tests.small_trials import SMALL_PRESS, write_small

SIZES = ((2.3, 1.9), (2.0, 1.6))  # semi-axes, mm: two fingers
Trial = tuple[Scene, xr.Dataset]


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    folder = tmp_path_factory.mktemp("presses")
    paths = (write_small(folder / f"{axes[0]}", replace(SMALL_PRESS, semi_axes=axes)) for axes in SIZES)
    return [
        (scene, process(scene, ("normal_force", "median_strain", "strain_rate"))) for scene in map(load_scene, paths)
    ]


def of_time(force: np.ndarray[Any, Any]) -> xr.Dataset:
    """Return a result that has only forces."""
    time = np.arange(len(force)) / 100
    return xr.Dataset(
        {"normal_force": ("frame", force, {"units": "N"})},
        coords={"time": ("frame", time, {"units": "s"}), "frame": np.arange(len(force))},
    )


CURVES: list[tuple[Callable[..., Axes], str, Callable[[xr.Dataset], Any]]] = [
    (plot.contact_area, "gross", lambda one: one["gross_contact_area"]),
    (plot.contact_area, "real", lambda one: one["real_contact_area"]),
    (plot.contact_axes, "semi-minor", lambda one: one["ellipse_semi_axes"][:, 1]),
    (plot.median_divergence, "divergence", lambda one: 1000 * one["median_divergence"]),
    (plot.median_divergence, "curl", lambda one: 1000 * one["median_curl"]),
    (plot.median_strain, "eyy", lambda one: 1e3 * one["median_strain"][:, 1]),
    (plot.displacement, "median displacement", lambda one: 1000 * one["global_displacement"]),
    (plot.strain_energy, "strain energy", lambda one: one["strain_energy"]),
]


@pytest.mark.parametrize(("draw", "label", "expected"), CURVES, ids=[f"{one[0].__name__}-{one[1]}" for one in CURVES])
def test_curves_of_two_recordings_differ_and_are_theirs(
    draw: Callable[..., Axes], label: str, expected: Callable[[xr.Dataset], Any], trials: list[Trial]
) -> None:
    shown = []
    for _, result in trials:
        (line,) = [one for one in draw(result).lines if one.get_label() == label]
        np.testing.assert_array_equal(line.get_ydata(), expected(result).values)
        np.testing.assert_array_equal(line.get_xdata(), result["normal_force"].values)  # the force only rises
        shown.append(np.asarray(line.get_ydata(), dtype=float))
    assert np.isfinite(shown[0]).sum() > 8
    assert np.nanmax(np.abs(shown[0] - shown[1])) > 0.01 * np.nanmax(np.abs(shown[0]))


@pytest.mark.parametrize("quantity", sorted(plot.QUANTITIES))
def test_maps_of_two_recordings_differ_and_are_theirs(quantity: str, trials: list[Trial]) -> None:
    shown = []
    for _, result in trials:
        axes = plot.field_map(result, quantity, 15)
        (mesh,) = [one for one in axes.collections if isinstance(one, PolyCollection) and one.get_array() is not None]
        values = np.asarray(mesh.get_array())
        last = result.isel(frame=15)
        expected = plot.QUANTITIES[quantity].values(last)
        if not plot.QUANTITIES[quantity].triangle_mean:
            expected = expected[result["triangles"].values].mean(1)
        known = np.isfinite(expected) & np.isfinite(last["position"].values[result["triangles"].values]).all((1, 2))
        assert known.sum() > 30
        np.testing.assert_allclose(values, expected[known], rtol=1e-5, atol=1e-4)  # means of float32
        assert mesh.get_clim()[1] == pytest.approx(plot.colour_limit(result, quantity, [15]))
        shown.append(np.sort(values))
    assert len(shown[0]) != len(shown[1]) or np.abs(shown[0] - shown[1]).max() > 0


def test_the_mask_is_what_was_counted(trials: list[Trial]) -> None:
    """The area of the drawn contact mask equals the real contact area of that frame, pixel for pixel; the legend has
    its mean colour.
    """
    for scene, result in trials:
        for frame in (8, 15):
            axes = plot.picture(result, scene, frame)
            picture = axes.images[0].get_array()
            mask = picture[..., 0] != picture[..., 2]  # grey pixels are not in contact
            area = mask.sum() * scene.calibration.mm_per_px**2
            assert area == pytest.approx(float(result["real_contact_area"][frame]), rel=1e-9)
            assert area > 1
            [swatch] = [line.get_color() for line in axes.lines if line.get_label() == "touches"]
            np.testing.assert_allclose(255 * swatch, picture[mask].mean(0), atol=0.5)


def test_the_picture_has_a_scale_bar_of_its_length(trials: list[Trial]) -> None:
    scene, result = trials[0]
    axes = plot.picture(result, scene, 15)
    (bar,) = [line for line in axes.lines if line.get_label() == "_scale bar"]
    (text,) = [one.get_text() for one in axes.texts]
    length = float(np.ptp(np.asarray(bar.get_xdata(), dtype=float))) * scene.calibration.mm_per_px
    assert text == f"{length:g} mm"
    assert "frame 15" in axes.get_title()
    assert {"touches", "gross contact", "points in contact"} <= set(axes.get_legend_handles_labels()[1])
    with pytest.raises(FingerflowError, match="the scene has topography, contact"):
        plot.picture(result, scene, 15, view="camera")
    with pytest.raises(FingerflowError, match="frame 16: the result has 16"):
        plot.picture(result, scene, 16)


def test_what_varies_is_the_axis() -> None:
    time = np.linspace(0, 1, 200)
    noise = np.random.default_rng(0).normal(0, 0.002, 200)
    rises, returns = 5 * time**2 + noise, 5 * np.sin(np.pi * time) + noise
    for force, expected in (
        (rises, "normal_force"),
        (rises[::-1], "normal_force"),
        (returns, "time"),
        (2 + noise, "time"),
        (0.3 * noise, "time"),
        (np.full(200, np.nan), "time"),
    ):
        assert plot.abscissa(of_time(force))[0] == expected
    assert plot.abscissa(of_time(returns), "normal_force")[2] == "normal force (N)"
    with pytest.raises(FingerflowError, match=r"'torque'.*normal_force"):
        plot.abscissa(of_time(rises), "torque")


def test_colours_are_not_those_of_torn_triangles(trials: list[Trial]) -> None:
    """Triangles torn by a strain of 20, one in twenty, do not extend the colour scale beyond three medians."""
    _, result = trials[0]
    torn = result["strain"].copy()
    torn[15, ::20] = 20.0
    middle = np.nanmedian(np.abs(1000 * torn.values[15, :, 0]))
    assert plot.colour_limit(result.assign(strain=torn), "exx", [15]) <= 3 * middle * (1 + 1e-9)


def test_figures_say_which_results_are_unknown_or_absent(trials: list[Trial]) -> None:
    _, result = trials[0]
    empty = result.assign(strain_energy=result["strain_energy"] * np.nan, divergence=result["divergence"] * np.nan)
    assert "not known in any frame" in [one.get_text() for one in plot.strain_energy(empty).texts]
    assert "not known in this frame" in [one.get_text() for one in plot.field_map(empty, "divergence", 15).texts]
    for draw, lacking in ((plot.contact_area, "gross_contact_area"), (plot.strain_energy, "strain_energy")):
        with pytest.raises(FingerflowError, match=f"no {lacking}"):
            draw(result.drop_vars(lacking))
    with pytest.raises(FingerflowError, match="is no map; choose one of divergence"):
        plot.field_map(result, "torsion", 3)
    with pytest.raises(FingerflowError, match="a map of curl needs position, curl"):
        plot.field_map(result.drop_vars("curl"), "curl", 3)
