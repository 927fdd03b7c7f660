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
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from fingerflow import cli, process
from fingerflow.export.recipe import Recipe, TrackingRecipe, ViewRecipe
from fingerflow.schema.scene_template import scene_text
from fingerflow.study.init import init_study
from fingerflow.synthetic import write_recording
from fingerflow.view.draft import Draft
from tests.silent.case import Case
from tests.small_trials import TINY_PRESS, edit, write_library_bundle

PROCESS = ("process", "scene.toml")
STREAM = ("stream", "bundle", "--page", "off")


class Mistake(NamedTuple):
    """A mistake and the words by which its message must name the place, the value and the remedy.

    Attributes:
        part: of the program, a heading of the table.
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


def _table(old: str, new: str) -> Callable[[Path], None]:
    return lambda folder: edit(folder / "study" / "trials.csv", (old, new))


def _array(name: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    return lambda folder: np.save(folder / name, change(np.load(folder / name)))


MISTAKES = (
    Mistake("command line", "a command misspelt", ("proces", "scene.toml"), ()),
    Mistake("command line", "a recording in place of the scene", ("process", "frames.npy"), ()),
    Mistake("command line", "a scene that is not there", ("process", "scen.toml"), ()),
    Mistake("command line", "an output misspelt", ("process", "-v", "real_contact_aera", "scene.toml"), ()),
    Mistake("command line", "a report before `process`", ("report", "scene.toml"), (), lambda folder: (folder / "result.h5").unlink()),
    Mistake("command line", "a table for Excel", ("export-table", "result.h5", "table.xlsx"), ()),
    Mistake("command line", "a map misspelt", ("export-map", "result.h5", "divergance", "map.tif"), ()),
    Mistake("command line", "a folder without pictures", ("info", "empty"), (), lambda folder: (folder / "empty").mkdir()),
    Mistake("command line", "`init` over a scene", ("init", "scene.toml"), ()),
    Mistake("command line", "a recording in place of the result", ("export-table", "frames.npy", "table.csv"), ()),
    Mistake("scene", "a key misspelt", PROCESS, (), _scene("frame_rate =", "frame_rat =")),
    Mistake("scene", "frame rate left out", PROCESS, (), _scene("frame_rate = 8.0", "# frame_rate = 8.0")),
    Mistake("scene", "a number in quotes", PROCESS, (), _scene("frame_rate = 8.0", 'frame_rate = "8.0"')),
    Mistake("scene", "a decimal comma", PROCESS, (), _scene("mm_per_px = 0.0325", "mm_per_px = 0,0325")),
    Mistake("scene", "backslashes of a Windows path", PROCESS, (), _scene('"frames.npy"', '"C:\\new\\frames.npy"')),
    Mistake("scene", "a quotation mark left out", PROCESS, (), _scene('"frames.npy"', '"frames.npy')),
    Mistake("scene", "scale in µm", PROCESS, (), _scene("mm_per_px = 0.0325", "mm_per_px = 32.5")),
    Mistake("scene", "an even window", PROCESS, (), _scene("window_px = 25", "window_px = 24")),
    Mistake("scene", "rows and columns exchanged", PROCESS, (), _scene("rows = [0, 96]                # rows of the frame that it covers, [first, last + 1)\ncolumns = [120, 240]", "rows = [120, 240]\ncolumns = [0, 96]")),
    Mistake("scene", "views exchanged", PROCESS, (), lambda folder: edit(folder / "scene.toml", ("[views.contact]", "[views.x]"), ("[views.topography]", "[views.contact]"), ("[views.x]", "[views.topography]"))),
    Mistake("scene", "last frame beyond the recording", PROCESS, (), _scene("# last_frame = 299", "last_frame = 299")),
    Mistake("scene", "no picture of the empty glass", PROCESS, (), lambda folder: (folder / "empty.npy").unlink()),
    Mistake("scene", "empty glass of another camera setting", PROCESS, (), _array("empty.npy", lambda one: one[..., :-8])),
    Mistake("scene", "calibration file that was not made yet", PROCESS, (), _scene("# file = \"calibration.toml\"", "file = \"calibration.toml\"")),
    Mistake("forces", "`Fx, Fy` for two columns", PROCESS, (), _scene('tangential = "tangential_force"', 'tangential = "Fx, Fy"')),
    Mistake("forces", "a column that is not there", PROCESS, (), _scene('normal = "normal_force"', 'normal = "Fz"')),
    Mistake("forces", "pressing is negative", PROCESS, (), _forces(_negative)),
    Mistake("forces", "signs as text", PROCESS, (), _scene("# sign = 1 ", 'sign = "-1, 1" # ')),
    Mistake("forces", "volts without a gain", PROCESS, (), _scene('# units = "N"', 'units = "V"')),
    Mistake("forces", "a trigger that never comes", PROCESS, (), _scene("trigger_level = 2.5", "trigger_level = 25")),
    Mistake("forces", "decimal commas and semicolons", PROCESS, (), lambda folder: (folder / "forces.csv").write_text((folder / "forces.csv").read_text().replace(",", ";").replace(".", ","))),
    Mistake("forces", "recorded for too short", PROCESS, (), _forces(lambda lines: "\n".join(lines.splitlines()[: len(lines.splitlines()) // 2]))),
    Mistake("forces", "tare in contact", PROCESS, (), _scene("# tare = [-0.5, -0.1]", "tare = [0.3, 0.6]")),
    Mistake("page", "two columns in one field", ("forces.tangential", "Fx, Fy"), ()),
    Mistake("page", "text for a number", ("recording.frame_rate", "fast"), ()),
    Mistake("page", "an area of the empty glass that is not there", ("background.frames", "glass.tif"), ()),
    Mistake("page", "gauge length in µm", ("fields.gauge_length_mm", "1600"), ()),
    Mistake("calibration", "a picture without a ring", ("calibrate", "--ring", "empty.npy", "--background", "empty.npy"), ()),
    Mistake("calibration", "a target without discs", ("calibrate", "--target", "empty.npy", "--ring", "empty.npy"), ()),
    Mistake("study", "a recording that is not there", ("study", "run", "study"), (), _table("frames.npy", "frame.npy")),
    Mistake("study", "a column misspelt", ("study", "run", "study"), (), _table("participant", "particpant")),
    Mistake("study", "an answer in words", ("study", "run", "study"), (), _table("answer\n", "answer\n")),
    Mistake("live", "a folder that is no bundle", ("stream", "."), ()),
    Mistake("live", "`--when` without `--then`", (*STREAM, "--source", "synthetic", "--when", "gross_contact_area > 20 mm2"), ()),
    Mistake("live", "a condition without a unit", (*STREAM, "--source", "synthetic", "--when", "gross_contact_area > 20", "--then", "udp:127.0.0.1:5005"), ()),
    Mistake("live", "an address without a port", (*STREAM, "--source", "synthetic", "--send", "udp:127.0.0.1"), ()),
    Mistake("live", "frames of another size", (*STREAM, "--scene", "scene.toml", "--source", "frames.npy"), (), _scene("columns = [120, 240]", "columns = [130, 240]")),
    Mistake("live", "a rate of 0", (*STREAM, "--source", "synthetic", "--rate", "0"), ()),
    Mistake("live", "results into a folder of results", (*STREAM, "--source", "synthetic", "--output", "study"), ()),
)


def cases() -> Iterator[Case]:
    """Yield the mistakes with what is said of each."""
    with tempfile.TemporaryDirectory() as folder:
        press = Path(folder) / "press"
        write_press(press)
        for mistake in MISTAKES:
            said = message_of(mistake, press)
            named = [word for word in mistake.words if word not in said]
            verdict = "wrong in silence" if not said else f"does not name {named}" if named else "told"
            yield Case(f"{mistake.part}: {mistake.what}", "", "", said, verdict)


def write_press(folder: Path) -> None:
    """Write a small press with its result, a study of it, and a bundle for frames of its size."""
    write_recording(folder, TINY_PRESS, progress=False)
    process(folder / "scene.toml", to=folder / "result.h5").close()
    trial = folder / "study" / "p01" / "0um" / "t1"
    shutil.copytree(folder, trial, ignore=shutil.ignore_patterns("study", "result.h5"))
    (folder / "study" / "answers.csv").write_text("participant,trial,condition,answer\n01,1,0,1\n")
    init_study(folder / "study", folder / "study" / "answers.csv")
    recipe = Recipe(views=ViewRecipe(height=96, width=120), tracking=TrackingRecipe(points=40, window_px=15))
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
    draft = Draft.of_file(folder / "scene.toml")
    key, value = mistake.command
    draft.set(tuple(key.split(".")), value)
    return next((f"{one['key']}: {one['said']}" for one in draft.problems()), "")


def _said(command: tuple[str, ...]) -> str:
    out, err = io.StringIO(), io.StringIO()
    with mock.patch.object(sys, "argv", ["fingerflow", *command]), contextlib.redirect_stdout(out):
        with contextlib.redirect_stderr(err), contextlib.suppress(SystemExit):
            cli.main()
    return f"OUT {out.getvalue()} ERR {err.getvalue()}"
