"""Tests of figures S4, S5 K, S8 to S10 and the movie: artists hold the numbers of the models."""

from pathlib import Path

import av
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure, SubFigure

from fingerflow.models.half_space import stress
from fingerflow.models.skin_chain import CONTACT_N
from fingerflow.models.skin_onset import since_onset
from fingerflow.report import half_sphere, strains_at_depth
from fingerflow.report import simulated_presses as presses
from fingerflow.report.model_movie import movie_pictures, write_movie
from fingerflow.report.simulated_presses import HIGH, LOW, SimulatedPresses, simulate_presses


@pytest.fixture(scope="module")
def simulated() -> SimulatedPresses:
    return simulate_presses((0.02, LOW, HIGH), times=41, elements=251)


@pytest.fixture
def part() -> SubFigure:
    figure = Figure(layout="constrained")
    return figure.add_subfigure(figure.add_gridspec(1, 1)[0])


def test_the_half_sphere() -> None:
    axes = Figure().subplots(1, 3)
    half_sphere.draw_half_sphere(axes[0])
    half_sphere.draw_lengths(axes[1])
    half_sphere.draw_radial_strain(axes[2])
    assert {text.get_text() for text in axes[0].get_legend().get_texts()} == {"2 L = 15.9 mm", "2 a = 14.3 mm"}
    arc, contact = axes[0].lines[2], axes[0].lines[3]
    x, z = arc.get_data()
    np.testing.assert_allclose([x[0], x[-1]], contact.get_xdata(), atol=1e-12)
    np.testing.assert_allclose([z[0], z[-1], z.min()], [0, 0, -3], atol=1e-12)
    length = np.hypot(np.diff(x), np.diff(z)).sum()
    assert length == pytest.approx(15.9, abs=0.05)
    at, long = axes[1].lines[0].get_data()
    short = axes[1].lines[1].get_ydata()
    compressed = 100 * (long[1:] - short[1:]) / long[1:]
    np.testing.assert_allclose(axes[2].lines[0].get_ydata()[1:], compressed, rtol=1e-8)
    assert axes[2].lines[1].get_ydata()[0] == pytest.approx(np.interp(3, at[1:], compressed), abs=1e-3)


def test_strains_grow_with_force_and_fall_with_friction(simulated: SimulatedPresses, part: SubFigure) -> None:
    radial, hoop = presses.draw_strain_series(part, simulated)
    for one in (radial, hoop):
        assert [line.get_label() for line in one.lines] == ["friction 0.02", "friction 0.2", "friction 1"]
        ends = [line.get_ydata()[-1] for line in one.lines]
        assert ends[0] > ends[1] > ends[2] > 0
        assert one.lines[0].get_xdata()[-1] == 3.0
    # Where the skin sticks, both strains together are about the median divergence of the chain.
    both = radial.lines[2].get_ydata()[-1] + hoop.lines[2].get_ydata()[-1]
    assert both == pytest.approx(100 * float(simulated.chain.divergence[-1, 2]), rel=0.1)


def test_rates_are_slopes_of_the_series(simulated: SimulatedPresses) -> None:
    figure = Figure()
    series, rates = figure.subplots(1, 2)
    presses.draw_energy_series(series, simulated)
    presses.draw_energy_series(rates, simulated, rate=True)
    for line, rate in zip(series.lines, rates.lines, strict=True):
        known = np.isfinite(rate.get_ydata())
        assert known.sum() == 41 - 2 * 2
        gained = np.trapezoid(np.asarray(rate.get_ydata())[known], simulated.time[known])
        assert gained == pytest.approx(line.get_ydata()[-3] - line.get_ydata()[2], rel=0.05)
    assert series.lines[0].get_ydata()[-1] > series.lines[-1].get_ydata()[-1] > 0


def test_the_energy_of_an_even_stretch_is_its_formula(simulated: SimulatedPresses) -> None:
    strain = 0.01
    assert presses._density(np.array(strain), np.array(strain)) == pytest.approx(  # plane strain, E = 1 MPa, nu = 0.4
        1 / (1.4 * 0.2) * (0.6 / 2 * 2 + 0.4) * (strain + strain**2 / 2) ** 2
    )
    found = simulated.profile()
    radius = found.radius[-1, :, -1]
    np.testing.assert_allclose(2e-3 * radius, simulated.chain.contact_length[-1], rtol=1e-12)
    density = presses._density(found.radial[-1], found.hoop[-1])
    assert (simulated.energy()[-1] < 2 * np.pi * radius**2 * density.max(-1)).all()


def test_maps_are_the_chain_turned_about_its_axis(simulated: SimulatedPresses, part: SubFigure) -> None:
    axes = presses.draw_strain_maps(part, simulated)
    xx, yy, xy = (one.images[0].get_array() for one in axes[1])
    np.testing.assert_allclose(np.ma.filled(xx, np.nan), np.ma.filled(yy, np.nan).T, atol=1e-12)
    middle = xx.shape[0] // 2
    assert abs(xy[middle, middle]) < 1e-12
    radial = simulated.profile().radial[-1, simulated.index(HIGH), 0]
    assert xx[middle, middle] == pytest.approx(100 * (radial + radial**2 / 2), rel=0.02)
    assert np.ma.filled(xx, np.nan)[0, 0] != xx[middle, middle]
    limits = {one.images[0].get_clim() for one in axes.flat}
    assert len(limits) == 1
    assert "friction 0.2" in axes[0, 0].get_title()


def test_energy_maps_share_their_scale(simulated: SimulatedPresses, part: SubFigure) -> None:
    axes = presses.draw_energy_maps(part, simulated)
    low, high = (one.images[0] for one in axes)
    assert low.get_clim() == high.get_clim()
    assert low.get_array().max() > high.get_array().max()


def test_the_furthest_point(simulated: SimulatedPresses) -> None:
    speed, largest = Figure().subplots(1, 2)
    presses.draw_fastest_point(speed, simulated)
    presses.draw_largest_displacement(largest, simulated)
    heights = [patch.get_height() for patch in largest.patches]
    touching = simulated.chain.normal_force[-1] > CONTACT_N
    moved = 1e3 * simulated.chain.displacement[-1, ..., 0].abs() * touching
    np.testing.assert_allclose(heights, moved.amax(-1))
    assert heights[0] > heights[1] > heights[2]
    line = speed.lines[0]
    known = np.isfinite(line.get_ydata())
    assert np.trapezoid(np.asarray(line.get_ydata())[known], simulated.time[known]) == pytest.approx(
        heights[0], rel=0.2
    )


def test_stress_and_strain_at_depth(simulated: SimulatedPresses) -> None:
    depth = strains_at_depth.compute_strains_at_depth(simulated, places=21, depths=10)
    edges, pressure, traction = (load[-1] for load in simulated.chain.strips())
    place = 1e-3 * torch.from_numpy(depth.place)
    expected = stress(place, 2e-3, edges, pressure, traction)
    np.testing.assert_allclose(depth.receptor_stress[1], 1e-3 * expected.sigma_z)
    parts = list(Figure(layout="constrained").subfigures(2, 3).flat)
    strains_at_depth.draw_evolution(parts[0], simulated)
    surface = strains_at_depth.draw_surface(parts[1], simulated)
    maps = strains_at_depth.draw_stress_map(parts[2], simulated, depth)
    receptor = strains_at_depth.draw_receptor_stress(parts[3], simulated, depth)
    over_time = strains_at_depth.draw_strain_in_time(parts[4], simulated, depth)
    compression = strains_at_depth.draw_compression(parts[5].subplots(), simulated, depth)
    assert np.max(surface[0].lines[2].get_ydata()) == pytest.approx(1e-3 * float(pressure[2].max()))
    assert [np.unique(line.get_ydata()).tolist() for line in maps[0].lines] == [[1.2], [2.0]]
    peak = expected.sigma_z.amin(-1)
    # All skin sticks at a friction of 0.2 already: friction adds to the stress only relative to a slippery contact.
    assert float(peak[2] / peak[1]) == pytest.approx(1.001, abs=0.003)
    assert float(peak[2] / peak[0]) == pytest.approx(1.165, abs=0.02)
    assert f"over 0.2: {peak[2] / peak[1]:.3f}, over 0.02: {peak[2] / peak[0]:.3f}, in print" in receptor[0].get_title()
    # A contact wider than 1.6 depths compresses the middle along the surface too, unlike figure S10 E.
    values = over_time.collections[0].get_array()[-1]
    assert values[10] < 0
    ends = [line.get_ydata()[-1] for line in compression.lines]
    assert f"{ends[2] / ends[1]:.3f}" in compression.get_title()
    assert all(end > 0 for end in ends)


def test_numbers_of_the_page_on_models(simulated: SimulatedPresses) -> None:
    """Numbers of docs/methods/models.md agree with a chain of 251 elements, which is within 10 % of the page's 1001
    elements.
    """
    area = np.pi / 4 * (1e3 * simulated.chain.contact_length[-1].numpy()) ** 2
    np.testing.assert_allclose(area, [70.9, 67.8, 67.5], rtol=0.04)
    traction = (simulated.chain.traction[-1].abs().sum(-1) / simulated.chain.pressure[-1].sum(-1)).numpy()
    np.testing.assert_allclose(traction, [0.020, 0.115, 0.121], rtol=0.05)
    np.testing.assert_allclose(simulated.energy()[-1, 1:], [0.110, 0.031], rtol=0.25)
    divergence = since_onset(simulated.chain).area_median[-1].numpy()
    assert divergence[1] == pytest.approx(0.013, abs=0.002)
    assert abs(divergence[2]) < 0.001


def test_the_movie_has_a_picture_a_time(simulated: SimulatedPresses, tmp_path: Path) -> None:
    few = simulate_presses((LOW, HIGH), times=4, elements=101)
    pictures = list(movie_pictures(few))
    assert len(pictures) == 4
    assert pictures[0].dtype == np.uint8
    assert not np.array_equal(pictures[0], pictures[-1])
    path = write_movie(few, tmp_path / "new" / "M3.mp4", progress=False)
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    assert len(frames) == 24
    assert (frames[0].height, frames[0].width) == pictures[0].shape[:2]
    assert [name.name for name in path.parent.iterdir()] == ["M3.mp4"]
