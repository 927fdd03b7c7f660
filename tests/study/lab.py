"""A folder of small recordings as a lab has it: two participants, two conditions, each trial a press of its own."""

import shutil
from pathlib import Path

import numpy as np

from fingerflow.study.init import init_study
from fingerflow.synthetic import write_recording
from tests.small_trials import TINY_PRESS

TRIALS = [(participant, condition, trial) for participant in (1, 2) for condition in (0, 2) for trial in (1, 2)]


def write_one_press(folder: Path) -> Path:
    """The recording that all trials are copies of."""
    write_recording(folder, TINY_PRESS)
    return folder


def write_files(folder: Path, press: Path) -> None:
    """Folders such as p01/2um/trial1, with answers.csv beside; each recording differs in a pixel of the glass."""
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
    """The same with the manifest of its study."""
    write_files(folder, press)
    init_study(folder, folder / "answers.csv")
