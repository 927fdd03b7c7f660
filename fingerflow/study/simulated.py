"""Recordings of a simulated study with known truth: two presses per trial, and the observer's answers."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from fingerflow.results.atomic_write import write_text
from fingerflow.study.simulated_trials import Design, answer_table, draw_presses, make_recording
from fingerflow.synthetic import write_recording

_TRUE = ("friction", "softness", "force", "divergence", "real_contact_area", "gross_contact_area")


def write_recordings(folder: Path, design: Design) -> None:
    """Simulate all presses of a study as recordings in a folder, with the observer's answers and the true values.

    Each press is a `ChainPress` recording with its scene. `answers.csv` has answers and true values, `truth.json` the
    design. Odd trials of a participant are references, the next even ones their comparisons, which have the answer and
    name their reference. Recordings that the folder has already are kept, so that an interrupted call goes on.

    Raises FingerflowError if a recording cannot be written.
    """
    presses = draw_presses(design)
    number = np.arange(presses.participant.size)
    people = [f"{person + 1:02d}" for person in presses.participant]
    trials = [f"{trial + 1:03d}" for trial in number - np.searchsorted(presses.participant, presses.participant)]
    answers = np.repeat(answer_table(design, *presses.pairs()), 2).astype(int)
    is_comparison = number % 2 == 1
    columns = {
        "participant": people,
        "trial": trials,
        "reference": np.where(is_comparison, np.roll(trials, 1), ""),
        "answer": np.where(is_comparison, answers.astype(str), ""),
    }
    columns |= {f"true_{name}": getattr(presses, name) for name in _TRUE}
    columns |= {"true_force_angle": presses.angle, "true_displacement": np.hypot(*presses.shift.T)}
    table = pd.DataFrame(columns).to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_text(folder / "answers.csv", table)
    write_text(folder / "truth.json", json.dumps(asdict(design)))
    names = (f"p{who}/{um:g}um/trial{trial}" for who, um, trial in zip(people, presses.amplitude, trials, strict=True))
    for press, name in enumerate(tqdm(names, desc="synthetic presses", unit="press", total=len(people))):
        if not (folder / name).exists():
            write_recording(folder / name, make_recording(design, presses, press), progress=False)
