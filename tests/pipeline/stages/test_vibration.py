"""Tests of the vibration of the whole image, which is taken out of displacement and strain, and of motion of the skin,
which is not.
"""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import process
from fingerflow.tracker.entry import advected
from fingerflow.tracker.vibration import steady, vibration
from tests.silent.case import played
from tests.small_trials import scene_beside, turned, warnings_of, write_small_slip

FRAMES, POINTS, PX = 90, 120, 0.03  # PX: mm
SHAKEN = 0.3 * PX * np.stack((np.sin(np.arange(FRAMES) * np.pi / 3), np.cos(np.arange(FRAMES) * np.pi / 3)), axis=1)


CASES = ("camera", "camera, lost", "finger", "inside", "most", "slip", "jump", "drag", "none")


@pytest.mark.parametrize("factor", [0, 1j, 1])  # to the right at the right edge: a shift, a rotation, a change of scale
@pytest.mark.parametrize("which", CASES)
def test_only_motion_that_all_skin_has_in_common_is_vibration(which: str, factor: complex) -> None:
    """A camera's vibration is found to a tenth while the skin beside the contact moves inwards and the contact grows; a
    finger that trembles or is dragged, a jerk of the skin in contact, and its own motion are no vibration.
    """
    draw, time = np.random.default_rng(0), np.arange(FRAMES)
    inside = np.sort(draw.uniform(0, 1, POINTS))[None] < np.where(which == "most", 0.8, time / FRAMES)[:, None]
    inwards = 2e-5 * np.square(time)[:, None] * ~inside
    position = draw.uniform(0, 5, (POINTS, 2)) + inwards[..., None] + draw.normal(0, 0.01 * PX, (FRAMES, POINTS, 2))
    moves = {"finger": ~inside, "inside": inside, "most": inside, "none": inside & ~inside}.get(which, inside | ~inside)
    arm = (position[0] - 2.5) @ np.array((1, 1j)) / 2.5
    turned = np.stack(((SHAKEN[:, :1] * factor * arm).real, (SHAKEN[:, :1] * factor * arm).imag), axis=-1)
    shaken = turned if factor else SHAKEN[:, None]
    if which in ("slip", "jump"):
        position[50:] += 0.5 * (inside | (which == "jump"))[50:, :, None]
    elif which == "drag":  # both ends of it are kinks in the path
        position += 5 * PX * np.clip(time - 30, 0, 30)[:, None, None]
    else:
        position += shaken * moves[..., None]
    frames = np.delete(time, [40] if "lost" in which else [])
    found = position - steady(position, vibration(position, inside, frames, PX, "")[0][:, None])
    off = np.abs(found - shaken * ("camera" in which))[frames].max(1) / np.abs(shaken).max()
    assert np.delete(off, range(35, 45), axis=0).max() < 0.1
    assert off.max() < (0.5 if "lost" in which else 0.1)


@pytest.mark.parametrize("turns", [False, True])
def test_vibration_adds_no_energy(turns: bool, trials: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a vibration of 1 px or 0.3 degrees the strain energy of a press is that without it, to three standard
    deviations, and so are positions from which entries follow, to 0.1 px; it is named, also by a stream.
    """
    seen: list[np.ndarray] = []
    monkeypatch.setattr(
        "fingerflow.pipeline.stages.deformation.deformation_stage.advected",
        lambda position, *more: seen.append(position[:]) or advected(position, *more),
    )
    frames = np.load(trials / "press" / "frames.npy")
    rolled = [np.roll(frame, round(np.sin(k * np.pi / 3)), 0) for k, frame in enumerate(frames)]
    shaken = turned(frames, 0.3) if turns else np.stack(rolled)
    still, moved = (
        process(scene_beside(trials / "press", tmp_path, frames=taken), "strain_energy") for taken in (frames, shaken)
    )
    assert "the whole image vibrates, by 0." in warnings_of(played(tmp_path / "scene.toml"))
    assert "the whole image vibrates, by 0." in warnings_of(moved)
    assert "vibrates" not in warnings_of(still)
    assert np.nanmean(np.abs(seen[1] - seen[0])) < 0.1 * PX
    off = np.abs(moved["strain_energy"] - still["strain_energy"]).values
    assert (off <= 3 * np.hypot(moved["strain_energy_std"], still["strain_energy_std"]).values + 1e-5).all()


def test_vibration_of_a_slip_is_named(tmp_path: Path) -> None:
    """A shake of 0.7 px RMS makes skin slip that sticks: a warning says so, and none where nothing shakes."""
    folder = write_small_slip(tmp_path / "slip")
    still = process(folder / "scene.toml", "stuck_ratio")
    frames = np.load(folder / "frames.npy")
    shaken = np.stack([np.roll(frame, round(np.sin(k * np.pi / 3)), 0) for k, frame in enumerate(frames)])
    moved = process(scene_beside(folder, tmp_path, frames=shaken), "stuck_ratio")
    assert "skin that sticks is taken to slip" in warnings_of(moved)
    assert "the whole image vibrates" in warnings_of(played(tmp_path / "scene.toml"))
    assert "vibrates" not in warnings_of(still)
