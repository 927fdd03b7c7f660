"""Tests of the models that figures of Willemet et al. 2021 show: artists hold the numbers of closed forms and chain."""

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from bench.papers import half_sphere, receptors
from bench.papers.chain import (
    HIGH,
    LOW,
    SimulatedPresses,
    draw_fastest_point,
    draw_largest_displacement,
    simulate_presses,
)
from bench.papers.chain_movie import movie_pictures
from bench.papers.decomposition import PARTS, decompose, draw_decomposition
from bench.papers.tribometer import draw_friction, simulate_trace
from fingerflow.models.half_space import stress
from fingerflow.models.skin_chain import CONTACT_N
from fingerflow.models.skin_onset import since_onset
from fingerflow.plot.axes_style import GREY


@pytest.fixture(scope="module")
def simulated() -> SimulatedPresses:
    return simulate_presses((0.02, LOW, HIGH), times=41, elements=251)


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
    assert np.hypot(np.diff(x), np.diff(z)).sum() == pytest.approx(15.9, abs=0.05)
    long, short = (axes[1].lines[k].get_ydata()[1:] for k in (0, 1))
    np.testing.assert_allclose(axes[2].lines[0].get_ydata()[1:], 100 * (long - short) / long, rtol=1e-8)


def test_a_linear_field_is_decomposed_exactly_and_drawn_in_one_scale() -> None:
    """Constant, divergence, curl and shears are those of the gradient, also where some points are not known."""
    points = np.random.default_rng(0).uniform((5, 3), (15, 12), (300, 2))
    moved = (points - points[5:].mean(0)) @ np.array([[0.03, -0.012], [0.02, 0.01]]).T + (0.1, -0.05)
    moved[:5] = np.nan
    found = decompose(points, moved)
    assert found.constant == pytest.approx((0.1, -0.05))
    assert (found.divergence, found.curl, *found.shear) == pytest.approx((0.04, 0.032, 0.02, 0.008))
    np.testing.assert_allclose(sum(found.parts[name] for name in PARTS[1:]), moved, atol=1e-14)
    figure = Figure(layout="constrained")
    draw_decomposition(figure.add_subfigure(figure.add_gridspec(1, 1)[0]), decompose(points[5:], moved[5:]))
    figure.draw_without_rendering()
    axes = figure.axes[: len(PARTS)]
    assert [one.get_title().partition("\n")[0] for one in axes] == list(PARTS)
    assert "40.0 µm/mm" in axes[2].get_title()
    arrows = [np.stack((one.collections[0].U, one.collections[0].V), 1) for one in axes]
    np.testing.assert_allclose(sum(arrows[1:]), arrows[0], atol=1e-9)
    np.testing.assert_allclose(arrows[0], float(axes[0].get_title().split()[-2]) * moved[5:])


def test_the_trace_of_the_tribometer_has_the_friction_of_its_law() -> None:
    """Friction of 0.9 - 0.2 amplitude / um comes back to 0.005 from forces with noise, as the amplitude rises."""
    trace = simulate_trace(lambda amplitude: 0.9 - 0.2 * amplitude, 3.0)
    assert trace.normal.mean() == pytest.approx(0.5, rel=0.02)
    assert (trace.position.max(), trace.amplitude.max()) == pytest.approx((0.1, 3e-6), rel=1e-3)
    axes = Figure().subplots()
    draw_friction(axes, trace.epochs)
    assert sum(line.get_color() == GREY for line in axes.lines) == len(trace.epochs.start) > 10
    whole = next(line for line in axes.lines if line.get_marker() == "o")
    x, y = (np.asarray(values, dtype=float) for values in whole.get_data())
    np.testing.assert_allclose(y, 0.9 - 0.2 * x, atol=0.005)


def test_panels_of_the_chain_are_its_motion(simulated: SimulatedPresses) -> None:
    speed, largest = Figure().subplots(1, 2)
    draw_fastest_point(speed, simulated)
    draw_largest_displacement(largest, simulated)
    heights = [patch.get_height() for patch in largest.patches]
    touching = simulated.chain.normal_force[-1] > CONTACT_N
    np.testing.assert_allclose(heights, (1e3 * simulated.chain.displacement[-1, ..., 0].abs() * touching).amax(-1))
    assert heights[0] > heights[1] > heights[2]
    values = np.asarray(speed.lines[0].get_ydata())
    known = np.isfinite(values)
    assert np.trapezoid(values[known], simulated.time[known]) == pytest.approx(heights[0], rel=0.2)


def test_stress_and_strain_at_depth(simulated: SimulatedPresses) -> None:
    depth = receptors.compute_strains_at_depth(simulated, places=21, depths=10)
    edges, pressure, traction = (load[-1] for load in simulated.chain.strips())
    expected = stress(1e-3 * torch.from_numpy(depth.place), 2e-3, edges, pressure, traction)
    np.testing.assert_allclose(depth.receptor_stress[1], 1e-3 * expected.sigma_z)
    peak = expected.sigma_z.amin(-1)
    # All skin sticks at a friction of 0.2 already: friction adds to the stress only relative to a slippery contact.
    assert float(peak[2] / peak[1]) == pytest.approx(1.001, abs=0.003)
    assert float(peak[2] / peak[0]) == pytest.approx(1.165, abs=0.02)
    part = Figure(layout="constrained").subfigures(1, 1)
    receptors.draw_receptor_stress(part, simulated, depth)
    ratios = f"over 0.2: {peak[2] / peak[1]:.3f}, over 0.02: {peak[2] / peak[0]:.3f}, in print"
    assert ratios in part.axes[0].get_title()
    # A contact wider than 1.6 depths compresses the middle along the surface too, unlike figure S10 E.
    assert depth.strain_y[-1, 2, 10] < 0
    assert (depth.strain_z[-1, :, 10] < 0).all()


def test_numbers_of_the_page_on_models(simulated: SimulatedPresses) -> None:
    """Numbers of docs/methods/models.md agree with a chain of 251 elements, which is within 10 % of the page's 1001
    elements. The energy of an even stretch is its formula.
    """
    area = np.pi / 4 * (1e3 * simulated.chain.contact_length[-1].numpy()) ** 2
    np.testing.assert_allclose(area, [70.9, 67.8, 67.5], rtol=0.04)
    traction = (simulated.chain.traction[-1].abs().sum(-1) / simulated.chain.pressure[-1].sum(-1)).numpy()
    np.testing.assert_allclose(traction, [0.020, 0.115, 0.121], rtol=0.05)
    np.testing.assert_allclose(simulated.energy()[-1, 1:], [0.110, 0.031], rtol=0.25)
    divergence = since_onset(simulated.chain).area_median[-1].numpy()
    assert divergence[1] == pytest.approx(0.013, abs=0.002)
    assert abs(divergence[2]) < 0.001


def test_the_movie_has_a_picture_a_time() -> None:
    pictures = list(movie_pictures(simulate_presses((LOW, HIGH), times=4, elements=101), 2))
    assert len(pictures) == 2
    assert pictures[0].dtype == np.uint8
    assert not np.array_equal(pictures[0], pictures[-1])
