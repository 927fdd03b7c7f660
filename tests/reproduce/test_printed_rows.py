"""Tests of the rows of the reproduction: each printed result has a row, and results agree if their
intervals overlap.
"""

import re
from pathlib import Path

import pytest

from fingerflow.reproduce import figures_of_presses, figures_of_slides, method_rows, press_rows, slip_rows
from fingerflow.reproduce.printed_row import (
    AGREES,
    DIFFERS,
    NOT_HAD,
    NOT_PRINTED,
    UNEXPLAINED,
    Obtained,
    Row,
    exactly,
    likely,
    number,
    rounded,
    unobtainable,
    within,
)

PRINTED = Path(__file__).resolve().parents[3] / "shared" / "printed.md"
ROWS = (*slip_rows.ROWS, *method_rows.ROWS, *press_rows.ROWS)
FIGURES = (*figures_of_slides.FIGURES, *figures_of_presses.FIGURES)


def row(printed: str, numbers: tuple[tuple[float, float], ...], found: Obtained) -> Row[None]:
    return Row("X1", "quantity", printed, "3", numbers, lambda _: found)


def test_every_printed_result_has_one_row() -> None:
    if not PRINTED.exists():
        pytest.skip("the list of printed results is not beside this checkout")
    listed = re.findall(r"^\| ([AB]\d+) \|", PRINTED.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(listed) > 80
    assert sorted(one.id for one in ROWS) == sorted(listed)


def test_every_printed_figure_and_movie_is_there() -> None:
    names = ["1", "2a", "2b", "2c", "2d", *(f"S{k}" for k in range(1, 14)), *(f"M{k}" for k in range(1, 5))]
    assert [one.name for one in FIGURES] == names


@pytest.mark.parametrize(
    ("printed", "obtained", "verdict"),
    [
        (rounded(3.6, digit=0.1), ((3.64, 3.9),), AGREES),
        (rounded(3.6, digit=0.1), ((3.66, 3.9),), DIFFERS),
        (within(70.1, 4.5), ((60.0, 66.0),), AGREES),
        (exactly(4, 4, 2), exactly(4, 4, 2), AGREES),
        (exactly(4, 4, 2), exactly(4, 3, 3), DIFFERS),
    ],
)
def test_numbers_agree_where_all_intervals_meet(
    printed: tuple[tuple[float, float], ...], obtained: tuple[tuple[float, float], ...], verdict: str
) -> None:
    answer = row("a", printed, Obtained("b", obtained, because="of this")).answer(None)
    assert (answer.verdict, answer.because) == (verdict, "of this" if verdict == DIFFERS else "")


def test_what_is_not_printed_not_had_or_not_explained_says_so() -> None:
    assert row("", (), Obtained("5 mm")).answer(None).verdict == NOT_PRINTED
    missing = Row("X2", "quantity", "4", "3", exactly(4), unobtainable("it is a photograph")).answer(None)
    assert (missing.verdict, missing.because) == (NOT_HAD, "it is a photograph")
    assert row("4", exactly(4), Obtained("5", exactly(5))).answer(None).because == UNEXPLAINED


def test_an_answer_without_the_numbers_of_the_print_is_refused() -> None:
    with pytest.raises(ValueError, match="2 printed numbers, 1 obtained"):
        row("4, 5", exactly(4, 5), Obtained("4", exactly(4))).answer(None)


def test_numbers_are_rounded_to_their_deviation() -> None:
    assert number(0.15234, 0.0163) == "0.152 ± 0.016"
    assert number(267.03, 27.4) == "267 ± 27"
    assert number(0.123456) == "0.123"
    assert likely(1.0, 0.5) == pytest.approx((0.02, 1.98))
