"""The second look at points: what is right passes, what is beside its skin fails, and results have neither then."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow import load_scene, process
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.ops.window_correlation import correlation, deformed_alike, sample_windows
from fingerflow.player.contract.variables import TRACK_STATUS
from fingerflow.stages.second_look import SecondLook
from fingerflow.synthetic import Press, rebuild_scene, write_recording

WINDOW = 25


def skin(x: Tensor, y: Tensor) -> Tensor:
    """Ridges that bend and differ in height: waves of 13 to 40 px, so that no place looks like another."""
    return (
        128
        + 40 * torch.sin(2 * math.pi * (0.8 * x + 0.6 * y + 4 * torch.sin(y / 30)) / 15)
        + 20 * torch.sin(2 * math.pi * (x - 0.4 * y) / 37 + 1.0)
    )


def picture(gradient: Tensor, shift: tuple[float, float], noise: float, seed: int) -> Tensor:
    """(1, 1, 160, 200) of skin that has moved: x = (I + gradient) X + shift about the middle."""
    y, x = torch.meshgrid(torch.arange(160.0), torch.arange(200.0), indexing="ij")
    middle = torch.tensor([100.0, 80.0])
    there = torch.stack((x, y), -1) - middle - torch.tensor(shift)
    back = there @ torch.linalg.inv(torch.eye(2) + gradient).T + middle
    light = skin(back[..., 0], back[..., 1])
    return (light + noise * torch.randn(light.shape, generator=torch.Generator().manual_seed(seed)))[None, None]


def points(gradient: Tensor, shift: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """(N, 2) then and now."""
    y, x = torch.meshgrid(torch.arange(30.0, 131, 8), torch.arange(40.0, 161, 8), indexing="ij")
    then = torch.stack((x.flatten(), y.flatten()), -1)
    middle = torch.tensor([100.0, 80.0])
    return then, (then - middle) @ (torch.eye(2) + gradient).T + middle + torch.tensor(shift)


GRADIENT = torch.tensor([[0.08, -0.05], [0.06, -0.04]])


def test_correlation_of_the_same_skin_is_that_of_the_noise() -> None:
    """Without noise what cubic convolution leaves of waves of 15 px; with it 1 - correlation is sigma^2 / S."""
    then, now = points(GRADIENT, (1.3, -2.6))
    number = torch.zeros(len(then), dtype=torch.int64)
    for noise, least, most in ((0.0, 0.0, 1e-3), (6.0, 0.5, 2.0)):
        first = picture(torch.zeros(2, 2), (0, 0), noise, 1)
        after = picture(GRADIENT, (1.3, -2.6), noise, 2)
        one = sample_windows(first, number, then, torch.eye(2).expand(len(then), 2, 2), WINDOW, 3)
        other = sample_windows(after, number, now, (torch.eye(2) + GRADIENT).expand(len(then), 2, 2), WINDOW, 3)
        apart = 1 - correlation(one, other)
        expected = noise**2 / one.var(1)
        if noise:
            # Interpolation between pixels averages some of it.
            assert least < float((apart / expected).median()) < most
        else:
            assert float(apart.max()) < most
        assert torch.allclose(correlation(one, 3 * one - 20), torch.ones(len(one)), atol=1e-5)


def test_a_deformation_is_found_with_the_middle_held() -> None:
    """From none to that of the skin, to 0.01 in each number: what noise of 0 leaves of four rounds."""
    then, now = points(GRADIENT, (0.0, 0.0))
    number = torch.zeros(len(then), dtype=torch.int64)
    straight = torch.eye(2).expand(len(then), 2, 2)
    first = sample_windows(picture(torch.zeros(2, 2), (0, 0), 0.0, 1), number, then, straight, WINDOW, 3)
    after = picture(GRADIENT, (0.0, 0.0), 0.0, 2)
    found = deformed_alike(first, after, number, now, straight, WINDOW, 3)
    near = (found - torch.eye(2) - GRADIENT).abs().amax((1, 2))
    assert float(near.quantile(0.9)) < 0.01


@pytest.mark.parametrize(("least", "most", "share"), [(2.0, 4.0, 0.7), (4.0, 16.0, 0.97)])
def test_points_beside_their_skin_fail_and_no_other(least: float, most: float, share: float) -> None:
    """Of 2 to 4 px in any direction 77 % are found here: along a ridge nothing changes."""
    then, now = points(GRADIENT, (1.3, -2.6))
    look = SecondLook(picture(torch.zeros(2, 2), (0, 0), 3.0, 1), then, WINDOW)
    images = torch.cat([picture(GRADIENT, (1.3, -2.6), 3.0, seed) for seed in (2, 3)])
    status = torch.zeros((2, len(then)), dtype=torch.uint8)
    assert not look.failed(images, now.expand(2, -1, -1), status).any()
    generator = torch.Generator().manual_seed(4)
    found = count = 0
    for first in range(10):
        chosen = torch.zeros(len(then), dtype=torch.bool)
        chosen[first::10] = True
        angle = 2 * math.pi * torch.rand(len(then), generator=generator)
        away = least + (most - least) * torch.rand(len(then), generator=generator)
        shift = torch.where(chosen, away, 0.0)[:, None] * torch.stack((angle.cos(), angle.sin()), -1)
        look.forget()
        failed = look.failed(images, (now + shift).expand(2, -1, -1), status)
        assert not failed[~chosen].any()
        found, count = found + int(failed.sum()), count + int(chosen.sum())
    assert found >= share * count


def test_frames_between_a_look_that_failed_and_one_that_passed_are_not_trusted() -> None:
    then, now = points(torch.zeros(2, 2), (0.0, 0.0))
    image = picture(torch.zeros(2, 2), (0, 0), 1.0, 1)
    look = SecondLook(image, then, WINDOW)
    status = torch.zeros((1, len(then)), dtype=torch.uint8)
    beside = now.clone()
    beside[5] += torch.tensor([6.0, 3.0])
    only = torch.zeros(len(then), dtype=torch.bool)
    only[5] = True
    assert torch.equal(look.failed(image, beside[None], status), only)
    assert torch.equal(look.failed(image, now[None], status), only)
    assert not look.failed(image, now[None], status).any()
    # One that is lost cannot be looked at, and stays as it was.
    look.failed(image, beside[None], status)
    lost = torch.where(only, TrackStatus.MISMATCH, 0).to(torch.uint8)[None]
    assert torch.equal(look.failed(image, torch.where(only[:, None], torch.nan, now)[None], lost), only)


def test_light_and_focus_that_change_for_all_are_no_failure() -> None:
    then, now = points(GRADIENT, (0.0, 0.0))
    look = SecondLook(picture(torch.zeros(2, 2), (0, 0), 2.0, 1), then, WINDOW)
    after = picture(GRADIENT, (0.0, 0.0), 2.0, 2)
    blurred = torch.nn.functional.avg_pool2d(after, 5, 1, 2, count_include_pad=False)
    status = torch.zeros((1, len(then)), dtype=torch.uint8)
    assert not look.failed(0.6 * blurred + 30, now[None], status).any()


@pytest.fixture(scope="module")
def scene_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("look") / "press"
    size: dict[str, Any] = {"frame_shape": (160, 400), "finger": (2.7, 2.3), "semi_axes": (2.0, 1.7)}
    write_recording(folder, Press(n_frames=16, frame_rate=16.0, frames_before_trigger=2, **size))
    return folder / "scene.toml"


def test_a_press_loses_no_point_to_it(scene_path: Path) -> None:
    result = process(scene_path, ["status", "window_differs_share"])
    assert TRACK_STATUS[TrackStatus.WINDOW_DIFFERS] == "window_differs"
    assert not (result["status"].values == TrackStatus.WINDOW_DIFFERS).any()
    assert (result["window_differs_share"].values == 0).all()


def test_points_that_fail_have_no_position_and_are_counted(scene_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker is made to give another place for three points, 5 px off, from the tenth frame on."""
    from fingerflow.stages.chosen_points import ChosenPoints

    step, seen = ChosenPoints._step, [1]

    def beside(points: ChosenPoints, images: Tensor, around: Any) -> Any:
        found = step(points, images, around)
        numbers = torch.arange(seen[0], seen[0] + len(images))
        seen[0] += len(images)
        shifted = found.points.clone()
        shifted[numbers >= 9, :3] += torch.tensor([4.0, 3.0])
        return found._replace(points=shifted)

    plain = process(scene_path)
    monkeypatch.setattr(ChosenPoints, "_step", beside)
    result = process(scene_path)
    status = result["status"].values
    differs = status == TrackStatus.WINDOW_DIFFERS
    assert differs[8:, :3].any(0).all()
    assert not differs[:, 3:].any()
    for name in ("position", "position_px", "position_std_px", "displacement"):
        assert np.isnan(result[name].values[differs]).all(), name
    np.testing.assert_array_equal(result["position_px"].values[:, 3:], plain["position_px"].values[:, 3:])
    np.testing.assert_allclose(result["window_differs_share"].values, differs.mean(1))
    truth = rebuild_scene(scene_path.parent).truth
    material = truth.material(truth.topography_positions(result["position_px"].values[0]), 0)
    last = result["position_px"].values[-1] - truth.topography_pixels(truth.positions(material, 15))
    assert np.nanmax(np.linalg.norm(last, axis=1)) < 1
    (said,) = [one for one in json.loads(result.attrs["warnings"]) if "window" in one]
    assert "status window_differs" in said
    assert load_scene(scene_path).tracking.template == "keyframe"
