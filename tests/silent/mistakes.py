"""Mistakes that a new user makes on the command line, in the scene file, on the page, with forces, studies and streams.

Each mistake is made on a small press that is complete; `settings` has those that contradict the data. The message must
be an error or a warning that names file, value and remedy.
"""

import contextlib
import io
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np

from fingerflow import cli, process
from fingerflow.schema.recipe import PointSettings, Recipe, ViewRecipe
from fingerflow.study.init import init_study
from fingerflow.synthetic import write_recording
from fingerflow.view.draft import Draft
from tests.silent.case import Case
from tests.small_trials import TINY_PRESS, edit, write_library_bundle

#: What stands before errors and warnings.
MARKS = ("fingerflow: ", "Error: ", "error: ", "warning: ")
PROCESS = ("process", "scene.toml")
STREAM = ("stream", "bundle", "--page", "off")


class Mistake(NamedTuple):
    """A mistake and the words by which its message must name the place, the value and the remedy.

    Attributes:
        part: part of the program, a heading of the table.
        what: the mistake.
        command: arguments of the command line; for the page a key and the value typed into its field.
        words: parts of the message.
        change: of the folder with the press, before the command.
    """

    part: str
    what: str
    command: tuple[str, ...]
    words: tuple[str, ...]
    change: Callable[[Path], object] = lambda folder: None


def _scene(old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: edit(folder / "scene.toml", (old, new))


def _forces(change: Callable[[str], str]) -> Callable[[Path], object]:
    """Return a change of the lines below the heading of forces.csv."""

    def apply(folder: Path) -> None:
        path = folder / "forces.csv"
        heading, _, lines = path.read_text().partition("\n")
        path.write_text(f"{heading}\n{change(lines)}")

    return apply


def _negative(lines: str) -> str:
    rows = [line.split(",") for line in lines.splitlines()]
    return "\n".join(",".join([row[0], str(-float(row[1])), *row[2:]]) for row in rows)


def _second_tangential(path: Path) -> None:
    """Write the tangential force as two columns, Fx and Fy."""
    _, *lines = path.read_text().splitlines()
    heading = "time (s),normal_force (N),Fx (N),Fy (N),trigger (V)"
    rows = (line.split(",") for line in lines)
    path.write_text("\n".join([heading, *(",".join([*row[:3], "0", row[3]]) for row in rows)]) + "\n")


def _table(old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: edit(folder / "study" / "trials.csv", (old, new))


DRY_RUN = ("study", "run", "study", "--dry-run")
SYNTHETIC = (*STREAM, "--source", "synthetic")
AREA = "gross_contact_area > 20"
MISTAKES = (
    Mistake("command line", "a command misspelt", ("proces", "scene.toml"), ("'proces'", "Did you mean 'process'")),
    Mistake("command line", "a recording in place of the scene", ("process", "frames.npy"),
        ("frames.npy", "`fingerflow init`")),
    Mistake("command line", "a scene that is not there", ("process", "scen.toml"), ("scen.toml", "`fingerflow init`")),
    Mistake("command line", "an output misspelt", ("process", "-v", "real_contact_aera", "scene.toml"),
        ("'real_contact_aera'", "did you mean 'real_contact_area'?")),
    Mistake("command line", "`report` before `process`", ("report", "scene.toml"),
        ("result.h5", "`fingerflow process`"), lambda folder: (folder / "result.h5").unlink()),
    Mistake("command line", "a table for Excel", ("export-table", "result.h5", "table.xlsx"), ("table.xlsx", ".csv")),
    Mistake("command line", "a map misspelt", ("export-map", "result.h5", "divergance", "map.tif"),
        ("divergance", "did you mean 'divergence'?")),
    Mistake("command line", "a folder in place of a recording", ("info", "study"), ("study", "name a file in it")),
    Mistake("command line", "`init` over a scene", ("init", "scene.toml"), ("scene.toml", "name another file")),
    Mistake("command line", "a recording in place of the result", ("export-table", "frames.npy", "table.csv"),
        ("frames.npy", "`fingerflow process`")),
    Mistake("scene", "a key misspelt", PROCESS, ("line 6", "frame_rat", "did you mean 'frame_rate'?"),
        _scene("frame_rate =", "frame_rat =")),
    Mistake("scene", "frame rate left out", PROCESS, ("frames.npy", "frame_rate = 300.0"),
        _scene("frame_rate = 8.0", "# frame_rate = 8.0")),
    Mistake("scene", "a number in quotes", PROCESS, ("line 6", "'8.0'", "without quotes"),
        _scene("frame_rate = 8.0", 'frame_rate = "8.0"')),
    Mistake("scene", "a decimal comma", PROCESS, ("at line 33", "write a decimal point"),
        _scene("mm_per_px = 0.0325", "mm_per_px = 0,0325")),
    Mistake("scene", "backslashes in a path", PROCESS, ("line 5", "recording.frames", "write /"),
        _scene('"frames.npy"', '"C:\\new\\frames.npy"')),
    Mistake("scene", "more of them", PROCESS, ("at line 5", "write / in place of \\"),
        _scene('"frames.npy"', '"C:\\Users\\me\\press.npy"')),
    Mistake("scene", "a quotation mark left out", PROCESS, ("at line 5", "a quotation mark is missing"),
        _scene('"frames.npy"', '"frames.npy')),
    Mistake("scene", "scale in µm", PROCESS, ("calibration.mm_per_px", "32.5", "at most 1"),
        _scene("mm_per_px = 0.0325", "mm_per_px = 32.5")),
    Mistake("scene", "an even window", PROCESS, ("tracking.window_px", "24", "such as 25"),
        _scene("window_px = 25", "window_px = 24")),
    Mistake("scene", "rows and columns exchanged", PROCESS, ("views.contact", "[120, 240]", "at most 96 and 240"),
        lambda folder: edit(folder / "scene.toml", ("rows = [0, 96]  ", "rows = [120, 240]  "),
                            ("columns = [120, 240]", "columns = [0, 96]"))),
    Mistake("scene", "views exchanged", PROCESS, ("frames.npy", "check [views.contact]"),
        lambda folder: edit(folder / "scene.toml", ("[views.contact]", "[views.x]"),
                            ("[views.topography]", "[views.contact]"), ("[views.x]", "[views.topography]"))),
    Mistake("scene", "last frame beyond the recording", PROCESS,
        ("recording.last_frame", "299", "frame 7", "leave it out"), _scene("# last_frame = 299", "last_frame = 299")),
    Mistake("scene", "no picture of the empty glass", PROCESS, ("background.frames", "empty.npy", "paths are relative"),
        lambda folder: (folder / "empty.npy").unlink()),
    Mistake("scene", "empty glass of other camera settings", PROCESS, ("empty.npy", "232", "the same camera settings"),
        lambda folder: np.save(folder / "empty.npy", np.load(folder / "empty.npy")[..., :-8])),
    Mistake("scene", "a calibration file beside its numbers", PROCESS, ("calibration.file", "keep one of them"),
        _scene('# file = "calibration.toml"', 'file = "calibration.toml"')),
    Mistake("forces", "`Fx, Fy` for two columns", PROCESS, ("forces.csv", "'Fx, Fy'", 'tangential = ["Fx", "Fy"]'),
        lambda folder: (_second_tangential(folder / "forces.csv"),
                        edit(folder / "scene.toml", ('"tangential_force"', '"Fx, Fy"')))),
    Mistake("forces", "a column that is not there", PROCESS, ("forces.csv", "'Fz'", "its columns are 'time'"),
        _scene('normal = "normal_force"', 'normal = "Fz"')),
    Mistake("forces", "pressing is negative", PROCESS, ("forces.csv", "sign = -1"), _forces(_negative)),
    Mistake("forces", "signs as text", PROCESS, ("forces.sign", "'-1, 1'", "such as [-1, 1]"),
        _scene("# sign = 1 ", 'sign = "-1, 1" # ')),
    Mistake("forces", "volts without a gain", PROCESS, ("forces.csv", "in V", "gain = 2.5"),
        _scene('# units = "N"', 'units = "V"')),
    Mistake("forces", "a trigger that never comes", PROCESS, ("forces.csv", "25", "trigger_level"),
        _scene("trigger_level = 2.5", "trigger_level = 25")),
    Mistake("forces", "recorded for too short", PROCESS, ("4 of 8 frames", "is the trigger right?"),
        _forces(lambda lines: "".join(lines.splitlines(True)[: lines.count("\n") // 2]))),
    Mistake("forces", "tare in contact", PROCESS, ("normal force is -0.14 N", "Check", "tare"),
        _scene("# tare = [-0.5, -0.1]", "tare = [0.3, 0.6]")),
    Mistake("page", "text for a number", ("recording.frame_rate", "fast"),
        ("frame rate is", "'fast'", "number")),
    Mistake("page", "a recording that is not there", ("background.frames", "glass.tif"),
        ("recording of the empty glass is", "glass.tif", "paths are relative")),
    Mistake("page", "two signs in one field", ("forces.sign", "-1, 1"), ("sign of each column is", "such as [-1, 1]")),
    Mistake("calibration", "a picture without a ring", ("calibrate", "--ring", "empty.npy"),
        ("empty.npy", "no hole of a ring", "Check the frame")),
    Mistake("study", "a trial that is there twice", DRY_RUN, ("trials.csv", "row 3", "number the trials"),
        lambda folder: (folder / "study/trials.csv").open("a").write("p01/0um/t1/frames.npy,01,1,0,1\n")),
    Mistake("study", "a column misspelt", DRY_RUN, ("trials.csv", "did you mean 'particpant'"),
        _table("participant", "particpant")),
    Mistake("study", "an answer in words", DRY_RUN, ("trials.csv", "'often'"), _table("0,1", "0,often")),
    Mistake("live", "a folder that is no bundle", ("stream", "study"), ("bundle.json", "`fingerflow export`")),
    Mistake("live", "`--when` without `--then`", (*SYNTHETIC, "--when", f"{AREA} mm2"), ("give one --then",)),
    Mistake("live", "a condition without a unit", (*SYNTHETIC, "--when", AREA, "--then", "udp:127.0.0.1:5005"),
        ("gross_contact_area", "'mm2'", "no unit")),
    Mistake("live", "an address without a port", (*SYNTHETIC, "--send", "udp:127.0.0.1"),
        ("'127.0.0.1'", "udp:HOST:PORT")),
    Mistake("live", "a scene of another camera", (*STREAM, "--scene", "scene.toml", "--source", "frames.npy"),
        ("views.contact", "96 x 110 px", "correct rows and columns"),
        _scene("columns = [120, 240]", "columns = [130, 240]")),
    Mistake("live", "a rate of 0", (*SYNTHETIC, "--rate", "0"), ("--rate", "0 is not a number")),
    Mistake("live", "results into a folder that exists", (*SYNTHETIC, "--output", "study"), ("study", "another name")),
)  # fmt: skip


def cases(few: bool = False) -> Iterator[Case]:
    """Yield the mistakes with what is said of each; the number counts words that the message lacks."""
    for mistake, said in messages():
        lacking = sum(word not in said for word in mistake.words)
        verdict = "wrong in silence" if not said else "incomplete" if lacking else "told"
        yield Case(f"{mistake.part}: {mistake.what}", str(lacking), "0", said, verdict)


def messages() -> Iterator[tuple[Mistake, str]]:
    """Yield each mistake with its message."""
    with tempfile.TemporaryDirectory() as folder:
        press = Path(folder) / "press"
        write_press(press)
        assert message_of(Mistake("scene", "none", PROCESS, ()), press) == ""
        yield from ((mistake, message_of(mistake, press)) for mistake in MISTAKES)


def write_press(folder: Path) -> None:
    """Write a small press with its result, a study of it, and a bundle for frames of its size."""
    write_recording(folder, replace(TINY_PRESS, force=0.3), progress=False)
    edit(folder / "scene.toml", ("points = 700", "points = 60"))
    process(folder / "scene.toml", to=folder / "result.h5").close()
    trial = folder / "study" / "p01" / "0um" / "t1"
    shutil.copytree(folder, trial, ignore=shutil.ignore_patterns("study", "result.h5"))
    (folder / "study" / "answers.csv").write_text("participant,trial,condition,answer\n01,1,0,1\n")
    init_study(folder / "study", folder / "study" / "answers.csv")
    recipe = Recipe(views=ViewRecipe(height=96, width=120), tracking=PointSettings(points=40, window_px=15))
    write_library_bundle(folder / "bundle", recipe)


def message_of(mistake: Mistake, press: Path) -> str:
    """Return the first line that is said of a mistake on a copy of the press: error, problem or warning; "" if none."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "press"
        shutil.copytree(press, folder)
        mistake.change(folder)
        before = Path.cwd()
        os.chdir(folder)
        try:
            found = _said_by_page(mistake, folder) if mistake.part == "page" else _said(mistake.command)
        finally:
            os.chdir(before)
    return found.replace(f"{folder}/", "").replace(str(folder), ".")


def _said_by_page(mistake: Mistake, folder: Path) -> str:
    draft = Draft.read(folder / "scene.toml")
    key, value = mistake.command
    draft.set(tuple(key.split(".")), value)
    return next((f"{one['field']} {one['said']}" for one in draft.problems()), "")


def _said(command: tuple[str, ...]) -> str:
    """Return the error of a command, or its first warning, but that the gauge length is large beside the tiny press."""
    said = io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["fingerflow", *command]),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        contextlib.suppress(SystemExit),
    ):
        cli.main()
    lines = (line for line in said.getvalue().splitlines() if "over a third of the width" not in line)
    found = [line.partition(mark)[2] for line in lines for mark in MARKS if mark in line]
    return next(iter(found), "")
