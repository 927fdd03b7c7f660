"""Tests of the whole reproduction in its quick form, from raw recordings to the page."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.reproduce.drawn_figure import DrawnFigure
from fingerflow.reproduce.paper_page import TITLES, read_results, write_page, write_results
from fingerflow.reproduce.printed_row import AGREES, DIFFERS, NOT_HAD, UNEXPLAINED, Answer

DOCS = Path(__file__).resolve().parents[2] / "docs" / "reproduced"


def write_some(folder: Path, paper: str = "slip") -> None:
    rows = [
        Answer("A1", "trials", "10", "2.2", "9 < 10", "10", DIFFERS, "one <failed>"),
        Answer("A2", "outcome", "4", "3", "4", "4", AGREES, ""),
    ]
    figures = [
        DrawnFigure("1", "a picture", "1.png", "the same"),
        DrawnFigure("S2", "a photograph", "", "not simulated"),
    ]
    write_results(folder, paper, "Ten slides.", rows, figures)


def test_the_page_has_every_row_and_figure_as_text(tmp_path: Path) -> None:
    write_some(tmp_path)
    page = write_page(tmp_path).read_text(encoding="utf-8")
    assert "one &lt;failed&gt;" in page
    assert "9 &lt; 10" in page
    assert '<img alt="1: a picture" src="slip/1.png">' in page
    assert "not simulated" in page
    assert "1 differs, 1 agrees" in page


def test_the_page_holds_all_papers_that_were_reproduced(tmp_path: Path) -> None:
    for paper in reversed(TITLES):
        write_some(tmp_path, paper)
    assert [one["paper"] for one in read_results(tmp_path)] == list(TITLES)


def test_an_unknown_paper_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["reproduce", str(tmp_path), "--paper", "C"])
    assert isinstance(result.exception, FingerflowError)
    assert "choose one of slip, press" in str(result.exception)


def test_the_committed_results_are_whole_and_explained() -> None:
    papers = read_results(DOCS)
    assert [one["paper"] for one in papers] == list(TITLES)
    for paper in papers:
        for row in paper["rows"]:
            assert row["because"] != UNEXPLAINED, row["id"]
            assert bool(row["because"]) == (row["verdict"] in (DIFFERS, NOT_HAD)), row["id"]
        files = {figure["file"] for figure in paper["figures"] if figure["file"]}
        assert files == {path.name for path in (DOCS / paper["paper"]).iterdir()}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduced")
    result = CliRunner().invoke(app, ["reproduce", str(folder), "--quick"], catch_exceptions=False)
    assert result.exit_code == 0
    return folder / "page"


def rows_of(page: Path, paper: str) -> dict[str, dict[str, Any]]:
    return {row["id"]: row for row in json.loads((page / f"{paper}.json").read_text(encoding="utf-8"))["rows"]}


@pytest.mark.long
def test_the_slides_agree_with_print(page: Path) -> None:
    rows = rows_of(page, "slip")
    agreeing = {name for name, row in rows.items() if row["verdict"] == AGREES}
    assert agreeing >= {"A1", "A2", "A3", "A4", "A5", *(f"A{k}" for k in range(12, 18)), "A20", "A21", "A22"}
    error = re.search(r"RMS error ([\d.]+)", rows["A9"]["obtained"])
    assert error is not None
    assert float(error[1]) < 0.03


@pytest.mark.long
def test_the_quick_study_of_presses_agrees_where_few_presses_can(page: Path) -> None:
    rows = rows_of(page, "press")
    agreeing = {name for name, row in rows.items() if row["verdict"] == AGREES}
    settings = {"B1", "B3", "B15", "B16", "B17", "B18", "B21", "B22", "B23", "B24", "B25", "B26", "B30", "B33", "B56"}
    models = {"B58", "B59", "B60", "B61", "B62", "B63"}
    measured = {"B5", "B6", "B8", "B34", "B35", "B36", "B43", "B44"}
    assert agreeing >= settings | models | measured
    assert not [name for name, row in rows.items() if row["because"] == UNEXPLAINED]
    assert {row["verdict"] for row in rows.values() if "nan" in row["obtained"]} == set()


@pytest.mark.long
def test_every_figure_but_the_photographs_is_drawn(page: Path) -> None:
    for paper in TITLES:
        figures = json.loads((page / f"{paper}.json").read_text(encoding="utf-8"))["figures"]
        assert [one["name"] for one in figures if not one["file"]] == (["S2"] if paper == "press" else [])
        for one in figures:
            if one["file"]:
                assert (page / paper / one["file"]).stat().st_size > 5000
            if one["movie"]:
                assert (page / "movies" / one["movie"]).stat().st_size > 5000


@pytest.mark.long
def test_a_second_run_measures_nothing_again(page: Path) -> None:
    folder = page.parent
    rows = sorted(folder.rglob("row.json"))
    assert len(rows) > 60
    before = [path.stat().st_mtime_ns for path in rows]
    first = rows_of(page, "slip")
    result = CliRunner().invoke(app, ["reproduce", str(folder), "--paper", "slip"], catch_exceptions=False)
    assert result.exit_code == 0
    assert [path.stat().st_mtime_ns for path in rows] == before
    assert rows_of(page, "slip") == first
