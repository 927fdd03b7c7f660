"""Tests of the command line: exit codes, messages and files."""

import json
import os
import pkgutil
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

import fingerflow
from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.results.result import save_result
from fingerflow.synthetic import write_recording
from tests.small_trials import TINY_PRESS

Command = Callable[..., int]
Printed = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def test_info_of_a_force_file(command: Command, tmp_path: Path, capsys: Printed) -> None:
    (tmp_path / "forces.csv").write_text("time (ms),Fz (mN)\n0,1\n2,5\n4,3\n")
    assert command("info", tmp_path / "forces.csv", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["sample_rate_hz"] == pytest.approx(500)
    assert facts["columns"] == {"time": "3 samples of 0 to 4 ms", "Fz": "3 samples of 1 to 5 mN"}
    with h5py.File(tmp_path / "forces.h5", "w") as file:
        file["Fz"] = np.array([1.0, 5.0, 3.0])
    assert command("info", tmp_path / "forces.h5", "--json") == 0
    assert json.loads(capsys.readouterr().out)["columns"] == {"Fz": "3 samples of 1 to 5 (no unit)"}
    with h5py.File(tmp_path / "both.h5", "w") as file:
        file["Fz"], file["frames"] = np.array([1.0, 5.0, 3.0]), np.zeros((5, 8, 10), np.uint8)
    assert command("info", tmp_path / "both.h5", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["frames"], facts["rows"], facts["columns"], facts["frame_rate_hz"]) == (5, 8, 10, None)
    with h5py.File(tmp_path / "both.h5", "a") as file:
        file.attrs["fingerflow_version"] = "0.1.0"
    assert command("info", tmp_path / "both.h5") == 2
    assert "both.h5: is a result of fingerflow" in capsys.readouterr().err
    for name in ("info", "report", "process"):
        assert command(name, tmp_path / ("x" * 300)) == 2
        assert "File name too long" in capsys.readouterr().err


def test_version_of_the_command_and_of_the_module(command: Command, capsys: Printed) -> None:
    assert command("--version") == 0
    said = capsys.readouterr().out
    assert said == f"fingerflow {fingerflow.__version__}\n"
    module = [sys.executable, "-m", "fingerflow", "--version"]
    assert subprocess.run(module, capture_output=True, text=True, check=True).stdout == said


def test_init_never_overwrites(command: Command, tmp_path: Path, capsys: Printed) -> None:
    path = tmp_path / "scene.toml"
    assert command("init", path) == 0
    before = path.read_text()
    assert command("init", path) == 2
    assert "exists already" in capsys.readouterr().err
    assert path.read_text() == before


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a small scene with its result, and of frames for a calibration."""
    folder = tmp_path_factory.mktemp("trial") / "press"
    write_recording(folder, TINY_PRESS)
    save_result(process(load_scene(folder / "scene.toml"), ["real_contact_area"]), folder / "result.h5")
    ring = np.full((200, 220), 20, np.uint8)
    cv2.circle(ring, (110, 100), 80, 120, -1)
    cv2.circle(ring, (110, 100), 40, 20, -1)
    cv2.imwrite(str(folder / "ring.png"), ring)
    return folder


def interrupt_after(calls: int, function: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """Return a function that does what `function` does for `calls` calls and then raises KeyboardInterrupt, as Ctrl-C
    does.
    """
    made = 0

    def interrupted(*arguments: Any, **named: Any) -> Any:
        nonlocal made
        made += 1
        if made > calls or function is None:
            raise KeyboardInterrupt
        return function(*arguments, **named)

    return interrupted


@pytest.mark.parametrize(
    ("place", "calls"),
    [("fingerflow.synthetic.press.Press.render", 5), ("pathlib.Path.write_text", 1), ("pathlib.Path.rename", 0)],
)
def test_an_interrupted_simulation_leaves_nothing(
    command: Command, place: str, calls: int, tmp_path: Path, monkeypatch: Patch, capsys: Printed
) -> None:
    monkeypatch.setattr("fingerflow.synthetic.Press", lambda: TINY_PRESS)
    monkeypatch.setattr(place, interrupt_after(calls, pkgutil.resolve_name(place)))
    assert command("simulate", "press", tmp_path / "trials" / "one") == 130
    monkeypatch.undo()
    assert not [path for path in tmp_path.rglob("*") if path.name != "trials"]
    assert "nothing was left half-written" in capsys.readouterr().err


def test_a_simulation_is_there_whole(command: Command, tmp_path: Path, monkeypatch: Patch, capsys: Printed) -> None:
    monkeypatch.setattr("fingerflow.synthetic.Press", lambda: TINY_PRESS)
    assert command("simulate", "press", tmp_path / "one") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    assert load_scene(tmp_path / "one" / "scene.toml").recording.frame_rate == 8.0
    assert command("simulate", "press", tmp_path / "one") == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_a_real_interrupt_ends_a_simulation_at_once(tmp_path: Path) -> None:
    """Ctrl-C while threads render ends the command without waiting for the other frames, and removes the folder."""
    code = "from fingerflow.cli import main; main()"
    command = [sys.executable, "-c", code, "simulate", "press", "one"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as running:
        deadline = time.monotonic() + 300
        while not list(tmp_path.glob(".one-*/frames.npy")):
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.kill(running.pid, signal.SIGINT)
        _, said = running.communicate(timeout=300)
    assert running.returncode == 130, said
    assert "interrupted" in said
    assert "Traceback" not in said
    assert not list(tmp_path.iterdir())


PROCESS = ("process", "{trial}/scene.toml", "--output", "{new}/result.h5", "--json")
TABLE = ("export-table", "{trial}/result.h5")
CALIBRATE = ("calibrate", "--ring", "{trial}/ring.png", "--output", "{new}/calibration.toml")


_INTERRUPTED_IN_A_CALLBACK = """
import signal, time, weakref
from fingerflow import cli

def app(**_):
    class Thing: pass
    thing = Thing()
    kept = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGINT))
    del thing
    time.sleep(30)

cli.app = app
cli.main()
"""


def test_an_interrupt_in_a_callback_ends_the_command() -> None:
    """Ctrl-C during a callback, of which Python drops exceptions, ends the command as well."""
    running = subprocess.run([sys.executable, "-c", _INTERRUPTED_IN_A_CALLBACK], capture_output=True, text=True)
    assert (running.returncode, running.stdout) == (130, "")
    assert running.stderr == "fingerflow: interrupted; nothing was left half-written\n"


@pytest.mark.parametrize(
    ("arguments", "place", "calls"),
    [
        (PROCESS, "fingerflow.pipeline.stages.tracking.tracking_stage.TrackingStage.step", 0),
        (PROCESS, "pathlib.Path.replace", 0),
        ((*TABLE, "{new}/table.csv"), "pathlib.Path.replace", 0),
        ((*TABLE, "{new}/table.mat"), "scipy.io.savemat", 0),
        (CALIBRATE, "pathlib.Path.replace", 0),
        (("init", "{new}/scene.toml"), "pathlib.Path.replace", 0),
    ],
)
def test_an_interrupted_command_leaves_nothing(
    command: Command,
    arguments: tuple[str, ...],
    place: str,
    calls: int,
    trial: Path,
    tmp_path: Path,
    monkeypatch: Patch,
    capsys: Printed,
) -> None:
    before = sorted(trial.iterdir())
    monkeypatch.setattr(place, interrupt_after(calls))
    assert command(*(part.format(trial=trial, new=tmp_path) for part in arguments)) == 130
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())
    assert sorted(trial.iterdir()) == before
    assert "interrupted" in capsys.readouterr().err


def test_what_cannot_be_written_is_said(command: Command, trial: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for arguments in (
        ("export-table", str(trial / "result.h5"), str(tmp_path / "file" / "table.csv")),
        ("simulate", "press", str(tmp_path / "file" / "one")),
        ("init", str(tmp_path / "file" / "scene.toml")),
    ):
        assert command(*arguments) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_calibration_of_one_view(command: Command, trial: Path, tmp_path: Path, capsys: Printed) -> None:
    output = tmp_path / "calibration.toml"
    arguments = ("calibrate", "--ring", str(trial / "ring.png"), "--output", str(output), "--hole-radius-mm", "2.0")
    assert command(*arguments, "--contact", "10", "200", "5", "220") == 0
    text = output.read_text()
    assert " ± 0.0000" in capsys.readouterr().out
    assert 0 < float(text.split("mm_per_px_std = ")[1].split()[0]) < 1e-4
    assert "rows = [10, 200]" in text
    assert "columns = [5, 220]" in text
    # OpenCV's circle of radius 40 px covers the pixels within 40.5 px of its centre, without blur.
    assert float(text.split("mm_per_px = ")[1].split()[0]) == pytest.approx(2.0 / 40.25, rel=0.02)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration.png", "calibration.toml"]
    assert command(*arguments, "--topography", "0", "1", "0", "1") == 2
    assert command(*arguments, "--contact", "0", "999", "0", "1") == 2


@pytest.mark.parametrize(
    ("foreign", "arguments"),
    [("calibration.toml", CALIBRATE), ("overlay.mp4", ("report", "{new}/scene.toml", "--result", "{trial}/result.h5"))],
)
def test_a_file_of_somebody_else_is_refused(
    command: Command,
    foreign: str,
    arguments: tuple[str, ...],
    trial: Path,
    tmp_path: Path,
    monkeypatch: Patch,
    capsys: Printed,
) -> None:
    """A file that fingerflow has not written is refused before anything is computed or written; `--overwrite` replaces
    it.
    """
    new = tmp_path / "new"
    shutil.copytree(trial, new)
    (new / foreign).write_bytes(b"years of work")
    before = sorted(new.iterdir())
    filled = [part.format(trial=trial, new=new) for part in arguments]
    assert command(*filled) == 2
    said = capsys.readouterr().err
    assert foreign in said
    assert "--overwrite" in said
    assert (new / foreign).read_bytes() == b"years of work"
    assert sorted(new.iterdir()) == before
    monkeypatch.setattr("fingerflow.report.page._sections", lambda *_: [])  # figures have tests of their own
    assert command(*filled, "--overwrite") == 0
    assert (new / foreign).read_bytes() != b"years of work"


def test_a_demo_with_other_files_is_kept(tmp_path: Path) -> None:
    from fingerflow.cli.synthetic_recordings import _remove_demo

    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "truth.json").write_text("{}")
    (folder / "thesis.txt").write_text("years of work")
    with pytest.raises(FingerflowError, match=r"thesis\.txt"):
        _remove_demo(folder)
    assert (folder / "thesis.txt").exists()
    (folder / "thesis.txt").unlink()
    _remove_demo(folder)
    assert not folder.exists()
