"""Tests of the truth against independent evidence: finite differences, pixel counts, and the rendered images."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from fingerflow.synthetic import Bump, Ellipse, PartialSlip, Press, Slide, SyntheticScene
from fingerflow.synthetic.optics import OUTLINE_WIDTH, RIDGE_LEVEL, SKIN_LEVEL, grazing, stray

Array = NDArray[np.float64]

SCENES = [Press(), Slide(), PartialSlip()]
ANY_SCENE = pytest.mark.parametrize("scene", SCENES, ids=["press", "slide", "partial slip"])
LAST = 299


def inside(scene: SyntheticScene, frame: int, count: int, share: float = 1.0) -> Array:
    """Return random positions (count, 2) in mm, uniform over the gross contact with its axes scaled by `share`."""
    ellipse = scene.truth.ellipse(frame)
    assert ellipse is not None
    generator = np.random.default_rng(frame)
    radius, angle = share * np.sqrt(generator.random(count)), 2 * math.pi * generator.random(count)
    along, across = radius * np.cos(angle) * ellipse.semi_axes[0], radius * np.sin(angle) * ellipse.semi_axes[1]
    cosine, sine = math.cos(ellipse.angle), math.sin(ellipse.angle)
    return np.stack((cosine * along - sine * across, sine * along + cosine * across), axis=-1) + ellipse.centre


def field_of_view(scene: SyntheticScene) -> Array:
    rows, columns = scene.views["contact"].shape
    y, x = np.meshgrid(np.linspace(-10, rows + 10, 60), np.linspace(-10, columns + 20, 70), indexing="ij")
    return np.stack((x, y), axis=-1) * scene.mm_per_px


@ANY_SCENE
@pytest.mark.parametrize("frame", [0, LAST])
def test_forward_map_inverts_the_inverse_map(scene: SyntheticScene, frame: int) -> None:
    positions = field_of_view(scene)
    found = scene.truth.positions(scene.truth.material(positions, frame), frame)
    # Newton ends at 1e-13 mm; det F is under 2.
    np.testing.assert_allclose(found, positions, rtol=0, atol=1e-12)


@ANY_SCENE
def test_onset_frame_is_the_first_inside(scene: SyntheticScene) -> None:
    truth = scene.truth
    for frame in (60, 140, LAST):
        material = truth.material(inside(scene, frame, 40), frame)
        onset = truth.onset_frame(material)
        assert (onset <= frame).all()
        for point, first in zip(material, onset, strict=True):
            ellipse, before = truth.ellipse(first), truth.ellipse(max(first - 1, 0))
            assert ellipse is not None
            assert relative_radius(ellipse, truth.positions(point, first)) <= 1
            if first > 0 and before is not None:
                assert relative_radius(before, truth.positions(point, first - 1)) > 1


def relative_radius(ellipse: Ellipse, position: Array) -> float:
    """Return the relative radius of a position in an ellipse, in NumPy, by rotation into the ellipse's axes."""
    principal = complex(*(position - np.array(ellipse.centre))) * np.exp(-1j * ellipse.angle)
    return math.hypot(principal.real / ellipse.semi_axes[0], principal.imag / ellipse.semi_axes[1])


@pytest.mark.parametrize(("scene", "frame"), [(SCENES[0], LAST), (SCENES[1], 120)])
def test_gradient_equals_finite_differences(scene: SyntheticScene, frame: int) -> None:
    truth = scene.truth
    material = truth.material(inside(scene, frame, 200, share=0.97), frame)
    step = 1e-4
    displacements, places = [], []
    for direction in np.eye(2):
        pair = [truth.displacement(material + sign * step * direction, frame) for sign in (1, -1)]
        now = [truth.positions(material + sign * step * direction, frame) for sign in (1, -1)]
        displacements.append((pair[0] - pair[1]) / (2 * step))
        places.append(((now[0] - pair[0]) - (now[1] - pair[1])) / (2 * step))
    by_material, place_by_material = np.stack(displacements, axis=-1), np.stack(places, axis=-1)
    gradient = truth.gradient(material, frame)
    # Skin that crossed the edge of a contact at rest has its onset positions on one line.
    defined = ~np.isnan(gradient).any(axis=(-1, -2))
    assert np.array_equal(defined, np.abs(np.linalg.det(place_by_material)) > 1e-6)
    assert defined.mean() > 0.9
    expected = by_material[defined] @ np.linalg.inv(place_by_material[defined])
    errors = np.abs(gradient[defined] - expected).max(axis=(-1, -2))
    # Truncation is step² times a third derivative of order 1 1/mm², cancellation 1e-12 / step: both near 1e-8. The
    # slide has a kink of its gradient on the edge of the stick region, which a pair of neighbours may straddle.
    assert np.quantile(errors, 0.98) < 2e-7
    assert errors.max() < (2e-7 if isinstance(scene, Press) else 1e-3)


@ANY_SCENE
def test_medians_are_those_of_any_dense_sample(scene: SyntheticScene) -> None:
    truth, frame = scene.truth, 200
    material = truth.material(inside(scene, frame, 6000), frame)
    gradient, displacement = truth.gradient(material, frame), truth.displacement(material, frame)
    deformation = gradient + np.eye(2)
    strain = (np.swapaxes(deformation, -1, -2) @ deformation - np.eye(2)) / 2
    curl = gradient[:, 1, 0] - gradient[:, 0, 1]
    expected = [np.trace(gradient, axis1=-2, axis2=-1), curl, strain[:, 0, 0], strain[:, 1, 1], strain[:, 0, 1]]
    found = truth.medians(frame)
    measured = [found.divergence, found.curl, found.exx, found.eyy, found.exy]
    for value, sample in zip(measured, expected, strict=True):
        # Four standard errors of the median of 6000 draws, 1.25 sigma / sqrt(n), sigma from the quartiles.
        quartiles = np.nanquantile(sample, [0.25, 0.75])
        assert value == pytest.approx(np.nanmedian(sample), abs=4 * 1.25 * np.ptp(quartiles) / 1.35 / math.sqrt(6000))
    np.testing.assert_allclose(
        [found.displacement_x, found.displacement_y], np.median(displacement, axis=0), rtol=0, atol=0.005
    )


def test_before_contact_and_without_contact_there_is_no_displacement() -> None:
    truth = SCENES[0].truth
    assert truth.ellipse(3) is None
    assert truth.gross_contact_area_mm2(3) == 0 == truth.real_contact_area_mm2(3)
    assert not truth.contact_mask(3).any()
    assert math.isnan(truth.medians(3).divergence)
    never = np.array([[1.0, 1.0]])
    assert truth.onset_frame(never) == [-1]

    late = truth.material(inside(SCENES[0], LAST, 50), LAST)
    late = late[truth.onset_frame(late) > 100]
    for points, frame in ((never, LAST), (late, 100)):
        assert np.isnan(truth.displacement(points, frame)).all()
        assert np.isnan(truth.gradient(points, frame)).all()
    assert not np.isnan(truth.displacement(late, LAST)).any()


@pytest.mark.parametrize("scene", [Slide(), PartialSlip(), PartialSlip(static_friction=0.6, kinetic_friction=0.8)])
@pytest.mark.parametrize("frame", [40, 150, 220])
def test_slow_share_is_the_share_of_slow_skin(scene: Slide, frame: int) -> None:
    positions = inside(scene, frame, 20000)
    moved = np.linalg.norm(positions - scene.truth.material(positions, frame), axis=-1)
    for limit in (0.04, 0.01):
        # Four standard errors of a share of 20 000 draws.
        assert np.mean(moved < limit) == pytest.approx(scene.slow_share(frame, limit), abs=0.015)


def test_a_folding_press_is_refused() -> None:
    scene = Press(bumps=(Bump(centre=(0.0, 0.0), width=1.0, dilation=1.5),))
    with pytest.raises(ValueError, match="make the displacement smaller"):
        scene.truth.positions(inside(scene, LAST, 500), LAST)


@ANY_SCENE
def test_areas_equal_pixel_counts(scene: SyntheticScene) -> None:
    truth, pixel = scene.truth, scene.mm_per_px**2
    for frame in (100, LAST):
        ellipse = truth.ellipse(frame)
        assert ellipse is not None
        assert truth.gross_contact_area_mm2(frame) == pytest.approx(math.pi * math.prod(ellipse.semi_axes))
        area = truth.real_contact_area_mm2(frame)
        # Some 20 ridges cross the edge, so pixel counts are less accurate than for a smooth ellipse.
        assert truth.contact_mask(frame).sum() * pixel == pytest.approx(area, rel=5e-3)
        assert area == pytest.approx(0.5 * ellipse.area, rel=0.05)


@ANY_SCENE
def test_picture_shows_the_material_where_the_truth_says(scene: SyntheticScene) -> None:
    """The topography without light and outline equals the texture at the true material position of each pixel."""
    frame = 220
    picture = scene.views["topography"].crop(scene.render_clean(frame, dtype=torch.float64))
    generator = np.random.default_rng(0)
    pixels = np.stack((generator.integers(250, 400, 300), generator.integers(150, 350, 300)), axis=-1)
    positions = scene.truth.topography_positions(pixels)
    material = torch.from_numpy(scene.truth.material(positions, frame))
    size = 640 * scene.mm_per_px, 512 * scene.mm_per_px
    x, y = torch.from_numpy(positions).unbind(-1)
    outline = Ellipse(scene.contact_centre, scene.finger).distance(material[:, 0], material[:, 1])
    lit = grazing(x, y, *size) * torch.sigmoid(outline / OUTLINE_WIDTH)
    seen = (torch.from_numpy(picture[pixels[:, 1], pixels[:, 0]]) - scene.camera.dark - stray(x, y, *size)) / lit
    expected = SKIN_LEVEL + RIDGE_LEVEL * scene.skin(material[:, 0], material[:, 1])
    # 1e-9 grey levels: rounding of float64 only.
    torch.testing.assert_close(seen, expected, rtol=0, atol=1e-9)


@ANY_SCENE
def test_half_level_of_the_picture_is_the_edge_of_the_contact(scene: SyntheticScene) -> None:
    frame = 180
    view = scene.views["contact"]
    quotient = view.crop(scene.render_clean(frame, dtype=torch.float64) - scene.camera.dark) / view.crop(
        scene.empty_clean(dtype=torch.float64) - scene.camera.dark
    )
    ellipse = scene.truth.ellipse(frame)
    assert ellipse is not None
    y, x = (torch.from_numpy(part * scene.mm_per_px) for part in np.mgrid[0 : view.shape[0], 0 : view.shape[1]])
    # Halfway between a ridge in contact (1 - 0.5) and the skin between ridges (1 - 0.04).
    dark = quotient < 0.73
    within = (ellipse.distance(x, y) > 0.15).numpy()
    np.testing.assert_array_equal(dark[within], scene.truth.contact_mask(frame)[within])
    assert not dark[(ellipse.distance(x, y) < -0.05).numpy()].any()
