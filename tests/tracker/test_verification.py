"""Tests of the verification of points: points on their skin pass, points beside it fail and have no values in
results.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow import process
from fingerflow.engines.engine import Array, Engine, EngineSettings
from fingerflow.kernels.library import is_present
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.synthetic import Slide
from fingerflow.tracker import window_match
from fingerflow.tracker.points import Points
from fingerflow.tracker.subset_verification import Verification
from fingerflow.tracker.window_match import fit_shifts
from tests.small_trials import SMALL_PRESS, TRIALS, write_small

Make = Callable[[EngineSettings], Engine]
WINDOW = 25
SETTINGS = EngineSettings(window_px=WINDOW)
GRADIENT = np.array([[0.08, -0.05], [0.06, -0.04]], np.float32)
STRAIGHT = np.eye(2, dtype=np.float32)


def skin(x: Array, y: Array) -> Array:
    """Return the grey levels of ridges that bend and differ in height, with waves of 13 to 40 px, so that no two
    positions look alike.
    """
    ridges = np.sin(2 * math.pi * (0.8 * x + 0.6 * y + 4 * np.sin(y / 30)) / 15)
    return 128 + 40 * ridges + 20 * np.sin(2 * math.pi * (x - 0.4 * y) / 37 + 1.0)


def picture(gradient: Array, shift: tuple[float, float], noise: float, seed: int) -> Array:
    """Return a picture (1, 160, 200) of skin moved about its middle, x = (I + gradient) X + shift, with noise."""
    x, y = np.meshgrid(np.arange(200.0), np.arange(160.0))
    middle = np.array([100.0, 80.0])
    there = np.stack((x, y), -1) - middle - np.array(shift)
    back = there @ np.linalg.inv(np.eye(2) + gradient).T + middle
    light = skin(back[..., 0], back[..., 1])
    drawn = torch.randn(light.shape, generator=torch.Generator().manual_seed(seed)).numpy()
    return (light + noise * drawn).astype(np.float32)[None]


def points(gradient: Array, shift: tuple[float, float]) -> tuple[Array, Array]:
    """Return positions (N, 2) px of the points in the first and the second image."""
    x, y = np.meshgrid(np.arange(40.0, 161, 8), np.arange(30.0, 131, 8))
    then = np.stack((x.ravel(), y.ravel()), -1)
    middle = np.array([100.0, 80.0])
    now = (then - middle) @ (np.eye(2) + gradient).T + middle + np.array(shift)
    return then.astype(np.float32), now.astype(np.float32)


def warps(gradient: Array, count: int) -> Array:
    """Return the same deformation (N, 2, 2) for all points."""
    return np.broadcast_to((STRAIGHT + gradient).astype(np.float32), (count, 2, 2))


UNMOVED = np.zeros((2, 2), np.float32)


@pytest.fixture(params=["compiled", "portable"])
def form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Choose the compiled or the portable form of the fit of shifts."""
    if request.param == "compiled" and not is_present():
        pytest.skip("the compiled library is not there")
    monkeypatch.setattr(window_match, "is_present", lambda: request.param == "compiled")
    return str(request.param)


@pytest.mark.usefixtures("form")
def test_the_shift_of_most_samples_is_found_where_others_do_not_move() -> None:
    """A speck covers 9 of 81 samples, the skin is a plane wave in each direction, and noise is a tenth of a grey level:
    a shift has a deviation of 0.003 px. Both forms must find the shift within five of them, and exclude the speck. A
    window with NaN has no shift."""
    random = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(-12.0, 13, 3), np.arange(-12.0, 13, 3)), -1).reshape(-1, 2)
    shift = random.uniform(-0.4, 0.4, (20, 1, 2))

    def window(away: Array, speck: bool = True) -> Array:
        light = 100 + 30 * np.sin((grid + away)[..., 0] / 4) + 20 * np.cos((grid + away)[..., 1] / 5)
        light = light + random.normal(0, 0.1, light.shape)
        light[:, 30:39] -= 60 * speck
        return light.astype(np.float32)

    steps = 0.5 * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])[:, None, None]
    then = 1.2 * window(shift, speck=False) - 7
    around = np.stack([window(np.broadcast_to(step, shift.shape)) for step in steps])
    around[1, 4, 7] = np.nan
    shift_so_far, weight = np.zeros((20, 2)), np.ones(then.shape)
    for _ in range(3):
        fit = fit_shifts(then, around, window(shift_so_far[:, None]), shift_so_far, weight, 0.15)
        shift_so_far, weight, deviations, largest = fit
    assert not shift_so_far[4].any()
    assert largest[4] == 0
    right = np.arange(20) != 4
    assert np.abs((shift_so_far - shift[:, 0])[right]).max() < 0.015
    np.testing.assert_allclose((weight[right] == 0).mean(1), 9 / 81, atol=2.1 / 81)
    assert (largest[right] > 100).all()
    assert (deviations > np.linalg.norm(shift_so_far, axis=1) / 0.01)[right].all()


@pytest.mark.parametrize(("least", "most", "share"), [(2.0, 4.0, 0.7), (4.0, 16.0, 0.97)])
def test_points_beside_their_skin_fail_and_no_other(make_engine: Make, least: float, most: float, share: float) -> None:
    """Of points 2 to 4 px beside their skin at least 70 % fail (77 % here: along a ridge nothing changes), of those 4
    to 16 px beside it 97 %, and no other point fails.
    """
    engine = make_engine(SETTINGS)
    then, now = points(GRADIENT, (1.3, -2.6))
    first = engine.images(picture(UNMOVED, (0, 0), 3.0, 1))
    images = engine.images(np.concatenate([picture(GRADIENT, (1.3, -2.6), 3.0, seed) for seed in (2, 3)]))
    status = np.zeros((2, len(then)), np.uint8)
    warp = warps(GRADIENT, len(then))
    both = np.stack((now, now))
    assert not Verification(engine, first, then).check(images, both, status, warp).differs.any()
    generator = torch.Generator().manual_seed(4)
    found = count = 0
    for offset in range(10):
        some = np.zeros(len(then), dtype=bool)
        some[offset::10] = True
        angle = 2 * math.pi * torch.rand(len(then), generator=generator).numpy()
        distance = least + (most - least) * torch.rand(len(then), generator=generator).numpy()
        away = np.where(some, distance, 0.0)
        shift = (away[:, None] * np.stack((np.cos(angle), np.sin(angle)), -1)).astype(np.float32)
        failed = Verification(engine, first, then).check(images, both + shift, status, warp).differs
        assert not failed[~some].any()
        found, count = found + int(failed.sum()), count + int(some.sum())
    assert found >= share * count


def test_frames_between_a_check_that_failed_and_one_that_passed_are_not_trusted(make_engine: Make) -> None:
    engine = make_engine(SETTINGS)
    then, now = points(UNMOVED, (0.0, 0.0))
    image = engine.images(picture(UNMOVED, (0, 0), 1.0, 1))
    verification = Verification(engine, image, then)
    status = np.zeros((1, len(then)), np.uint8)
    straight = warps(UNMOVED, len(then))
    only = np.arange(len(then)) == 5
    beside = now + only[:, None] * np.array([6.0, 3.0], np.float32)

    def check(places: Array, of: Array = status) -> Array:
        return verification.check(image, places[None], of, straight).differs

    np.testing.assert_array_equal(check(beside), only)
    np.testing.assert_array_equal(check(now), only)
    assert not check(now).any()
    # A lost point cannot be checked and keeps its result.
    check(beside)
    lost = np.where(only, TrackStatus.MISMATCH, 0).astype(np.uint8)[None]
    np.testing.assert_array_equal(check(np.where(only[:, None], np.float32(np.nan), now), lost), only)
    # A point of unknown deformation cannot be checked either.
    unknown = np.where(only[:, None, None], np.float32(np.nan), straight)
    np.testing.assert_array_equal(verification.check(image, beside[None], status, unknown).differs, only)


def test_points_that_a_speck_on_the_glass_holds_back_are_found(make_engine: Make) -> None:
    """Points held back by specks at rest, while the skin moves by 3 px, are found: a point 0.6 px back is marked as
    held, and the shift of a point 0.2 px back is in its variance.

    At most one in twenty of all other points, whose windows contain specks too, may be marked: points lie on a grid
    here, and the skin hardly changes along some ridges.
    """
    engine = make_engine(SETTINGS)
    then, now = points(UNMOVED, (3.0, 0.0))
    some = np.arange(len(then)) % 23 == 11
    x, y = np.meshgrid(np.arange(200.0), np.arange(160.0))
    light = np.ones_like(x)
    for right, down in then[some] + (4.0, 3.0):
        light *= 1 - 0.6 * np.exp(-((((x - right) ** 2 + (y - down) ** 2) / 2.0**2) ** 2))
    first, after = (
        engine.images((picture(UNMOVED, (shift, 0.0), 2.0, seed) * light).astype(np.float32))
        for shift, seed in ((0.0, 1), (3.0, 2))
    )
    status, straight = np.zeros((1, len(then)), np.uint8), warps(UNMOVED, len(then))

    def check(back: float) -> Any:
        places = now - some[:, None] * np.array([back, 0.0], np.float32)
        return Verification(engine, first, then).check(after, places[None], status, straight)

    far, near = check(0.6), check(0.2)
    assert far.held[some].mean() > 0.9
    assert far.held[~some].mean() < 0.05
    assert not near.held[some].any()
    assert 0.1 < float(np.sqrt(2 * near.variance[some].mean())) < 0.3


def test_points_that_fail_have_no_position_and_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three points that the tracker gives 5 px off from the tenth frame on have the status `window_differs` and no
    position, and are counted in `window_differs_share`; without them no point of the press is rejected.
    """
    scene_path = write_small(tmp_path / "press", SMALL_PRESS)
    step, seen = Points._step, [1]

    def beside(points: Points, images: Any, around: Any) -> Any:
        found = step(points, images, around)
        numbers = np.arange(seen[0], seen[0] + len(images))
        seen[0] += len(images)
        shifted = found.points.copy()
        shifted[numbers >= 9, :3] += np.array([4.0, 3.0], np.float32)
        return found._replace(points=shifted)

    plain = process(scene_path, ["position_px", "window_differs_share"])
    assert (plain["window_differs_share"].values == 0).all()
    monkeypatch.setattr(Points, "_step", beside)
    result = process(scene_path)
    differs = result["status"].values == TrackStatus.WINDOW_DIFFERS
    assert differs[8:, :3].any(0).all()
    assert not differs[:, 3:].any()
    for name in ("position", "position_px", "position_std_px", "displacement"):
        assert np.isnan(result[name].values[differs]).all(), name
    np.testing.assert_array_equal(result["position_px"].values[:, 3:], plain["position_px"].values[:, 3:])
    np.testing.assert_allclose(result["window_differs_share"].values, differs.mean(1))


def test_skin_that_deforms_unevenly_is_no_dust(tmp_path: Path) -> None:
    """On a slide of 3 mm without dust, whose skin deforms by up to 45 %, no point is held back."""
    scene = write_small(tmp_path / "slide", replace(TRIALS["slide"], travel=3.0))
    assert not (process(scene, ["position_px"])["status"] == TrackStatus.DUST_IN_WINDOW).any()


@pytest.mark.long
@pytest.mark.parametrize("change", [{}, {"direction": 3.0}, {"creep": 0.9}, {"n_frames": 40, "frame_rate": 33.0}])
def test_points_of_a_fast_slide_are_on_their_skin_or_lost(tmp_path: Path, change: dict[str, Any]) -> None:
    """Slides that end at 10 to 16 px a frame, where most points are lost and few have neighbours to judge them."""
    frames: dict[str, Any] = {"n_frames": 60, "frame_rate": 50.0, "frames_before_trigger": 2} | change
    small = Slide(**frames, frame_shape=(300, 900), finger=(4.0, 3.4), semi_axes=(2.4, 2.0), travel=4.0)
    result = process(write_small(tmp_path / "slide", small), ["position_px"])
    position, tracked = result["position_px"].values, result["status"].values == TrackStatus.TRACKED
    seeded = np.flatnonzero(tracked[0])
    skin = np.stack([small.truth.follow(position[0, seeded], 0, frame) for frame in range(small.n_frames)])
    off = np.linalg.norm(position[:, seeded] - skin, axis=-1)[tracked[:, seeded]]
    assert len(off) > 7500
    assert off.max() < 3
