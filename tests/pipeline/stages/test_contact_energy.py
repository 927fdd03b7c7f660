"""Tests of the strain energy of the whole contact against the simulated press: exact displacements, and
stated errors.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from bench.suites.stated import other_presses
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.pipeline.stages.strain import contact_energy
from fingerflow.pipeline.stages.strain.contact_energy import ContactEnergy, FrameEnergies
from fingerflow.pipeline.stages.strain.strain_stage import border_density
from fingerflow.synthetic import Press

PRESS = Press(n_frames=60, frame_rate=60.0)
TWICE = other_presses()["twice the deformation"]
WINDOW_MM, SPACING_MM, DRAWS = 0.8, 0.33, 100
Array = NDArray[np.float64]


class Contact(NamedTuple):
    """A frame of a press: its border, N points (N, 2) mm with displacements (N, 2) mm, and the energy per
    mm of depth.
    """

    border: FrameEllipse
    position: Array
    displacement: Array
    energy: float


def contact_of(press: Press, frame: int, measure: str = "green_lagrange") -> Contact:
    """Return a frame of a press, its energy integrated by Gauss quadrature in rings, which with half as many nodes
    changes by 1e-4.
    """
    ellipse = press.truth.ellipse(frame)
    assert ellipse is not None
    nodes, shares = np.polynomial.legendre.leggauss(24)
    turns = 2 * np.pi * np.arange(48) / 48
    disc = np.sqrt((nodes[:, None] + 1) / 2)[..., None] * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
    cosine, sine = np.cos(ellipse.angle), np.sin(ellipse.angle)
    onto = np.array(ellipse.semi_axes)[:, None] * np.array([[cosine, sine], [-sine, cosine]])
    gradient = press.truth.gradient(press.truth.material(disc.reshape(-1, 2) @ onto + ellipse.centre, frame), frame)
    density = strain_energy_density(green_lagrange(torch.from_numpy(gradient), measure)).numpy()
    each = (density / np.linalg.det(np.eye(2) + gradient)).reshape(disc.shape[:2])
    axis = np.arange(-7, 7, SPACING_MM)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid + 0.1 * np.random.default_rng(3).uniform(-1, 1, grid.shape) + ellipse.centre
    position = grid[(ellipse.distance(*torch.from_numpy(grid).unbind(-1)) > 0.1).numpy()]
    border = FrameEllipse(*(np.array([one]) for one in (ellipse.centre, ellipse.semi_axes, ellipse.angle)))
    displacement = press.truth.displacement(press.truth.material(position, frame), frame)
    return Contact(border, position, displacement, float(ellipse.area * (shares / 2 @ each.mean(1))))


def measured(
    contact: Contact,
    displacement: Array,
    std_mm: float | Array,
    shared: Any = None,
    measure: str = "green_lagrange",
    since_growth: Array | None = None,
) -> FrameEnergies:
    """Return the energy estimated from displacements with these standard deviations and the correlations
    `shared` (N, N); `since_growth` (N, 2) mm is the motion since the border stopped, that beside an advancing border
    by default.
    """
    points = len(contact.position)
    whole = ContactEnergy(measure, (1.0, 0.4), np.eye(points) if shared is None else shared)
    variance = np.broadcast_to(np.square(std_mm), (1, points))
    moved = 0.1 * displacement if since_growth is None else since_growth
    known = contact.position[None], displacement[None], variance, np.ones((1, points), bool), contact.border
    return whole.estimate(np.zeros(1, int), *known, lambda frames: moved[None])


@pytest.mark.parametrize("measure", ["green_lagrange", "infinitesimal"])
@pytest.mark.parametrize(("press", "frame"), [(PRESS, 18), (PRESS, 40), (TWICE, 40), (TWICE, 58)])
def test_energy_of_exact_displacements(press: Press, frame: int, measure: str) -> None:
    """The energy of exact displacements is found to 0.5 %: polynomials of degree 10 represent a field with Gaussian
    bumps and strains of 12 and 24 %.

    No point lies within 0.1 mm of the border, where the skin has 25 to 50 % of the energy.
    """
    contact = contact_of(press, frame, measure)
    assert measured(contact, contact.displacement, 1e-5, measure=measure).energy[0] == pytest.approx(
        contact.energy, rel=5e-3
    )


@pytest.mark.parametrize("frame", [20, 30, 50])
def test_deviation_is_true_by_coverage(frame: int) -> None:
    """The stated deviation is right: 68 and 95 % of the draws lie within one and two deviations, to three standard
    deviations of these shares.

    Errors are those of points, correlated by the overlap of windows, of the border, and common to all points. The
    border is varied by scaling both axes.
    """
    contact, random = contact_of(PRESS, frame), np.random.default_rng(frame)
    apart = [cdist(one, one) / WINDOW_MM for one in np.split(contact.position, 2, axis=1)]
    shared = np.clip(1 - apart[0], 0, 1) * np.clip(1 - apart[1], 0, 1)
    root = np.linalg.cholesky(shared + 1e-9 * np.eye(len(shared)))
    deviation, step = 7e-4, contact_energy._RADIUS_MM
    size = np.sqrt(np.mean(contact.displacement**2))
    z, ratios = [], []
    for _ in range(DRAWS):
        noise = deviation * root @ random.standard_normal(contact.displacement.shape)
        moved = contact.displacement * (1 + 4e-4 / size * random.standard_normal()) + noise
        border = contact.border._replace(semi_axes=contact.border.semi_axes + step * random.standard_normal())
        found = measured(contact._replace(border=border), moved, deviation, csr_array(shared))
        z.append((found.energy[0] - contact.energy) / found.deviation[0])
        ratios.append(found.energy[0] / contact.energy)
    assert np.mean(ratios) == pytest.approx(1, abs=0.04)
    assert 0.58 < np.mean(np.abs(z) < 1) < 0.80
    assert 0.90 < np.mean(np.abs(z) < 2) <= 1.0


def test_displacement_that_noise_hides_leaves_the_energy_uncertain() -> None:
    """Where noise is 12 times the displacement, a twentieth of the draws or fewer errs by two deviations."""
    contact, random = contact_of(PRESS, 40), np.random.default_rng(0)
    draws = (measured(contact, random.normal(1e-3 * contact.displacement, 7e-4), 7e-4) for _ in range(40))
    assert np.mean([abs(found.energy - 1e-6 * contact.energy) < 2 * found.deviation for found in draws]) >= 0.95


def test_a_field_far_from_all_points_is_uncertain() -> None:
    """The deviation of the energy holds what the field has far from all points: the ellipse ends 1 mm too far out on
    one side, as if something beside the contact belonged to it.
    """
    contact = contact_of(PRESS, 58)
    along = np.array([np.cos(contact.border.angle[0]), np.sin(contact.border.angle[0])])
    axes = contact.border.semi_axes
    border = contact.border._replace(center=contact.border.center + 0.1 * axes[0, 0] * along, semi_axes=axes * (1.1, 1))
    noise = np.random.default_rng(0).normal(0, 1e-3, contact.displacement.shape)
    found = measured(contact._replace(border=border), contact.displacement + noise, 1e-3)
    assert np.isnan(found.energy[0]) or abs(found.energy[0] - contact.energy) < 3 * found.deviation[0]


@pytest.mark.parametrize("turn", [0.0, 0.02])
def test_skin_that_has_moved_at_a_border_at_rest(turn: float) -> None:
    """Once the border has stopped, all skin moves by 0.1 mm and turns by 20 mrad, which stores no energy: that of the
    growth is found to a twentieth. No smooth field that vanishes at the border explains such displacements.
    """
    contact = contact_of(PRESS, 40)
    right, down = (contact.position - contact.border.center).T
    motion = np.array([0.1, 0.0]) + turn * np.stack((-down, right), axis=1)
    moved = contact.displacement + motion
    found = measured(contact, moved, 1e-4, measure="infinitesimal", since_growth=motion)
    assert found.moves.all()
    assert found.energy[0] == pytest.approx(contact_of(PRESS, 40, "infinitesimal").energy, rel=0.05)
    unexplained = measured(contact, moved, 1e-4, measure="infinitesimal")
    assert np.isnan(unexplained.energy) == (unexplained.trust == 0) == np.True_


def test_a_border_that_advances_in_every_frame_may_have_stopped() -> None:
    """Where frames are too far apart to show whether the border has stopped, both fields count: the energy is their
    mean, and its deviation holds the truth.
    """
    contact = contact_of(PRESS, 40)
    moved = contact.displacement + np.array([0.02, 0.0])
    found = measured(contact, moved, 7e-4, since_growth=np.zeros_like(moved))
    assert not found.moves.any()
    assert abs(found.energy[0] - contact.energy) < 2 * found.deviation[0]


@pytest.mark.parametrize("std_mm", [0.0, 1e-18, 1e-7])
def test_point_at_its_onset_leaves_the_energy_unchanged(std_mm: float) -> None:
    """A point that has just touched, whose displacement has no error or one by rounding alone, changes the energy by
    less than its deviation.
    """
    contact = contact_of(PRESS, 30)
    moved, std = contact.displacement.copy(), np.full(len(contact.position), 7e-4)
    known = measured(contact, moved, std)
    last = int(contact.border.inside(contact.position[None])[0].argmin())
    moved[last], std[last] = 0, std_mm
    found = measured(contact, moved, std)
    assert abs(found.energy[0] - known.energy[0]) < known.deviation[0]
    assert found.deviation[0] == pytest.approx(known.deviation[0], rel=0.2)


def test_the_rim_is_unknown_where_no_triangle_lies_near_it() -> None:
    """The density at the border is that of the triangles in reach, and NaN, not 0, without one of known strain."""
    border = FrameEllipse(np.zeros((3, 2)), np.full((3, 2), 4.0), np.zeros(3))
    positions = np.tile([[3.5, 0.0], [0.0, 1.0]], (3, 1, 1))
    density = np.array([[2.0, 1.0], [np.nan, 1.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(border_density(density, np.ones(2), positions, border, 0.8), [2, np.nan, np.nan])
