import math

import numpy as np
import pytest
import torch

from fingerflow.synthetic import Camera, Press, Slide, SyntheticScene

ANY_SCENE = pytest.mark.parametrize("kind", [Press, Slide])


@ANY_SCENE
def test_frames_are_the_same_in_any_order(kind: type[SyntheticScene]) -> None:
    scene, again = kind(), kind()
    first = scene.render(200)
    assert first.shape == (512, 1280)
    assert first.dtype == np.uint8
    other = again.render(201)
    np.testing.assert_array_equal(again.render(200), first)
    assert (other != first).mean() > 0.5
    assert (kind(camera=Camera(seed=1)).render(200) != first).mean() > 0.5


def test_single_precision_is_far_below_the_noise() -> None:
    scene = Press()
    exact, fast = scene.render_clean(250, dtype=torch.float64), scene.render_clean(250)
    assert fast.dtype == np.float32
    # An edge of 80 levels over 0.35 px turns the 2e-6 mm of float32's rounding into 0.01 levels at most.
    assert np.abs(exact - fast).max() < 0.02


@ANY_SCENE
def test_noise_is_the_cameras(kind: type[SyntheticScene]) -> None:
    scene = kind(camera=Camera(salt_and_pepper=0.0, bit_depth=12))
    clean, frame = scene.render_clean(150), scene.render(150)
    assert frame.dtype == np.uint16
    lit = clean > 20 * scene.camera.levels
    score = (frame - clean)[lit] / np.sqrt(scene.camera.variance(torch.from_numpy(clean)).numpy()[lit] + 1 / 12)
    assert score.mean() == pytest.approx(0, abs=5 / math.sqrt(score.size))
    assert score.std() == pytest.approx(1, abs=5 / math.sqrt(2 * score.size))


@ANY_SCENE
def test_grey_levels_use_the_range_without_saturation(kind: type[SyntheticScene]) -> None:
    scene = kind(camera=Camera(bit_depth=12))
    frame = scene.render(299)
    levels = scene.camera.levels
    assert (frame == scene.camera.full_range).mean() < 0.001
    topography, contact = (scene.views[name].crop(frame) / levels for name in ("topography", "contact"))
    # The slide ends on the right, where the grazing light has faded by a fifth.
    assert 140 < np.quantile(topography, 0.999) < 215
    assert np.median(topography[:20, :20]) == pytest.approx(9, abs=3)
    skin = topography[206:306, 270:370]
    # Half of the difference between crests and valleys.
    assert (np.quantile(skin, 0.9) - np.quantile(skin, 0.1)) / 2 > 35
    assert np.quantile(contact, 0.98) == pytest.approx(180, abs=12)
    for corner in (contact[:20, :20], contact[:20, -20:], contact[-20:, :20], contact[-20:, -20:]):
        assert np.median(corner) < 6


@ANY_SCENE
def test_ridges_in_contact_halve_the_bright_field(kind: type[SyntheticScene]) -> None:
    scene = kind(camera=Camera(salt_and_pepper=0.0, dark=0.0))
    view = scene.views["contact"]
    quotient = view.crop(scene.render(299)) / np.maximum(view.crop(scene.empty()).astype(float), 1)
    contact, gross = scene.truth.contact_mask(299), scene.truth.gross_mask(299)
    assert np.median(quotient[contact]) == pytest.approx(0.5, abs=0.02)
    assert np.median(quotient[gross & ~contact]) == pytest.approx(0.96, abs=0.02)
    lit = view.crop(scene.empty()) > 100
    assert np.median(quotient[lit & ~gross]) == pytest.approx(1, abs=0.01)


def test_empty_and_dark_pictures_differ_in_their_noise_only() -> None:
    scene = Press()
    assert (scene.empty(0) != scene.empty(1)).mean() > 0.3
    np.testing.assert_array_equal(scene.empty(1), scene.empty(1))
    left = scene.views["topography"].crop(scene.empty().astype(float) - scene.empty_clean())
    # Clipping at 0 and rounding change the mean of a level of 8 with deviation 1.4 by less than this.
    assert left.mean() == pytest.approx(0, abs=0.02)
    assert scene.dark().mean() == pytest.approx(scene.camera.dark, abs=0.15)


@ANY_SCENE
def test_times_count_from_the_trigger(kind: type[SyntheticScene]) -> None:
    scene = kind(n_frames=40, frame_rate=100.0, frames_before_trigger=5)
    assert scene.times[[0, 5, 39]] == pytest.approx([-0.05, 0.0, 0.34])
    assert (np.diff(scene.progress(scene.times)) >= 0).all()
    forces = scene.forces()
    assert np.diff(forces.time) == pytest.approx(1e-4)
    assert forces.time[0] <= scene.times[0]
    assert forces.time[-1] >= scene.times[-1]
    edge = np.flatnonzero(np.diff(forces.trigger))
    assert forces.time[edge + 1] == pytest.approx([0.0], abs=1e-12)
    assert set(forces.trigger) == {0.0, 5.0}


def test_press_force_rises_smoothly_and_area_follows_it() -> None:
    scene = Press()
    forces = scene.forces()
    before, after = forces.time < 0.02, forces.time > 0.93
    assert forces.normal_force[before].mean() == pytest.approx(0, abs=0.002)
    assert forces.normal_force[before].std() == pytest.approx(0.005, rel=0.15)
    assert forces.normal_force[after].mean() == pytest.approx(5, abs=0.002)
    assert forces.tangential_force[after].mean() == pytest.approx(0.15, abs=0.002)
    force = scene.normal_force(scene.times)
    area = np.array([scene.truth.gross_contact_area_mm2(frame) for frame in range(scene.n_frames)])
    # Semi-axes grow as force^(1/4).
    np.testing.assert_allclose(area, math.pi * 5.5 * 4.5 * np.sqrt(force / 5), rtol=1e-12)
    assert (area == 0).sum() > 12
