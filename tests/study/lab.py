"""Folder of small recordings as in a lab: two participants, two conditions, one or two presses in each."""

import shutil
from pathlib import Path

import numpy as np

from fingerflow.study.init import init_study

TRIALS = [(1, 0, 1), (1, 0, 2), (1, 2, 1), (1, 2, 2), (2, 0, 1), (2, 2, 1)]  # participant, condition, trial


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
