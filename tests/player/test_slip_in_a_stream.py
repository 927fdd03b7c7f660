"""Tests of the slip flag in a played stream: it stays 0 in a press, in a roll and while nothing slips, and is raised
soon after slip begins.
"""

from pathlib import Path

import numpy as np
import pytest

from fingerflow.kernels.library import is_present
from fingerflow.synthetic import PartialSlip, rebuild_scene
from tests.silent import case
from tests.silent.slip_flag import FLICKER, MOST_FALSE, quiet_scenes, records_of
from tests.small_trials import HEIGHT, WIDTH, recipe_of_trials, write_library_bundle, write_scene_of_bundle

pytestmark = pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")

STILL = 20


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[PartialSlip, np.ndarray]:
    """Play a trial that rests for 20 frames, is loaded, and jumps before and after full slip; return its scene and
    records.
    """
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
    known = rebuild_scene(folder / "trial")
    assert isinstance(known, PartialSlip)
    return known, case.records_of(bundle, file)


def test_the_flag_comes_with_the_first_skin_that_slips(played: tuple[PartialSlip, np.ndarray]) -> None:
    """The flag is raised after the first 2 %, and at most 15 %, of the contact have slipped, long before full slip, and
    stays raised through the jumps. Before the trigger nothing moves.
    """
    trial, records = played
    assert len(records) == trial.n_frames
    raised = int(np.argmax(records["slip_flag"]))
    assert raised > STILL
    assert 0.85 < trial.stuck_share(raised) < 0.98
    assert records["slip_flag"][raised:].all()


@pytest.mark.parametrize(("name", "flicker"), [("press that shifts", 0.0), ("roll and shear", FLICKER)])
def test_a_press_or_roll_raises_no_flag(name: str, flicker: float, tmp_path: Path) -> None:
    """The flag is raised in fewer than one in a hundred frames of a press or a roll, also if the light changes by a
    tenth; `python -m tests.silent slip_flag` plays more of them.
    """
    records = records_of(quiet_scenes(60)[name], flicker, tmp_path)
    assert records["slip_flag"].mean() < MOST_FALSE


def test_no_point_of_a_stream_is_on_other_skin_through_a_jump(played: tuple[PartialSlip, np.ndarray]) -> None:
    """In the frames after a jump no point is more than 2 px from its skin, and more than 80 % are within 0.5 px; the
    next ridge is 14 px away.

    The rim jumps by 5 px within one window of 21 px, which then gives the mean of both parts, up to 1.5 px off its
    middle (1 px with windows of 15 px). The jump of the whole contact adds no error to that of the rim; half of the
    points are left by then, too many for others to be seeded.
    """
    trial, records = played
    rim, whole = (int(at) for at in np.searchsorted(trial.times, trial.jumps))
    for frame in (*range(rim, rim + 5), *range(whole, whole + 10)):
        error = _errors(trial, records, frame)
        assert len(error) > (55 if frame < whole else 70), frame
        assert error.max() < 2, frame
        assert (error < 0.5).mean() > 0.8, frame


def _errors(trial: PartialSlip, records: np.ndarray, frame: int) -> np.ndarray:
    """Return the distances (px) of the points of a frame from their skin.

    The skin of a point is that at its position in the first frame in which it is given after it was seeded.
    """
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
