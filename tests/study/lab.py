"""Folder of small recordings as in a lab: two participants, two conditions, and one press per trial."""

import shutil
from pathlib import Path

import numpy as np

from fingerflow.study.init import init_study
from fingerflow.synthetic import write_recording
from tests.small_trials import TINY_PRESS

TRIALS = [(participant, condition, trial) for participant in (1, 2) for condition in (0, 2) for trial in (1, 2)]


def write_one_press(folder: Path) -> Path:
    """Write the recording of which all trials are copies, and return its folder."""
    write_recording(folder, TINY_PRESS)
    return folder


def write_files(folder: Path, press: Path) -> None:
    """Write folders such as p01/2um/trial1, and answers.csv beside them; recordings differ in one pixel
    of the glass.
    """
    lines = ["participant,trial,condition,answer"]
    for number, (participant, condition, trial) in enumerate(TRIALS):
        place = folder / f"p{participant:02d}" / f"{condition}um" / f"trial{2 * (condition > 0) + trial}"
        shutil.copytree(press, place)
        frames = np.load(place / "frames.npy")
        frames[:, 0, -1] = number
        np.save(place / "frames.npy", frames)
        lines.append(f"{participant:02d},{2 * (condition > 0) + trial},{condition},{number % 2}")
    (folder / "answers.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_lab(folder: Path, press: Path) -> None:
    """Write these files with the manifest of their study."""
    write_files(folder, press)
    init_study(folder, folder / "answers.csv")
