"""Tests of `fingerflow figures`: the data of each figure, reasons for omitted figures, and complete files only."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from fingerflow.plot.captions import caption_of
from fingerflow.report.press_field import draw_median_curl, press_field
from fingerflow.report.simulated_presses import HIGH, LOW, SimulatedPresses, simulate_presses
from fingerflow.report.supplement import FIGURES, Sources, sources
from fingerflow.report.supplement.sheet import Sheet
from fingerflow.report.trials_file import load_trials
from fingerflow.synthetic import Press

Command = Callable[..., int]
Printed = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch
pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def small_presses(monkeypatch: Patch) -> None:
    """Simulate presses with fewer elements, times and frictions than the figures use, as only the composition is
    tested.
    """

    def few() -> SimulatedPresses:
        return simulate_presses((LOW, HIGH), times=21, elements=101)

    monkeypatch.setattr(sources, "simulate_presses", few)


def table(path: Path, columns: tuple[str, ...]) -> Path:
    """Write a table of 8 participants, 4 of them with softer skin, and 4 amplitudes; return its path."""
    draw = np.random.default_rng(0)
    lines = [",".join(("participant", "trial", "condition", "answer", *columns))]
    for who in range(8):
        for amplitude in (0.0, 1.0, 2.0, 3.0):
            for trial in range(6):
                right = int(draw.random() < 0.5 + 0.16 * amplitude)
                level = 0.01 + 0.02 * (who >= 4) + 0.002 * amplitude + 0.001 * right
                values = level * (1 + 0.2 * draw.random(len(columns)))
                lines.append(",".join(map(str, (who, trial, amplitude, right, *values))))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_without_tables_the_simulated_figures_come_and_the_others_say_why(
    command: Command, tmp_path: Path, capsys: Printed
) -> None:
    assert command("figures", tmp_path / "new", "--json") == 0
    found = {one["figure"]: one for one in json.loads(capsys.readouterr().out)}
    assert list(found) == [*FIGURES, "M3"]
    assert {name for name, one in found.items() if one["file"] is None} == {"S1", "S7", "S11", "S12"}
    assert found["S1"]["left_out"] == [
        "A, B need a tribometer trace (--tribometer)",
        "C, E need pictures and series of recordings, which no table of trials holds",
        "D, F need a table of trials (--trials)",
    ]
    assert found["S7"]["left_out"] == ["A, B, C, D, E need a table of trials (--trials)"]
    assert found["S4"]["left_out"] == found["S6"]["left_out"] == found["S10"]["left_out"] == []
    assert found["S13"]["left_out"] == ["C needs a table of trials (--trials)"]
    drawn = [f"S{number}" for number in (4, 5, 6, 8, 9, 10, 13)]
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == sorted([*(f"{name}.{suffix}" for name in drawn for suffix in ("png", "txt")), "M3.mp4"])
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (tmp_path / "new").glob("*.png"))


def test_a_table_brings_the_panels_of_its_columns(tmp_path: Path) -> None:
    columns = ("divergence", "curl", "strain", "global_displacement", "force_rate")
    found = Sources(trials=load_trials(table(tmp_path / "t.csv", columns)))
    letters = {name: [panel.letter for panel in FIGURES[name](found).panels] for name in ("S5", "S7", "S8", "S12")}
    assert letters["S5"] == ["H", "I", "J (skin chain)", "K (skin chain)"]
    assert letters["S7"] == ["A", "C"]
    assert letters["S8"][-2:] == ["G", "H"]
    assert letters["S12"] == ["A", "B, stiffer skin", "B, softer skin", "C"]
    assert FIGURES["S7"](found).left_out == (
        "B, D need values of force_angle in the table of trials",
        "E needs values of real_contact_area in the table of trials",
    )
    observer = FIGURES["S11"](found)
    assert [panel.letter for panel in observer.panels] == ["A", "B", "C, d'", "C, AUC"]
    assert observer.left_out == (
        "the metrics need values of force_angle, strain_rate, strain_energy, real_contact_area in the table of trials",
    )
    table_axes = observer.figure().axes[2]
    assert [label.get_text() for label in table_axes.get_yticklabels()] == [
        *("divergence", "global displacement", "force rate")
    ]


def test_differences_are_taken_where_the_caption_has_them(tmp_path: Path) -> None:
    columns = ("divergence", "divergence_difference", "force_angle", "force_angle_difference", "strain")
    found = Sources(trials=load_trials(table(tmp_path / "t.csv", columns)))
    labels = {name: [axes.get_xlabel() for axes in FIGURES[name](found).figure().axes] for name in ("S7", "S12")}
    assert labels["S7"] == ["vibration amplitude (µm)", "median peak force angle difference (°)"]
    assert labels["S12"][:3] == ["median divergence difference (µm/mm)"] * 3
    assert found.difference_column("strain") == "strain"


def test_answers_of_one_kind_and_empty_columns_are_drawn_or_said(tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", ("divergence", "curl"))
    heading, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    path.write_text("\n".join([heading, *(",".join([*row[:3], "1", row[4], ""]) for row in cells)]))
    found = Sources(trials=load_trials(path))
    one = FIGURES["S11"](found)
    assert "both are needed" in one.figure().axes[0].get_title()
    FIGURES["S12"](found).figure()
    assert FIGURES["S13"](found).left_out == ("C needs values of curl in the table of trials",)


def test_panels_have_letters_without_gaps_and_the_caption_names_those_in_print(tmp_path: Path) -> None:
    found = Sources(trials=load_trials(table(tmp_path / "t.csv", ("max_force", "duration", "force_rate"))))
    for width in (180, 85):
        figure = FIGURES["S5"](found).figure(width)
        assert [part._suptitle.get_text() for part in figure.subfigs] == list("ABCDEFGH")
        heading, *panels = caption_of(figure).splitlines()
        assert heading == "Figure S5: force and motion of the trials."
        printed = ["B", "D", "E", "G", "H", "I", "J, skin chain", "K, skin chain"]
        assert [line.partition(").")[0] for line in panels] == [
            f"{letter} (as S5 {name}" for letter, name in zip("ABCDEFGH", printed, strict=True)
        ]
        assert all("n = " in line for line in panels)
        assert "± one standard deviation over trials" in panels[0]
    assert Sheet.missing_sentences([("A", "x"), ("C", "y"), ("B", "x")]) == ("A, B need x", "C needs y")


def test_the_field_of_the_simulated_press_is_its_truth() -> None:
    scene = Press(bumps=(), gradient=((0.0, 0.0), (0.0, 0.0)), shift=(0.1, -0.05))
    found = press_field(scene)
    at_rest = np.hypot(*(found.reference - scene.contact_centre).T) < 1.5  # in contact before the skin moved much
    np.testing.assert_allclose(found.displacement[at_rest], np.tile((0.1, -0.05), (at_rest.sum(), 1)), atol=0.005)
    assert found.force[-1] == pytest.approx(5.0)
    assert np.isnan(found.median_curl[0])
    assert len(found.curl) == len(found.reference) > 100
    (line,) = draw_median_curl(Figure().subplots(), found).lines
    np.testing.assert_array_equal(line.get_data(), (found.force, 1e3 * found.median_curl))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--tribometer", "none.csv"), "none.csv: there is no such file"),
        (("--trials", "none.csv"), "none.csv cannot be read"),
        (("--format", "jpg"), "--format jpg: 'jpg' is none; give one or more of pdf, svg, png"),
        (("--width", "85"), "--width 85: give a number and its unit: mm, cm or in, such as 85mm"),
        (("--column", "normal=Fz"), "give the file by --tribometer"),
        (("--tribometer", "none.csv", "--column", "normal"), "--column normal: give two names with = between them"),
    ],
)
def test_mistakes_are_named(
    command: Command, arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: Patch, capsys: Printed
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command("figures", "out", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
