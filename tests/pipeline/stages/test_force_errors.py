"""Forces that contradict themselves or the recording: refused or said, with the way out."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import process
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import Scene

Change = Callable[..., Scene]
FORCES = ["normal_force", "load_ratio"]


def rewritten(press: Path, folder: Path, **changes: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]) -> str:
    """The forces of the press with columns changed, in a file of another name; a name with "_V" changes the unit."""
    lines = (press / "forces.csv").read_text().splitlines()
    names = [cell.partition(" ")[0] for cell in lines[0].split(",")]
    values = np.array([line.split(",") for line in lines[1:]], dtype=float).T
    heading = lines[0]
    for name, change in changes.items():
        if name.endswith("_V"):
            heading = heading.replace(f"{name[:-2]} (N)", f"{name[:-2]} (V)")
            continue
        values[names.index(name)] = change(values[names.index(name)])
    np.savetxt(folder / "changed.csv", values.T, fmt="%.6f", delimiter=",", header=heading, comments="")
    return "changed.csv"


def processed(changed: Change, press: Path, file: str, **replaced: str) -> tuple[Any, str]:
    texts = {(press / "forces.csv").as_posix(): file} | {
        old.replace("_is_", " = "): new for old, new in replaced.items()
    }
    result = process(changed(texts), FORCES)
    return result, "\n".join(json.loads(result.attrs["warnings"]))


def test_the_press_as_it_is_has_nothing_to_say(changed: Change, press: Path, tmp_path: Path) -> None:
    result, said = processed(changed, press, rewritten(press, tmp_path))
    assert result["normal_force"].max() > 0.5
    assert said == ""


def test_a_force_is_no_trigger(changed: Change) -> None:
    with pytest.raises(
        FingerflowError, match=r"scene\.toml: forces\.trigger is 'normal_force', the channel of a force"
    ):
        process(changed({'trigger = "trigger"': 'trigger = "normal_force"'}), FORCES)


def test_a_trigger_in_newtons_is_said(changed: Change, press: Path, tmp_path: Path) -> None:
    file = rewritten(press, tmp_path)
    text = (tmp_path / file).read_text().replace("trigger (V)", "trigger (N)")
    (tmp_path / file).write_text(text)
    assert "the trigger 'trigger' is in N, as a force is" in processed(changed, press, file)[1]


def test_volts_are_no_force(changed: Change, press: Path, tmp_path: Path) -> None:
    with pytest.raises(
        FingerflowError, match=r"changed\.csv: column 'normal_force' .* is in V, not in N; give the sensor's sens"
    ):
        processed(changed, press, rewritten(press, tmp_path, normal_force_V=lambda values: values))


def test_a_normal_force_of_the_wrong_sign_is_refused(changed: Change, press: Path, tmp_path: Path) -> None:
    with pytest.raises(
        FingerflowError, match=r"lies between -\d.* N: pressing must be positive; give \[forces\] sign = -1"
    ):
        processed(changed, press, rewritten(press, tmp_path, normal_force=lambda values: -values))


def test_an_offset_at_rest_is_said(changed: Change, press: Path, tmp_path: Path) -> None:
    _, said = processed(changed, press, rewritten(press, tmp_path, normal_force=lambda values: values + 2.0))
    assert "'normal_force' is never below 1.99 N; if the finger was off the glass" in said
    assert "give [forces] offset or tare = [t0, t1] in the scene" in said


def test_a_trigger_without_its_frame_is_said(changed: Change, press: Path, tmp_path: Path) -> None:
    _, said = processed(changed, press, rewritten(press, tmp_path), trigger_frame_is_1="")
    assert "nothing says in which frame it came: frame 0 is taken; give [recording] trigger_frame" in said


def test_a_damaged_frame_of_the_background_does_not_count(changed: Change, press: Path, tmp_path: Path) -> None:
    import h5py

    empty = np.load(press / "empty.npy")
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        stack = file.create_dataset("x", (3, *empty.shape), "f4", chunks=(1, *empty.shape))
        stack[0] = stack[2] = empty
    replaced = {(press / "empty.npy").as_posix(): "empty.h5", 'threshold = "reference_frame"': "threshold = 0.25"}
    damaged = process(changed(replaced), ["real_contact_area"])
    whole = process(changed({'threshold = "reference_frame"': "threshold = 0.25"}), ["real_contact_area"])
    np.testing.assert_allclose(damaged["real_contact_area"], whole["real_contact_area"])
    assert damaged["real_contact_area"].max() > 1
