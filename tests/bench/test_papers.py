"""Tests of both papers: rows and verdicts on tables with the printed effects, the page, a quick run from pictures."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from bench.__main__ import main
from bench.papers import method_rows, press_figures, press_rows, slide_figures, slide_rows
from bench.papers.page import TITLES, read_results, write_page, write_results
from bench.papers.presses import PressStudy
from bench.papers.printed import (
    UNEXPLAINED,
    Answer,
    Basis,
    Interval,
    Obtained,
    Row,
    exactly,
    rounded,
    unobtainable,
    within,
)
from bench.papers.slides import EXPECTED, JudgedSlide, Slides, design_slides, kind_of
from fingerflow.models.partial_slip import judge_trial
from fingerflow.report.slip_trials import SlipTrial
from fingerflow.study.statistics import read_sample
from fingerflow.synthetic import LinearSlip
from tests.bench.table_of_presses import study

ROOT = Path(__file__).resolve().parents[2]
PRINTED = ROOT.parent / "shared" / "printed.md"
ROWS = (*slide_rows.ROWS, *method_rows.ROWS, *press_rows.ROWS)
EXPLAINED = ("differs", "wrong", "undecided", "not to be had")
EQUATIONS = {f"A{k}" for k in (6, *range(12, 18), 20, 21)}
OF_RECORDINGS = {"A8", "A11"}  # they need pictures or time series of trials


def measured(truth: LinearSlip) -> JudgedSlide:
    """Return a slide with its true d² and T/N, with noise, in place of measured values."""
    draw = np.random.default_rng(truth.camera.seed)
    area = np.array([truth.stuck_share(frame) for frame in range(truth.n_frames)])
    load = truth.tangential_force(truth.times) / truth.force
    area, load = (one + 0.005 * draw.standard_normal(one.size) for one in (area, load))
    values = {"stuck_ratio": area, "load_ratio": load, "normal_force": np.full(area.size, truth.force)}
    result = xr.Dataset({name: ("frame", one) for name, one in values.items()}, {"time": ("frame", truth.times)})
    trial = SlipTrial("slide", result, judge_trial(area, load, truth.times), None)
    return JudgedSlide(kind_of(truth), truth, trial, None)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def slides() -> Slides:
    return Slides(tuple(map(measured, design_slides().values())))


@pytest.fixture(scope="module")
def printed() -> PressStudy:
    return study()


def answers(rows: tuple[Row[Any], ...], source: Any) -> dict[str, Answer]:
    return {row.id: row.answer(source) for row in rows if row.id not in OF_RECORDINGS}


def test_every_printed_result_and_figure_has_its_place() -> None:
    figures = [one.name for one in (*slide_figures.FIGURES, *press_figures.FIGURES) if "own" not in one.name]
    assert figures == ["1", "2a", "2b", "2c", "2d", *(f"S{k}" for k in range(1, 14)), *(f"M{k}" for k in range(1, 5))]
    assert len({row.id for row in ROWS}) == len(ROWS) > 80
    if PRINTED.exists():
        listed = re.findall(r"^\| ([AB]\d+) \|", PRINTED.read_text(encoding="utf-8"), re.MULTILINE)
        assert sorted(one.id for one in ROWS) == sorted(listed)


@pytest.mark.parametrize(
    ("basis", "numbers", "found", "verdict"),
    [
        ("put in", rounded(3.6, digit=0.1), Obtained("b", ((3.64, 3.9),)), "read back"),
        ("put in", rounded(3.6, digit=0.1), Obtained("b", ((3.66, 3.9),)), "differs"),
        ("put in", within(70.1, 4.5), Obtained("b", ((60.0, 66.0),)), "read back"),
        ("setting or equation", exactly(4, 4, 2), Obtained("b", exactly(4, 3, 3)), "differs"),
        ("setting or equation", exactly(4), Obtained("b", exactly(4)), "holds"),
        ("setting or equation", exactly(4), unobtainable("it is a photograph")(None), "not to be had"),
        ("predicted", rounded(3.6, digit=0.1), Obtained("b", ((1.9, 7.1),)), "right"),
        ("predicted", rounded(3.6, digit=0.1), Obtained("b", ((-50.0, 50.0),)), "undecided"),
        ("predicted", rounded(3.6, digit=0.1), Obtained("b", ((7.3, 9.0),)), "wrong"),
        ("predicted", rounded(-0.28, digit=0.01), Obtained("b", ((-0.4, -0.2),)), "right"),
        ("predicted", rounded(-0.28, digit=0.01), Obtained("b", ((0.2, 0.4),)), "wrong"),
        ("predicted", exactly(1, 2), Obtained("b", ((0.9, 1.1), (5.0, 6.0))), "wrong"),
        ("predicted", exactly(1, 2), Obtained("b", ((0.9, 1.1), (1.5, 6.0))), "undecided"),
        ("predicted", (), Obtained("b", agrees=True), "right"),
        ("predicted", (), Obtained("b"), "undecided"),
    ],
)
def test_only_predictions_are_right_or_wrong(
    basis: Basis, numbers: tuple[Interval, ...], found: Obtained, verdict: str
) -> None:
    """Print meets a vague result too: an interval must lie within a factor of 2 of print, or outside."""
    answer = Row("X1", "quantity", "a", "3", numbers, lambda _: found, basis).answer(None)
    assert answer.verdict == verdict
    assert ("× print" in answer.obtained) == (basis == "predicted" and numbers != ())
    reasons = dict.fromkeys(EXPLAINED, UNEXPLAINED) | {"not to be had": "it is a photograph"}
    assert answer.because == reasons.get(verdict, "")


def test_numbers_must_correspond() -> None:
    row = Row("X1", "quantity", "a", "3", exactly(1, 2), lambda _: Obtained("b", exactly(1)))
    with pytest.raises(ValueError, match="X1: 2 printed numbers, 1 obtained"):
        row.answer(None)


def test_slides_as_in_print_agree_and_equations_hold(slides: Slides) -> None:
    """Four slides collapse at the printed sizes and durations. Every equation holds by quadrature or root finding, and
    the two misprints do not.
    """
    assert [len(slides.of(kind)) for kind in EXPECTED] == [4, 4, 2]
    found = answers(slide_rows.ROWS, slides)
    given = {"A1", "A2", "A3", "A4", "A5", "A22"}
    expected = dict.fromkeys(EQUATIONS, "holds") | dict.fromkeys(given, "read back")
    assert {name: found[name].verdict for name in expected} == expected
    assert found["A2"].obtained.endswith("by the printed rule 4 with, 4 without, 2 inconclusive")
    assert {found[name].verdict for name in ("A18", "A19")} == {"differs"}
    assert found["A18"].obtained.startswith("0.500 by")
    assert "0.400 as printed" in found["A18"].obtained
    first, *others = slides.slides
    verdict = dataclasses.replace(first.trial.verdict, outcome="diminishes")
    wrong = dataclasses.replace(first, trial=dataclasses.replace(first.trial, verdict=verdict))
    misjudged = answers(slide_rows.ROWS, Slides((wrong, *others)))["A2"]
    assert (misjudged.verdict, misjudged.because) == ("differs", "misjudged: slide")


def test_a_study_with_the_printed_effects_agrees(printed: PressStudy) -> None:
    found = answers(press_rows.ROWS, printed)
    given = (*range(5, 9), *range(34, 37), 38, 40, *range(42, 45))
    right = (9, 37, 46, 47, 48, 49, 51, 52)
    expected = dict.fromkeys(given, "read back") | dict.fromkeys(right, "right") | {54: "wrong", 63: "holds"}
    assert {number: found[f"B{number}"].verdict for number in expected} == expected
    assert all((one.obtained or one.because) and "nan" not in one.obtained for one in found.values())
    assert not [one.id for one in found.values() if one.because == UNEXPLAINED]


@pytest.mark.parametrize(
    ("name", "column", "change", "verdict"),
    [
        ("B5", "gross_contact_area", lambda frame: 0.8 * frame["gross_contact_area"], "differs"),
        ("B9", "real_contact_area_at_3n", lambda frame: 3**0.3 * frame["real_contact_area_at_1n"], "wrong"),
        ("B34", "max_force", lambda frame: 0.7 * frame["max_force"], "differs"),
        ("B37", "max_force", lambda frame: frame["max_force"] + 3 * frame["answer"].eq(other=True), "wrong"),
        ("B49", "strain", lambda frame: frame["strain"] + 0.03, "wrong"),
        ("B51", "strain_energy", lambda frame: frame["strain_energy"] - 0.1 * frame["condition"], "wrong"),
        ("B51", "strain_energy", lambda frame: frame["strain_energy"] + frame["condition"], "wrong"),
        ("B54", "strain_rate", lambda frame: frame["strain_rate"] + 0.01 * frame["answer"].eq(other=True), "undecided"),
    ],
)
def test_a_study_with_another_effect_differs(
    printed: PressStudy, name: str, column: str, change: Callable[[Any], Any], verdict: str
) -> None:
    """Sizes and directions of effects turn the verdict, also where print has a p alone."""
    frame = printed.frame.assign(**{column: change(printed.frame)})
    other = dataclasses.replace(printed, frame=frame, sample=read_sample(frame))
    assert next(row for row in press_rows.ROWS if row.id == name).answer(other).verdict == verdict


def test_the_page_has_every_row_and_figure_of_both_papers(tmp_path: Path) -> None:
    rows = [
        Answer("A1", "trials", "10", "2.2", "9 < 10", "10", "wrong", "one <failed>", "predicted"),
        Answer("A2", "outcome", "4", "3", "4", "4", "read back", "", "put in"),
    ]
    figure, *_ = press_figures.FIGURES
    drawn = [dataclasses.replace(figure, name="S2", draw=lambda _: (None, "not simulated")).write(None, tmp_path)]  # type: ignore[type-var]
    for paper in reversed(TITLES):
        write_results(tmp_path, paper, "Ten slides.", rows, drawn)
    page = write_page(tmp_path).read_text(encoding="utf-8")
    for text in ("one &lt;failed&gt;", "9 &lt; 10", "not simulated", "Predicted: 1 wrong. Put in: 1"):
        assert text in page
    assert [one["paper"] for one in read_results(tmp_path)] == list(TITLES)


def test_the_committed_results_are_whole_and_explained() -> None:
    folder = ROOT / "docs" / "reproduced"
    papers = read_results(folder)
    assert [one["paper"] for one in papers] == list(TITLES)
    for paper in papers:
        for row in paper["rows"]:
            assert row["because"] != UNEXPLAINED, row["id"]
            assert bool(row["because"]) == (row["verdict"] in EXPLAINED), row["id"]
            assert row["basis"] == next(one.basis for one in ROWS if one.id == row["id"])
        files = {figure["file"] for figure in paper["figures"] if figure["file"]}
        assert files == {path.name for path in (folder / paper["paper"]).iterdir()}


@pytest.mark.long
def test_a_quick_run_from_pictures_to_the_page(tmp_path: Path) -> None:
    """Slides agree with print, and of the small study of presses what few presses can; every figure but photographs is
    drawn; a second run measures nothing again.
    """
    main(["papers", "--quick", "--folder", str(tmp_path)])
    found = {one["paper"]: one for one in read_results(tmp_path / "page")}
    rows = {paper: {row["id"]: row for row in one["rows"]} for paper, one in found.items()}
    good = ("holds", "read back", "right")
    agreeing = {name for own in rows.values() for name, row in own.items() if row["verdict"] in good}
    assert agreeing >= {f"A{k}" for k in (*range(1, 6), *range(12, 18), 20, 21, 22)}
    settings = {1, 3, *range(15, 19), *range(21, 27), 30, 33, 56, 58, 59, 62, 63}
    assert agreeing >= {f"B{k}" for k in settings | {5, 6, 8, 34, 35, 36, 43, 44}}
    assert not [name for own in rows.values() for name, row in own.items() if row["because"] == UNEXPLAINED]
    assert not [name for own in rows.values() for name, row in own.items() if "nan" in row["obtained"]]
    error = re.search(r"RMS error ([\d.]+)", rows["slip"]["A9"]["obtained"])
    assert error is not None
    assert float(error[1]) < 0.03
    for paper, one in found.items():
        files = [tmp_path / "page" / paper / figure["file"] for figure in one["figures"] if figure["file"]]
        files += [tmp_path / "page" / "movies" / figure["movie"] for figure in one["figures"] if figure["movie"]]
        assert len(files) == (25 if paper == "press" else 5)
        assert all(path.stat().st_size > 5000 for path in files)
    measured = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("row.json")}
    assert len(measured) == 58
    main(["papers", "slip", "--folder", str(tmp_path)])
    assert {path: path.stat().st_mtime_ns for path in measured} == measured
    again = json.loads((tmp_path / "page" / "slip.json").read_text(encoding="utf-8"))
    assert again["rows"] == found["slip"]["rows"]
