"""Manifest of a study, `study.toml`: recordings, shared scene settings, and a table of trials."""

import os
import re
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError, did_you_mean
from fingerflow.models.observer.psychometric import FORCED_CHOICE, GUESSES
from fingerflow.recordings.delimited import is_numeric
from fingerflow.recordings.recording_files import equal_recordings
from fingerflow.schema.key_list import key_list
from fingerflow.schema.scene import Scene, parse_toml, scene_from
from fingerflow.schema.scene_tables import find_entry
from fingerflow.schema.text_file import read_text
from fingerflow.schema.trial_columns import OF_RESULTS
from fingerflow.study.dotted_keys import nested
from fingerflow.study.trial_rows import ANSWERS, NOTHING, read_rows

#: Columns of a table of trials that a study reads. A column name with a dot is a key of the scene.
KNOWN = RECORDING, FORCES, PARTICIPANT, TRIAL, CONDITION, ANSWER = (
    "recording", "forces", "participant", "trial", "condition", "answer",
)  # fmt: skip
REFERENCE = "reference"  # column that names the trial of the same participant with which a trial was compared
_KEY_OF = {RECORDING: "recording.frames", FORCES: "forces.file"}
_STUDY_KEYS = ("results", "trials", "answers", "design")
_MOST_SHOWN = 20  # largest number of wrong rows, and of those without a partner, that are listed; others are counted


@dataclass(frozen=True)
class TrialEntry:
    """One trial of a study: a row of the table of trials.

    Attributes:
        name: of its folder among the results, unique in the study.
        origin: "trials.csv, row 7", for errors.
        participant, trial, condition: as written in the row; an empty trial becomes the number of the row.
        answer: True if the comparison was felt as more slippery, None without an answer.
        extra: columns that are neither of these nor keys of the scene; they are copied to the table of trials.
        settings: tables and keys of the scene that differ from the shared one, including the recording.
    """

    name: str
    origin: str
    participant: str
    trial: str
    condition: str
    answer: bool | None
    extra: Mapping[str, str]
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Manifest:
    """Manifest of a study; `shared` holds the scene settings of all trials, which each trial may override."""

    path: Path
    results: Path
    shared: Mapping[str, Any]
    trials: tuple[TrialEntry, ...]
    design: str = FORCED_CHOICE  # design of the experiment: a name in GUESSES
    matched: str = ""  # trials that have an answer, rows of answers without a trial, and recordings that are equal

    def build_scene(self, entry: TrialEntry) -> Scene:
        """Return the scene of a trial: the study's shared settings, overridden by the trial's own; raise
        FingerflowError with row, key, value and remedy if it is invalid.
        """
        shared = _merged({"rig": {"participant": entry.participant}}, self.shared)
        return scene_from(_merged(shared, entry.settings), self.path, f"{entry.origin}: [scene] of {self.path}")


def load_manifest(path: str | Path) -> Manifest:
    """Read a manifest `study.toml` and its trials, listed in a CSV file.

    ::

        [study]
        trials = "trials.csv"             # columns recording, forces, participant, trial, condition, answer
        results = "results"
        # design = "yes/no"               "forced choice" where there is none

        [scene.views.contact]             # and so on: what a scene file has, for all trials
        ...

    A column with a dot, such as `tracking.points`, is a key of the scene that differs from trial to trial; a column
    `reference` names the trial of the same participant that a trial was compared with.

    Raises FingerflowError for a file that is missing or not TOML, an unknown key or column, an incomplete row
    or a duplicate one; the message names the row.
    """
    path = Path(path).resolve()
    if path.is_dir():
        path = path / "study.toml"
    written = parse_toml(read_text(path, "`fingerflow study init FOLDER` writes study.toml"), path)
    study, shared = written.get("study", {}), written.get("scene", {})
    if not isinstance(study, dict) or not isinstance(shared, dict):
        raise FingerflowError(f"{path}: study and scene are tables, [study] and [scene.views.contact]")
    for table, names, known in (("", written, ("study", "scene")), ("study.", study, _STUDY_KEYS)):
        for name in names:
            if name not in known:
                hint = f"{did_you_mean(name, known)}known here: {', '.join(known)}"
                raise FingerflowError(f"{path}: {table}{name} is not a key; {hint}")
    for key, value in study.items():
        if not isinstance(value, str) or not value:
            raise FingerflowError(f"{path}: study.{key} is {value!r}; give a path in quotes")
    design = study.get("design", FORCED_CHOICE)
    if design not in GUESSES:
        raise FingerflowError(f"{path}: study.design is {design!r}; give {' or '.join(map(repr, GUESSES))}")
    if "trials" not in study:
        raise FingerflowError(f"{path}: [study] needs trials, a CSV file; `fingerflow study init FOLDER` writes one")
    trials_path = path.parent / study["trials"]
    rows = read_rows(trials_path)
    matched = ""
    if "answers" in study:
        answer_rows, matched = matching(rows, path.parent / study["answers"])
        for row, answer_row in zip(rows, answer_rows, strict=True):
            there, here = (spelled_alike(each.get(CONDITION, "")) for each in (answer_row, row))
            if there and here and there != here:
                raise FingerflowError(
                    f"{study['answers']}: condition {there} of participant {row[PARTICIPANT]}, trial {row[TRIAL]} is "
                    f"{here} in {trials_path}; correct one"
                )
            row.update({name: value for name, value in answer_row.items() if not row.get(name)})
            row.setdefault(ANSWER, "")
    results = (path.parent / study.get("results", "results")).resolve()
    trials = _entries(rows, trials_path, path)
    without = [entry.name for entry in trials if entry.answer is None]
    if len(without) < len(trials):
        matched += f"{len(trials) - len(without)} of {len(trials)} trials have an answer{_listed('; without', without)}"
    trial_of = {frames_of(entry, path): entry.name for entry in trials}
    copies = [
        f"trials {trial_of[first]} and {trial_of[second]} show one recording: {relative(first, path.parent)} and "
        f"{relative(second, path.parent)} have the same bytes, as one was copied over the other; copy both again"
        for first, second in equal_recordings(trial_of)
    ]
    return Manifest(path, results, shared, trials, design, "\n".join([*copies, *([matched] if matched else [])]))


def frames_of(entry: TrialEntry, manifest: Path) -> Path:
    """Return the file or folder with the frames of a trial in the table of trials of a manifest."""
    return (manifest.parent / entry.settings["recording"]["frames"]).resolve()


def _listed(words: str, names: Sequence[str]) -> str:
    """Return names behind the words that say what they are, "" for none."""
    more = f" and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
    return f"{words}: {', '.join(names[:_MOST_SHOWN])}{more}" if names else ""


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with forward slashes, even if the path lies outside that folder."""
    return Path(os.path.relpath(path, folder)).as_posix()


def matching(rows: Sequence[Mapping[str, str]], answers: Path) -> tuple[list[dict[str, str]], str]:
    """Return, for each row of the table of trials, the row of the table `answers` of the same participant and trial
    number, {} if there is none, and a sentence that says which rows matched.

    The condition counts too, if both tables have it. Identifiers are compared by `spelled_alike`.

    Raises FingerflowError if the table lacks one of these columns or the answer, lists a trial twice, has a row of
    several trials, or no row of any trial.
    """
    table = read_rows(answers)
    lacking = [name for name in (PARTICIPANT, TRIAL, ANSWER) if name not in table[0]]
    if lacking:
        raise FingerflowError(f"{answers}: has no column {', '.join(lacking)}; it has {', '.join(table[0])}")
    with_condition = CONDITION in table[0] and all(row.get(CONDITION) for row in rows)
    names = (PARTICIPANT, TRIAL, *([CONDITION] if with_condition else []))

    def key(row: Mapping[str, str]) -> tuple[str, ...]:
        return tuple(spelled_alike(row.get(name, "")) for name in names)

    trials = Counter(map(key, rows))
    answer_rows: dict[tuple[str, ...], dict[str, str]] = {}
    for number, row in enumerate(table, start=2):
        label = f"{answers}, row {number}: {', '.join(f'{name} {row[name]}' for name in names)}"
        if key(row) in answer_rows:
            raise FingerflowError(f"{label} is there twice")
        if trials[key(row)] > 1:
            remedy = f"give the column {CONDITION} in both tables, or number the trials of a participant"
            raise FingerflowError(f"{label} is {trials[key(row)]} trials of the study; {remedy}")
        answer_rows[key(row)] = row
    matched = [answer_rows.get(key(row), {}) for row in rows]
    strays = [
        " ".join(f"{name} {row[name]}" for name in names) for match, row in answer_rows.items() if match not in trials
    ]
    if not any(matched):
        trial, answer = (", ".join(f"{name} {row.get(name, '')!r}" for name in names) for row in (rows[0], table[0]))
        raise FingerflowError(f"{answers}: none of its trials is one of the study, such as {trial}; it has {answer}")
    count = f"{answers.name}: {len(table) - len(strays)} of {len(table)} rows belong to trials"
    return matched, f"{count}{_listed(', not', strays)}; "


def spelled_alike(name: str) -> str:
    """Return a participant, trial or condition in the spelling that tables are joined by: 01 and 1, 2.0 and 2, .5 and
    0,5, P01 and p 1 are the same, as are characters that look alike (Unicode's NFKC).
    """
    name = "".join(unicodedata.normalize("NFKC", name).casefold().split())
    if len(name) < 16 and is_numeric([name]):  # a float holds so many digits
        return f"{float(name.replace(',', '.')) + 0.0}"  # of -0 too
    return re.sub(r"(?<![\d.,])0+(?=\d)", "", name)


def _entries(rows: list[dict[str, str]], table: Path, path: Path) -> tuple[TrialEntry, ...]:
    lacking = [name for name in (RECORDING, PARTICIPANT, CONDITION) if name not in rows[0]]
    if lacking:
        remedy = f"{did_you_mean(lacking[0], rows[0])}there are {', '.join(rows[0])}"
        raise FingerflowError(f"{table}: there is no column {', '.join(lacking)}; {remedy}")
    for name in rows[0]:
        if "." in name and not name.startswith("views.") and find_entry(name) is None:
            hint = did_you_mean(name, key_list())
            raise FingerflowError(f"{table}: the column {name!r} is no key of a scene; {hint}see `fingerflow keys`")
        if name in OF_RESULTS:
            raise FingerflowError(f"{table}: the column {name!r} is one that the study measures; rename it")
    wrong, entries = [], []
    for number, row in enumerate(rows, start=1):
        try:
            entries.append(_entry(row, f"{table}, row {number + 1}", str(number)))
        except FingerflowError as error:
            wrong.append(str(error))
    trials = Counter((entry.participant, entry.trial) for entry in entries)
    firsts, spellings = dict[Any, str](), dict[tuple[str, str], str]()
    for entry in entries:
        spelled = tuple(map(spelled_alike, (entry.participant, entry.condition, entry.trial)))
        if (first := firsts.setdefault(spelled, entry.origin)) != entry.origin:
            wrong.append(
                f"{entry.origin}: trial {entry.trial} of participant {entry.participant}, condition {entry.condition}, "
                f"is also {first}; number the trials"
            )
        compared = str({**entry.settings, "forces": 0, "background": 0})
        if (first := firsts.setdefault(compared, entry.origin)) != entry.origin:
            wrong.append(f"{entry.origin}: its recording and settings are those of {first}; name its own recording")
        for name, text in ((PARTICIPANT, entry.participant), (CONDITION, entry.condition)):
            if text != (other := spellings.setdefault((name, spelled_alike(text)), text)):
                wrong.append(f"{entry.origin}: {name} is {text!r}, and {other!r} in another row; write both alike")
        named = entry.extra.get(REFERENCE)
        if named and (count := trials[entry.participant, named]) != 1:
            wrong.append(
                f"{entry.origin}: reference is {named!r}, and {count} trials of participant {entry.participant} have "
                f"that number; name one"
            )
    if wrong:
        rest = [f"and {len(wrong) - _MOST_SHOWN} rows more in {path}"] if len(wrong) > _MOST_SHOWN else []
        raise FingerflowError("\n".join(wrong[:_MOST_SHOWN] + rest))
    return tuple(entries)


def _entry(row: Mapping[str, str], label: str, number: str) -> TrialEntry:
    for name in (RECORDING, PARTICIPANT, CONDITION):
        if not row[name]:
            raise FingerflowError(f"{label}: {name} is empty; fill it in, or remove the row")
    answer = row.get(ANSWER, "").lower()
    if answer not in ANSWERS and answer not in NOTHING:
        remedy = "give 1 where the comparison was felt as more slippery, 0 where not, nothing where there is no answer"
        raise FingerflowError(f"{label}: answer is {row[ANSWER]!r}; {remedy}")
    settings = {_KEY_OF[name]: row[name] for name in _KEY_OF if row.get(name)}
    settings |= {name: _parse_cell(cell) for name, cell in row.items() if "." in name and cell}
    trial = row.get(TRIAL) or number
    parts = (row[PARTICIPANT], row[CONDITION], trial)
    # Unique as a file name: characters but letters, digits, dots and dashes become %xx.
    name = "_".join(re.sub(r"[^\w.-]|_", lambda match: f"%{ord(match[0]):02x}", part, flags=re.ASCII) for part in parts)
    return TrialEntry(
        name=name,
        origin=label,
        participant=row[PARTICIPANT],
        trial=trial,
        condition=row[CONDITION],
        answer=ANSWERS.get(answer),
        extra={name: cell for name, cell in row.items() if name not in KNOWN and "." not in name},
        settings=nested(settings),
    )


def _parse_cell(cell: str) -> Any:
    """Parse a cell of the table of trials as a TOML value; a cell that is no TOML value stays text."""
    try:
        return tomllib.loads(f"value = {cell}")["value"]
    except (ValueError, RecursionError):
        return cell


def _merged(shared: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(shared)
    for name, value in changes.items():
        there = merged.get(name)
        merged[name] = _merged(there, value) if isinstance(there, Mapping) and isinstance(value, Mapping) else value
    return merged
