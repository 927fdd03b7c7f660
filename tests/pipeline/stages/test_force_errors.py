"""Tests of forces that contradict themselves or the recording: an error or a warning that states a remedy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import process
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import Scene
from tests.small_trials import warnings_of

Change = Callable[..., Scene]
FORCES = ["normal_force", "load_ratio"]


def processed(changed: Change, press: Path, folder: Path, edit: str = "", replaced: str = "") -> tuple[Any, str]:
    """Return the result and the warnings of the press with a modified force file and without a text of the scene."""
    lines = (press / "forces.csv").read_text().splitlines()
    heading, values = lines[0], np.array([line.split(",") for line in lines[1:]], dtype=float)
    normal = [cell.partition(" ")[0] for cell in heading.split(",")].index("normal_force")
    if edit == "negative":
        values[:, normal] *= -1
    elif edit == "offset":
        values[:, normal] += 2.0
    elif edit:
        old, _, new = edit.partition(" -> ")
        assert heading.count(old) == 1
        heading = heading.replace(old, new)
    np.savetxt(folder / "changed.csv", values, fmt="%.6f", delimiter=",", header=heading, comments="")
    texts = {(press / "forces.csv").as_posix(): "changed.csv"} | ({replaced: ""} if replaced else {})
    result = process(changed(texts), FORCES)
    return result, warnings_of(result)


def test_the_press_as_it_is_has_nothing_to_say(changed: Change, press: Path, tmp_path: Path) -> None:
    result, said = processed(changed, press, tmp_path)
    assert result["normal_force"].max() > 0.5
    assert said == ""


def test_a_force_is_no_trigger(changed: Change) -> None:
    with pytest.raises(
        FingerflowError, match=r"scene\.toml: forces\.trigger is 'normal_force', the channel of a force"
    ):
        process(changed({'trigger = "trigger"': 'trigger = "normal_force"'}), FORCES)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (
            "normal_force (N) -> normal_force (V)",
            r"changed\.csv: column 'normal_force' .* is in V, not in N; give",
        ),
        ("negative", r"lies between -\d.* N: pressing must be positive; give \[forces\] sign = -1"),
    ],
)
def test_what_cannot_be_a_force_is_refused(changed: Change, press: Path, tmp_path: Path, edit: str, said: str) -> None:
    with pytest.raises(FingerflowError, match=said):
        processed(changed, press, tmp_path, edit)


@pytest.mark.parametrize(
    ("edit", "replaced", "said"),
    [
        ("trigger (V) -> trigger (N)", "", "the trigger 'trigger' is in N, as a force is"),
        ("offset", "", "'normal_force' is never below 1.99 N; if the finger was off the glass"),
        ("offset", "", "give [forces] offset or tare = [t0, t1] in the scene"),
        (
            "",
            "trigger_frame = 1",
            "nothing says in which frame it came: frame 0 is taken; give [recording] trigger_frame",
        ),
    ],
)
def test_a_doubtful_force_is_said(
    changed: Change, press: Path, tmp_path: Path, edit: str, replaced: str, said: str
) -> None:
    assert said in processed(changed, press, tmp_path, edit, replaced)[1]


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
