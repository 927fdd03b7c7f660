"""Tests of both papers: rows and verdicts on tables with the printed effects, and the page."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from bench.papers import method_rows, press_figures, press_rows, slide_figures, slide_rows
from bench.papers.page import TITLES, read_results, write_page, write_results
from bench.papers.presses import PressStudy
from bench.papers.printed import (
    AGREES,
    DIFFERS,
    NOT_HAD,
    UNEXPLAINED,
    Answer,
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
from fingerflow.synthetic import LinearSlip
from tests.bench.table_of_presses import study

ROOT = Path(__file__).resolve().parents[2]
PRINTED = ROOT.parent / "shared" / "printed.md"
ROWS = (*slide_rows.ROWS, *method_rows.ROWS, *press_rows.ROWS)
EQUATIONS = {f"A{k}" for k in (6, *range(12, 18), 20, 21)}
OF_RECORDINGS = {"A8", "A11", "B47", "B48", "B52"}  # they need pictures, time series of trials, or the skin chain


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
    figures = [one.name for one in (*slide_figures.FIGURES, *press_figures.FIGURES)]
    assert figures == ["1", "2a", "2b", "2c", "2d", *(f"S{k}" for k in range(1, 14)), *(f"M{k}" for k in range(1, 5))]
    assert len({row.id for row in ROWS}) == len(ROWS) > 80
    if PRINTED.exists():
        listed = re.findall(r"^\| ([AB]\d+) \|", PRINTED.read_text(encoding="utf-8"), re.MULTILINE)
        assert sorted(one.id for one in ROWS) == sorted(listed)


@pytest.mark.parametrize(
    ("numbers", "found", "verdict"),
    [
        (rounded(3.6, digit=0.1), Obtained("b", ((3.64, 3.9),)), AGREES),
        (rounded(3.6, digit=0.1), Obtained("b", ((3.66, 3.9),)), DIFFERS),
        (within(70.1, 4.5), Obtained("b", ((60.0, 66.0),)), AGREES),
        (exactly(4, 4, 2), Obtained("b", exactly(4, 3, 3)), DIFFERS),
        (exactly(4), unobtainable("it is a photograph")(None), NOT_HAD),
    ],
)
def test_numbers_agree_where_all_intervals_meet(numbers: tuple[Interval, ...], found: Obtained, verdict: str) -> None:
    answer = Row("X1", "quantity", "a", "3", numbers, lambda _: found).answer(None)
    assert answer.verdict == verdict
    assert answer.because == {DIFFERS: UNEXPLAINED, NOT_HAD: "it is a photograph"}.get(verdict, "")


def test_slides_as_in_print_agree_and_equations_hold(slides: Slides) -> None:
    """Four slides collapse at the printed sizes and durations. Every equation holds by quadrature or root finding, and
    the two misprints do not.
    """
    assert [len(slides.of(kind)) for kind in EXPECTED] == [4, 4, 2]
    found = answers(slide_rows.ROWS, slides)
    agreeing = EQUATIONS | {"A1", "A2", "A3", "A4", "A5", "A22"}
    assert {name: found[name].verdict for name in agreeing} == dict.fromkeys(agreeing, AGREES)
    assert found["A2"].obtained.endswith("by the printed rule 4 with, 4 without, 2 inconclusive")
    assert {found[name].verdict for name in ("A18", "A19")} == {DIFFERS}
    assert found["A18"].obtained.startswith("0.500 by")
    assert "0.400 as printed" in found["A18"].obtained
    first, *others = slides.slides
    verdict = dataclasses.replace(first.trial.verdict, outcome="diminishes")
    wrong = dataclasses.replace(first, trial=dataclasses.replace(first.trial, verdict=verdict))
    misjudged = answers(slide_rows.ROWS, Slides((wrong, *others)))["A2"]
    assert (misjudged.verdict, misjudged.because) == (DIFFERS, "misjudged: slide")


def test_a_study_with_the_printed_effects_agrees(printed: PressStudy) -> None:
    found = answers(press_rows.ROWS, printed)
    numbers = (*range(5, 10), *range(34, 37), 38, 40, *range(42, 45), 49, 51, 63, 65)
    assert {number: found[f"B{number}"].verdict for number in numbers} == dict.fromkeys(numbers, AGREES)
    assert all((one.obtained or one.because) and "nan" not in one.obtained for one in found.values())
    assert not [one.id for one in found.values() if one.because == UNEXPLAINED]


def test_a_study_without_an_effect_differs(printed: PressStudy) -> None:
    for name, column, factor in (
        ("B5", "gross_contact_area", 0.8),
        ("B34", "max_force", 0.7),
        ("B38", "force_rate", 0.6),
        ("B49", "strain", 2.0),
    ):
        other = dataclasses.replace(printed, frame=printed.frame.assign(**{column: factor * printed.frame[column]}))
        assert next(row for row in press_rows.ROWS if row.id == name).answer(other).verdict == DIFFERS


def test_the_page_has_every_row_and_figure_of_both_papers(tmp_path: Path) -> None:
    rows = [
        Answer("A1", "trials", "10", "2.2", "9 < 10", "10", DIFFERS, "one <failed>"),
        Answer("A2", "outcome", "4", "3", "4", "4", AGREES, ""),
    ]
    figure, *_ = press_figures.FIGURES
    drawn = [dataclasses.replace(figure, name="S2", draw=lambda _: (None, "not simulated")).write(None, tmp_path)]  # type: ignore[type-var]
    for paper in reversed(TITLES):
        write_results(tmp_path, paper, "Ten slides.", rows, drawn)
    page = write_page(tmp_path).read_text(encoding="utf-8")
    assert all(text in page for text in ("one &lt;failed&gt;", "9 &lt; 10", "not simulated", "1 differs, 1 agrees"))
    assert [one["paper"] for one in read_results(tmp_path)] == list(TITLES)


def test_the_committed_results_are_whole_and_explained() -> None:
    folder = ROOT / "docs" / "reproduced"
    papers = read_results(folder)
    assert [one["paper"] for one in papers] == list(TITLES)
    for paper in papers:
        for row in paper["rows"]:
            assert row["because"] != UNEXPLAINED, row["id"]
            assert bool(row["because"]) == (row["verdict"] in (DIFFERS, NOT_HAD)), row["id"]
        files = {figure["file"] for figure in paper["figures"] if figure["file"]}
        assert files == {path.name for path in (folder / paper["paper"]).iterdir()}
