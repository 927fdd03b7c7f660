"""Command `fingerflow study init`: writes a manifest from the files found in a folder."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.open_forces import READER_OF, holds_forces
from fingerflow.recordings.frames.open_recording import READERS
from fingerflow.results.atomic_write import write_text
from fingerflow.schema.key_types import File
from fingerflow.schema.keys import SceneKey
from fingerflow.schema.scene_tables import find_entry
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.text_file import read_text
from fingerflow.schema.toml_value import toml_value
from fingerflow.study.dotted_keys import flattened, nested
from fingerflow.study.manifest import (
    CONDITION,
    FORCES,
    KNOWN,
    PARTICIPANT,
    RECORDING,
    TRIAL,
    matching,
    relative,
    spelled_alike,
)
from fingerflow.study.spreadsheet_cell import quoted_cell

_SUFFIXES = {suffix for reader, suffixes in READERS.items() if reader != "images" for suffix in suffixes} - {".cihx"}
# Folders that `fingerflow study run` and the system write, besides those whose names begin with a dot.
_WRITTEN = ("results", "__MACOSX", "$RECYCLE.BIN", "System Volume Information", "lost+found")
_NO_TRIAL = re.compile(r"(^|[^a-z])(background|empty|dark|glass|target|ring|calib\w*)([^a-z]|$)")
# Patterns of labs' naming conventions in folder and file names. If none matches, the user fills in the value.
_GUESSES = {
    PARTICIPANT: re.compile(r"(?<![a-z])(?:participant|subject|subj|sub|s|p)[-_ ]?(\d+)(?!\d)"),
    CONDITION: re.compile(r"(\d+(?:[.,p]\d+)?)[-_ ]?(?:um|µm|micron)"),
    TRIAL: re.compile(r"(?<![a-z])(?:trial|run|rep|t)[-_ ]?(\d+)(?!\d)"),
}


def init_study(folder: Path, answers: Path | None = None) -> tuple[int, list[str]]:
    """Find the recordings in a folder, and write a manifest `study.toml` and a table `trials.csv` for them; return the
    number of trials, and the entries to complete by hand.

    If the folder holds scene files, each is a trial: common settings become the shared scene, different ones become
    columns. Otherwise each recording is a trial, with the forces of the same name or of the same folder, and the shared
    scene is to be filled in. Participant, condition (µm) and trial are taken from folder and file names.

    Args:
        folder: searched recursively.
        answers: a CSV file with participant, trial, answer and other columns of trials, such as condition.

    Raises FingerflowError if nothing is found, or a manifest exists already.
    """
    manifest, table = folder / "study.toml", folder / "trials.csv"
    for file in (manifest, table):
        if file.exists():
            raise FingerflowError(f"{file} exists already; remove it or name another folder")
    if not folder.is_dir():
        raise FingerflowError(f"{folder} is no folder; name the one that holds the recordings")
    files = [
        file
        for file in sorted(folder.rglob("*"))
        if file.is_file()
        and not any(part.startswith(".") or part in _WRITTEN for part in file.relative_to(folder).parts)
    ]
    scenes = {file: scene for file in files if file.suffix == ".toml" and (scene := _read_scene(file))}
    rows, shared = _scene_rows(folder, scenes) if scenes else (_recording_rows(folder, files), {})
    answered, matched = ([], "") if answers is None else matching(rows, answers)
    for row, answer_row in zip(rows, answered, strict=False):
        for name, value in answer_row.items():
            if value and spelled_alike(value) != spelled_alike(row.get(name, "")):
                row[name] = value
    columns = (name for row in rows for name in row)
    names = list(dict.fromkeys((*KNOWN, *columns)))
    if not any(FORCES in row for row in rows):
        names.remove(FORCES)
    write_text(table, pd.DataFrame(rows, columns=names).map(quoted_cell).to_csv(index=False, lineterminator="\n"))
    write_text(manifest, _manifest_text(shared))
    empty = {name: sum(not row.get(name) for row in rows) for name in (PARTICIPANT, CONDITION)}
    lacking = [f"{name} of {count} trials in {table.name}" for name, count in empty.items() if count]
    lacking += [f"[scene] in {manifest.name}"] if not scenes else []
    unanswered = f"{matched}{answered.count({})} of {len(rows)} trials have no answer"
    lacking += [unanswered] if {} in answered or ", not: " in matched else []
    return len(rows), lacking


def _read_scene(file: Path) -> dict[str, Any]:
    """Return the tables of a scene file; {} for another file."""
    try:
        written = tomllib.loads(read_text(file, ""))
    except (FingerflowError, ValueError, RecursionError):
        return {}
    return written if "recording" in written else {}


def _scene_rows(folder: Path, scenes: Mapping[Path, Any]) -> tuple[list[dict[str, str]], dict[str, Any]]:
    flat: list[dict[str, Any]] = []
    rows = []
    for file, written in scenes.items():
        values = dict(flattened(written))
        for name, value in values.items():
            if isinstance(key := find_entry(name), SceneKey) and isinstance(key.type, File):
                values[name] = relative(file.parent / value, folder)
        flat.append(values)
        rows.append(_guessed(file.parent.relative_to(folder) if file.stem == "scene" else file.relative_to(folder)))
    common = {name: value for name, value in flat[0].items() if all(scene.get(name) == value for scene in flat)}
    for row, values in zip(rows, flat, strict=True):
        for name, value in values.items():
            if name not in common or name == "recording.frames":
                column = {"recording.frames": RECORDING, "forces.file": FORCES}.get(name, name)
                row[column] = value if isinstance(value, str) else toml_value(value)
    common.pop("recording.frames", None)
    return rows, nested(common)


def _recording_rows(folder: Path, files: list[Path]) -> list[dict[str, str]]:
    recordings = [
        file
        for file in files
        if file.suffix.lower() in _SUFFIXES
        and not _NO_TRIAL.search(file.stem.lower())
        and not (file.suffix.lower() == ".cih" and file.with_suffix(".mraw").exists())
        and not (file.suffix.lower() in READER_OF and holds_forces(file))
    ]
    if not recordings:
        known = f"Known are {', '.join(sorted(_SUFFIXES))}; of folders of images write trials.csv by hand"
        raise FingerflowError(f"{folder}: no recording was found in it. {known}")
    rows = []
    for file in recordings:
        row = _guessed(file.relative_to(folder)) | {RECORDING: relative(file, folder)}
        beside = [path for path in files if path.parent == file.parent and path != file]
        near = [path for path in beside if path.suffix.lower() in READER_OF]
        same = [path for path in near if path.stem == file.stem]
        alone = [path for path in recordings if path.parent == file.parent] == [file]
        forces = same or (near if alone else [])
        if len(forces) == 1:
            row[FORCES] = relative(forces[0], folder)
        rows.append(row)
    return rows


def _guessed(path: Path) -> dict[str, str]:
    text = path.as_posix().lower()
    guesses: dict[str, str] = {}
    for name, expression in _GUESSES.items():
        matches = expression.findall(text)
        if matches and (name == TRIAL or len({*matches}) == 1):  # of P03/S1 either may be the participant
            guesses[name] = re.sub("[,p]", ".", matches[-1])
    return guesses


def _manifest_text(shared: Mapping[str, Any]) -> str:
    head = """# A study of fingerflow: its trials, and a scene that they share. Paths are relative to this file.
[study]
trials = "trials.csv"         # a row a trial; a column with a dot, such as tracking.points, is a key of the scene
results = "results"           # where results, the table of trials and the pages go
# design = "yes/no"           # of answers to one stimulus; "forced choice" between two where there is none

"""
    if shared:
        return head + "# What a scene file has, for all trials.\n" + _toml_tables(shared, ("scene",))
    scene = _as_scene_tables(scene_text(forces="of-each-trial.csv"))
    return f"{head}# To be filled in: what a scene file has, for all trials.\n{scene}"


def _as_scene_tables(text: str) -> str:
    """Rewrite a scene file's text as tables below [scene] in a manifest, without keys that each trial sets itself."""
    of_trials = ('frames = "frames.cine', 'file = "of-each-trial')
    shared = "".join(f"{line}\n" for line in text.splitlines()[2:] if not line.startswith(of_trials))
    return re.sub(r"^((?:# )?)\[(\w[\w.]*)\]", r"\1[scene.\2]", shared, flags=re.MULTILINE)


def _toml_tables(values: Mapping[str, Any], above: tuple[str, ...]) -> str:
    plain = {name: value for name, value in values.items() if not isinstance(value, Mapping)}
    lines_here = "".join(f"{name} = {toml_value(value)}\n" for name, value in plain.items())
    lines = [f"[{'.'.join(above)}]\n{lines_here}"] if plain else []
    tables = [_toml_tables(value, (*above, name)) for name, value in values.items() if isinstance(value, Mapping)]
    return "\n".join(lines + tables)
