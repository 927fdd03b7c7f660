"""Tests of `fingerflow slip`: one line per trial, counts by both rules, figures, and errors that do not
stop the rest.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.models.partial_slip import FrictionFit, TrialVerdict, fit_friction, judge_trial
from fingerflow.plot.outlines import stuck_outline
from fingerflow.recordings import open_recording
from fingerflow.report import write_overlay, write_report
from fingerflow.report.slip_trials import SlipTrial
from fingerflow.report.view_painter import STUCK, ViewPainter
from fingerflow.results.result import load_result, save_result

Command = Callable[..., int]
Printed = pytest.CaptureFixture[str]
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def fading(slip_trials: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of the result of the trial `fading`."""
    path: Path = tmp_path_factory.mktemp("slip") / "fading.h5"
    names = ["stuck_ratio", "stuck_ratio_std", "printed_stuck_ratio"]
    save_result(process(load_scene(slip_trials / "fading" / "scene.toml"), names), path)
    return path


def test_two_trials_and_one_that_is_not_there(
    command: Command, slip_trials: Path, fading: Path, tmp_path: Path, capsys: Printed
) -> None:
    """The command takes the scene of a trial, and the result of another."""
    scenes = [*(str(slip_trials / name / "scene.toml") for name in ("abrupt", "nothing")), str(fading)]
    assert command("slip", *scenes, "--figure", tmp_path / "figures") == 0
    abrupt, nothing, faded, count, figures = capsys.readouterr().out.splitlines()
    assert abrupt.startswith(f"{scenes[0]}: vanishes abruptly (as printed: vanishes abruptly; ")
    assert "collapse" in abrupt
    assert nothing.startswith(f"{scenes[1]}: not judged: ")
    assert "there is no such file" in nothing
    assert faded.startswith(f"{scenes[2]}: diminishes (as printed: vanishes abruptly; ")
    assert count == (
        "2 trials: vanishes abruptly 1, diminishes 1, inconclusive 0; "
        "as printed: vanishes abruptly 2, diminishes 0, inconclusive 0; not judged: 1"
    )
    assert figures == f"figures: {tmp_path / 'figures'}"
    written = sorted((tmp_path / "figures").iterdir())
    names = [f"{name}.{suffix}" for name in ("abrupt", "fading", "trials") for suffix in ("png", "txt")]
    assert [path.name for path in written] == names
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written if path.suffix == ".png")
    caption = (tmp_path / "figures" / "abrupt.txt").read_text(encoding="utf-8")
    assert caption.startswith("Trial abrupt: vanishes abruptly")  # a title, not a path
    assert str(slip_trials) not in caption
    assert "n = 120 frames" in caption


def test_the_stuck_part_in_page_and_video(command: Command, slip_trials: Path, tmp_path: Path, capsys: Printed) -> None:
    """The page shows the verdict with its figure; page and video show the outline of the stick region at its border,
    and none once nothing sticks.
    """
    scene = load_scene(slip_trials / "abrupt" / "scene.toml")
    result = process(scene, ["stuck_ratio", "ellipse_angle", "tracked_share"])
    page = write_report(result, scene, tmp_path, brief=True).read_text(encoding="utf-8")
    write_overlay(result, scene, tmp_path / "overlay.mp4")
    assert "Partial slip: vanishes abruptly" in page
    assert ">stuck part<" in page  # in the legend of the image
    save_result(result, tmp_path / "result.h5")
    assert command("slip", tmp_path / "result.h5") == 0
    assert "result.h5: vanishes abruptly" in capsys.readouterr().out
    with open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording:
        painter = ViewPainter(result, scene, recording)
        for frame, size in ((40, 1), (119, 0)):
            picture = painter.paint(frame)
            outlined = (np.abs(picture.astype(int) - STUCK).max(-1) < 40).nonzero()
            assert (len(outlined[0]) > 100) == bool(size)
            if size:
                matrix = np.linalg.inv([*scene.calibration.topography_to_contact, [0, 0, 1]])
                outline = stuck_outline(result.isel(frame=frame))
                assert outline is not None
                drawn = outline / result.attrs["mm_per_px"] @ matrix[:2, :2].T + matrix[:2, 2]
                left = outlined[1] < picture.shape[1] // 2
                for axis, found in ((0, outlined[1][left]), (1, outlined[0][left])):
                    ends = [found.min(), found.max()]
                    np.testing.assert_allclose(ends, [drawn[:, axis].min(), drawn[:, axis].max()], atol=3)
    with open_recording(tmp_path / "overlay.mp4") as video:
        assert len(video) == 120


def test_a_verdict_survives_the_disk(fading: Path) -> None:
    result = load_result(fading)
    found = SlipTrial.read(result, "one")
    series = (result[name].values for name in ("stuck_ratio", "load_ratio", "time", "stuck_ratio_std"))
    expected = judge_trial(*series)
    assert isinstance(found.verdict, TrialVerdict)
    assert repr(found.verdict) == repr(expected)  # NaN is not equal to itself
    assert isinstance(found.fit, FrictionFit)
    slow = expected.loading()
    fit = fit_friction(result["stuck_ratio"].values[slow], result["load_ratio"].values[slow])
    assert found.fit.mu_s == fit.mu_s
    assert found.fit.mu_s_interval == fit.mu_s_interval
