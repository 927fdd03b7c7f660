"""Recordings of a simulated study with known truth: two presses per trial, and the observer's answers."""

import csv
import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fingerflow.results.atomic_write import write_text
from fingerflow.study.simulated_trials import Design, Presses, answer_table, draw_presses, make_recording
from fingerflow.synthetic import write_recording

_COLUMNS = ("participant", "trial", "reference", "answer", "true_friction", "true_softness", "true_force",
            "true_divergence", "true_real_contact_area", "true_gross_contact_area", "true_force_angle",
            "true_displacement")  # fmt: skip


def write_recordings(folder: Path, design: Design) -> None:
    """Simulate all presses of a study as recordings in a folder, with the observer's answers and the true values.

    Each press is a `ChainPress` recording with its scene. `answers.csv` has answers and true values, `truth.json` the
    design. Odd trials of a participant are references, the next even ones their comparisons, which have the answer and
    name their reference. Recordings that the folder has already are kept, so that an interrupted call goes on.

    Raises FingerflowError if a recording cannot be written.
    """
    presses = draw_presses(design)
    answers = answer_table(design, *presses.pairs())
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    names = []
    for number, participant in enumerate(presses.participant):
        trial = number - int(np.searchsorted(presses.participant, participant)) + 1
        pair, is_comparison = divmod(number, 2)
        of_pair = (f"{trial - 1:03d}", int(answers[pair])) if is_comparison else ("", "")
        names.append(f"p{participant + 1:02d}/{presses.amplitude[number]:g}um/trial{trial:03d}")
        writer.writerow((f"{participant + 1:02d}", f"{trial:03d}", *of_pair, *_truth(presses, number)))
    write_text(folder / "answers.csv", text.getvalue())
    write_text(folder / "truth.json", json.dumps(asdict(design)))
    for number, name in enumerate(tqdm(names, desc="synthetic presses", unit="press")):
        if not (folder / name).exists():
            write_recording(folder / name, make_recording(design, presses, number), progress=False)


def _truth(presses: Presses, number: int) -> tuple[str, ...]:
    moved, areas = np.hypot(*presses.shift.T), (presses.real_contact_area, presses.gross_contact_area)
    of_press = presses.friction, presses.softness, presses.force, presses.divergence, *areas, presses.angle, moved
    return tuple(f"{values[number]:.6g}" for values in of_press)
