"""The flag of slip in a played stream: not in a press, not while nothing slips, and soon after slip begins."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import player
from fingerflow.kernels.library import is_present
from fingerflow.synthetic import ChainPress, PartialSlip, Press, SyntheticScene, rebuild_scene
from tests.small_trials import HEIGHT, WIDTH, recipe_of_trials, write_library_bundle, write_scene_of_bundle

pytestmark = pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")

STILL = 20
SMALL: dict[str, Any] = {
    "n_frames": 60, "frame_rate": 60.0, "frames_before_trigger": 6,
    "frame_shape": (HEIGHT, 2 * WIDTH), "finger": (3.2, 2.7),
}  # fmt: skip


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[PartialSlip, np.ndarray]:
    """A trial that rests for 20 frames, is loaded, jumps before and after full slip; and the records of its stream."""
    folder = tmp_path_factory.mktemp("slip_stream")
    trial = PartialSlip(
        n_frames=90,
        frame_rate=60.0,
        frames_before_trigger=STILL,
        frame_shape=(HEIGHT, 2 * WIDTH),
        finger=(3.2, 2.7),
        semi_axes=(2.3, 1.9),
        creep=0.45,
        travel=0.8,
        jumps=(0.7, 1.0),
    )
    file = write_scene_of_bundle(folder / "trial", trial)
    bundle = write_library_bundle(folder / "bundle", recipe_of_trials())
    options = ["--output", str(folder / "results"), "--page", "off", "--threads", "1"]
    assert player.main([str(bundle), "--scene", str(file), *options]) == 0
    known = rebuild_scene(folder / "trial")
    assert isinstance(known, PartialSlip)
    return known, np.asarray(player.read_results(folder / "results").records)


def test_noise_raises_no_flag(played: tuple[PartialSlip, np.ndarray]) -> None:
    """Before the trigger nothing moves."""
    trial, records = played
    assert len(records) == trial.n_frames
    assert not records["slip_flag"][:STILL].any()
    assert np.nanmax(records["slip_residual"][1:STILL]) < 0.004  # mm, an eighth of a pixel


def test_the_flag_comes_with_the_first_skin_that_slips(played: tuple[PartialSlip, np.ndarray]) -> None:
    """When 15 % of the contact have slipped at most, long before full slip; then it stays, through the jumps."""
    trial, records = played
    raised = int(np.argmax(records["slip_flag"]))
    assert raised > STILL
    assert 0.85 < trial.stuck_share(raised) < 0.98
    assert records["slip_flag"][raised:].all()


@pytest.mark.parametrize(
    "press",
    [
        Press(shift=(0.2, -0.1), drag=0.08, semi_axes=(2.3, 1.9), **SMALL),
        ChainPress(friction=0.1, elements=501, **SMALL),
        ChainPress(friction=1.0, parameters="fitted", elements=501, **SMALL),
    ],
    ids=["shifted", "slippery", "soft"],
)
@pytest.mark.parametrize("flicker", [0.0, 0.1])
def test_a_press_raises_no_flag(press: SyntheticScene, flicker: float, tmp_path: Path) -> None:
    """Nor where the light changes by a tenth: fewer than one frame in a hundred."""
    file = write_scene_of_bundle(tmp_path / "press", press)
    frames = np.load(tmp_path / "press" / "frames.npy")
    light = 1 + flicker * np.sin(np.arange(len(frames)))
    np.save(tmp_path / "press" / "frames.npy", np.clip(np.rint(frames * light[:, None, None]), 0, 255).astype("u1"))
    bundle = write_library_bundle(tmp_path / "bundle", recipe_of_trials())
    options = ["--output", str(tmp_path / "results"), "--page", "off", "--threads", "1"]
    assert player.main([str(bundle), "--scene", str(file), *options]) == 0
    records = np.asarray(player.read_results(tmp_path / "results").records)
    assert np.nanmax(records["slip_residual"]) > 0.004  # skin has spread, by more than noise
    assert records["slip_flag"].mean() < 0.01


def test_no_point_of_a_stream_is_on_other_skin_through_a_jump(played: tuple[PartialSlip, np.ndarray]) -> None:
    """Of those that are given, against where the skin of their first frame is.

    The rim jumps by 5 px within one window of 21 px, which then gives the mean of what it sees, up to 1.5 px from its
    middle; with windows of 15 px it is 1 px. Another ridge is 14 px away. When all jumps as one, what the rim has
    added before stays, and nothing is added; half of the points have been left by then, too many to choose others.
    """
    trial, records = played
    rim, whole = (int(at) for at in np.searchsorted(trial.times, trial.jumps))
    for frame in range(rim, rim + 5):
        error = _errors(trial, records, frame)
        assert len(error) > 55, frame
        assert error.max() < 2, frame
        assert (error < 0.5).mean() > 0.8, frame
    for frame in range(whole, whole + 10):
        error = _errors(trial, records, frame)
        assert len(error) > 70, frame
        assert error.max() < 2, frame
        assert (error < 0.5).mean() > 0.8, frame


def _errors(trial: PartialSlip, records: np.ndarray, frame: int) -> np.ndarray:
    """px, of the points that are given in a frame, since each was first given after they were chosen."""
    same = np.flatnonzero(records["restart"] == records["restart"][frame])
    position = records["position_px"][same].astype(float)
    known = np.isfinite(position).all(-1)
    first, given = known.argmax(0), known[frame - same[0]]
    errors = np.full(len(given), np.nan)
    for begun in np.unique(first[given]):
        points = given & (first == begun)
        there = trial.truth.follow(position[begun, points], int(same[begun]), frame)
        errors[points] = np.linalg.norm(position[frame - same[0], points] - there, axis=-1)
    return errors[given]
