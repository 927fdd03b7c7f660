"""Tests of the manifest of a study and its table, and errors that name the row."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import recording_files
from fingerflow.recordings.recording_files import equal_recordings
from fingerflow.study.init import init_study
from fingerflow.study.manifest import Manifest, load_manifest
from tests.small_trials import edit


def test_the_manifest_of_the_documentation(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/study.md").read_text(encoding="utf-8")
    manifest, table = (re.findall(rf"^```{kind}\n(.*?)^```", page, re.M | re.S)[0] for kind in ("toml", "text"))
    (tmp_path / "study.toml").write_text(manifest, encoding="utf-8")
    (tmp_path / "trials.csv").write_text(table, encoding="utf-8")
    (tmp_path / "answers.csv").write_text("participant,trial,answer\n01,1,0\n", encoding="utf-8")
    (tmp_path / "empty.cine").touch()
    for name in ("p01/0um/t1", "p01/2um/t2"):
        (tmp_path / name).parent.mkdir(parents=True)
        for suffix in (".cine", ".csv"):
            (tmp_path / name).with_suffix(suffix).touch()
    study = load_manifest(tmp_path)
    assert [entry.name for entry in study.trials] == ["01_0_1", "01_2_2"]
    assert [entry.answer for entry in study.trials] == [True, False]  # the table takes precedence
    assert [study.build_scene(entry).tracking.points for entry in study.trials] == [700, 500]


def test_a_reference_is_one_trial_of_the_participant(study: Manifest, lab: Path) -> None:
    def with_reference(of_third: str) -> Manifest:
        rows = table.splitlines()
        rows = [
            f"{row},{'reference' if not number else of_third if number == 3 else ''}" for number, row in enumerate(rows)
        ]
        (lab / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        return load_manifest(lab)

    table = (lab / "trials.csv").read_text(encoding="utf-8")
    first = study.trials[0]
    assert with_reference(first.trial).trials[2].extra["reference"] == first.trial
    with pytest.raises(FingerflowError, match="row 4: reference is 'nine', and 0 trials of participant 01"):
        with_reference("nine")


def test_scene_files_become_a_shared_scene_and_columns(study: Manifest, lab: Path) -> None:
    assert [entry.name for entry in study.trials][:3] == ["01_0_1", "01_0_2", "01_2_3"]
    assert [entry.answer for entry in study.trials] == [False, True] * 3
    scene = study.build_scene(study.trials[2])
    assert scene.recording.frames == lab / "p01/2um/trial3/frames.npy"
    assert scene.background.frames == lab / "p01/2um/trial3/empty.npy"
    assert scene.forces is not None
    assert scene.forces.file == lab / "p01/2um/trial3/forces.csv"
    assert scene.tracking.points == 700


def test_a_column_with_a_dot_is_a_key_of_the_scene(study: Manifest, lab: Path) -> None:
    lines = (lab / "trials.csv").read_text(encoding="utf-8").splitlines()
    lines = [f"{lines[0]},tracking.points,hand", f"{lines[1]},200,left", *(f"{line},,right" for line in lines[2:])]
    (lab / "trials.csv").write_text("\n".join(lines), encoding="utf-8")
    changed = load_manifest(lab)
    assert changed.build_scene(changed.trials[0]).tracking.points == 200
    assert changed.build_scene(changed.trials[1]).tracking.points == 700
    assert changed.trials[0].extra["hand"] == "left"


@pytest.mark.parametrize(
    ("edits", "column", "messages"),
    [
        (
            [("01,2,0,1", "01,2,0,maybe"), ("01,3,2,0", "01,3,,0")],
            "",
            ["trials.csv, row 3: answer is 'maybe'", "trials.csv, row 4: condition is empty"],
        ),
        ([("trial2/frames", "trial1/frames")], "", ["row 3: its recording and settings are those of"]),
        ([("01,2,0,1", "01,01,0,1")], "", ["row 3: trial 01 of participant 01, condition 0, is also", "row 2"]),
        ([], "tracking.pionts", ["did you mean 'tracking.points'"]),
        ([], "divergence", ["is one that the study measures"]),
    ],
)
def test_wrong_rows_and_columns_are_named(
    study: Manifest, lab: Path, edits: list[tuple[str, str]], column: str, messages: list[str]
) -> None:
    edit(lab / "trials.csv", *edits)
    if column:
        first, *lines = (lab / "trials.csv").read_text(encoding="utf-8").splitlines()
        text = "\n".join([f"{first},{column}", *(f"{line},1" for line in lines)])
        (lab / "trials.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FingerflowError) as raised:
        load_manifest(lab)
    assert all(message in str(raised.value) for message in messages)


def test_a_wrong_scene_names_the_row_and_the_key(study: Manifest, lab: Path) -> None:
    edit(lab / "trials.csv", ("p02/2um/trial3/frames.npy", "p02/2um/gone.npy"))
    changed = load_manifest(lab)
    with pytest.raises(FingerflowError, match=r"trials.csv, row 7: .*recording.frames .*gone.npy.* does not exist"):
        changed.build_scene(changed.trials[5])


def test_the_design_is_a_forced_choice_unless_it_is_named(study: Manifest, lab: Path) -> None:
    assert study.design == "forced choice"
    edit(lab / "study.toml", ('trials = "trials.csv"', 'trials = "trials.csv"\ndesign = "yes/no"'))
    assert load_manifest(lab).design == "yes/no"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[study]", "[studies]", "studies is not a key; did you mean 'study'"),
        ('trials = "trials.csv"', 'trails = "trials.csv"', "study.trails is not a key; did you mean 'trials'"),
        ('trials = "trials.csv"', "trials = 3", "study.trials is 3"),
        ('trials = "trials.csv"', 'trials = "trials.csv"\ndesign = "2afc"', "design is '2afc'; give 'forced choice'"),
        ('trials = "trials.csv"', "", "needs trials"),
        ("[study]", "[study", "is not valid TOML"),
    ],
)
def test_wrong_manifests(study: Manifest, lab: Path, old: str, new: str, said: str) -> None:
    edit(lab / "study.toml", (old, new))
    with pytest.raises(FingerflowError, match=said):
        load_manifest(lab)


def test_recordings_without_scenes(lab: Path) -> None:
    for scene in lab.rglob("scene.toml"):
        scene.unlink()
    with (lab / "answers.csv").open("a") as answers:
        answers.write("07,9,0,1\n")
    count, (lacking, strays) = init_study(lab, lab / "answers.csv")
    assert (count, lacking) == (6, "[scene] in study.toml")
    assert strays.startswith("answers.csv: 6 of 7 rows belong to trials, not: participant 07 trial 9 condition 0; 0 of")
    manifest = load_manifest(lab)
    assert manifest.trials[0].settings["forces"] == {"file": "p01/0um/trial1/forces.csv"}
    assert {entry.condition for entry in manifest.trials} == {"0", "2"}


def test_two_participants_in_a_path_are_left_to_be_filled_in(lab: Path) -> None:
    (lab / "p01").rename(lab / "p01_s2")
    assert "participant of 4 trials in trials.csv" in init_study(lab)[1]


def test_a_recording_copied_over_another_is_named(study: Manifest, lab: Path) -> None:
    assert "\n" not in study.matched
    shutil.copy(lab / "p01/0um/trial1/frames.npy", lab / "p02/2um/trial3/frames.npy")
    said = load_manifest(lab).matched
    assert said.startswith("trials 01_0_1 and 02_2_3 show one recording: p01/0um/trial1/frames.npy and p02/")


def test_equal_recordings_are_read_once_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of n copies n - 1 are compared with the first, not each with each; links to one file are not read."""
    copies = [tmp_path / f"{number}.npy" for number in range(8)]
    for copy in copies:
        copy.write_bytes(b"frames")
    copies[7].unlink()
    os.link(copies[6], copies[7])
    compared = []
    monkeypatch.setattr(recording_files, "cmp", lambda *files, **_: bool(compared.append(files)) or True)
    assert equal_recordings(copies) == [(copies[0], copy) for copy in copies[1:]]
    assert equal_recordings(copies[6:]) == [(copies[6], copies[7])]
    assert compared == [(copies[0], copy) for copy in copies[1:]]


def test_names_of_trials_never_collide(study: Manifest, lab: Path) -> None:
    edit(lab / "trials.csv", ("01,1,0,0", "a_b,c,0,0"))
    edit(lab / "trials.csv", ("01,2,0,1", "a,b_c,0,1"))
    names = [entry.name for entry in load_manifest(lab).trials]
    assert len(set(names)) == len(names)
    assert names[0] == "a%5fb_0_c"


_TRIALS = "recording,participant,trial,condition,answer\n" + "".join(
    f"{person}_{condition}.npy,{person},{{}},{condition},\n" for person in ("01", "02") for condition in ("0", "2")
)
ANSWERS = {
    "leading zeros": ("1212", "participant,trial,answer\n1,1,1\n1,2,0\n2,1,0\n2,2,1\n", [True, False, False, True]),
    "decimals": ("1212", "participant,trial,answer\n1.0,1e0,1.0\n\uff11.0,+2.0,0.0\n", [True, False, None, None]),
    "semicolons": ("1212", "participant;trial;condition;answer\n1;1;0,0;1\n1;2;2,0;0\n", [True, False, None, None]),
    "each condition": ("1111", "participant,trial,condition,answer\n01,1,0,0\n01,1,2,1\n", [False, True, None, None]),
    "strays": ("1212", "participant,trial,answer\n1,1,1\n9,1,0\n9,2,0\n", [True, None, None, None]),
    "shared": ("1111", "participant,trial,answer\n01,1,1\n", "row 2: participant 01, trial 1 is 2 trials of the study"),
    "twice": ("1212", "participant,trial,answer\n01,1,1\n1,1,0\n", "row 3: participant 1, trial 1 is there twice"),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_answers_belong_to_participant_condition_and_trial(
    case: str, tmp_path: Path, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    numbers, answers, expected = ANSWERS[case]
    (tmp_path / "trials.csv").write_text(_TRIALS.format(*numbers))
    (tmp_path / "answers.csv").write_text(answers)
    (tmp_path / "study.toml").write_text('[study]\ntrials = "trials.csv"\nanswers = "answers.csv"\n')
    if isinstance(expected, str):
        with pytest.raises(FingerflowError, match=expected):
            load_manifest(tmp_path)
        return
    study = load_manifest(tmp_path)
    assert [entry.answer for entry in study.trials] == expected
    count = sum(answer is not None for answer in expected)
    strays = ", not: participant 9 trial 1, participant 9 trial 2" if case == "strays" else ""
    assert f"{count} of {answers.count(chr(10)) - 1} rows belong to trials{strays}; " in study.matched
    without = ", ".join(entry.name for entry in study.trials if entry.answer is None)
    assert command("study", "report", tmp_path) == 2  # nothing is measured
    assert study.matched in capsys.readouterr().out
    assert study.matched.endswith(f"{count} of 4 trials have an answer" + (f"; without: {without}" if without else ""))


SPELLINGS = [(",02,", ",\uff11,", "'\uff11', and '01'"), ("01,1,0", "01,1,-.0e1", "'0', and '-.0e1'")]


@pytest.mark.parametrize(("old", "new", "said"), SPELLINGS)
def test_a_name_written_in_two_ways_is_named(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_text(_TRIALS.format(*"1212").replace(old, new), encoding="utf-8")
    (tmp_path / "study.toml").write_text('[study]\ntrials = "trials.csv"\n')
    with pytest.raises(FingerflowError, match=rf"row 4: \w+ is {said} in another row; write both alike"):
        load_manifest(tmp_path)


def test_files_of_the_system_and_results_are_no_trials(lab: Path) -> None:
    count, _ = init_study(lab)
    for name in ("study.toml", "trials.csv"):
        (lab / name).unlink()
    for folder in (".Trashes", "results", "__MACOSX"):
        (lab / folder).mkdir()
        (lab / folder / "a.npy").write_bytes(b"x")
        (lab / folder / "scene.toml").write_text("[recording]\n")
    (lab / "p01" / "._scene.toml").write_text("[recording]\n")
    assert init_study(lab)[0] == count
