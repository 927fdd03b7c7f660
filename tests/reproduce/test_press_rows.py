"""Tests of the rows of Willemet et al. 2021 on a table of trials with the printed effects."""

import dataclasses

import numpy as np
import pytest

from fingerflow.reproduce.press_rows import ROWS
from fingerflow.reproduce.presses import PressStudy
from fingerflow.reproduce.printed_row import AGREES, DIFFERS, Answer
from tests.reproduce.table_of_presses import study

OF_RESULTS = {"B47", "B48", "B52"}  # they need time series of trials, or the skin chain


@pytest.fixture(scope="module")
def printed() -> PressStudy:
    return study()


def answer(id: str, of: PressStudy) -> Answer:
    return next(row for row in ROWS if row.id == id).answer(of)


@pytest.mark.parametrize(
    "id",
    ["B5", "B6", "B7", "B8", "B9", "B34", "B35", "B36", "B38", "B40", "B42", "B43", "B44", "B49", "B51", "B63", "B65"],
)
def test_a_study_with_the_printed_effects_agrees(printed: PressStudy, id: str) -> None:
    found = answer(id, printed)
    assert found.verdict == AGREES, found


def test_every_row_says_what_it_obtains_or_why_not(printed: PressStudy) -> None:
    found = [row.answer(printed) for row in ROWS if row.id not in OF_RESULTS]
    assert all(one.obtained or one.because for one in found)
    assert all("nan" not in one.obtained for one in found)
    assert not [one.id for one in found if one.verdict == DIFFERS and one.because == "not explained"]


@pytest.mark.parametrize(
    ("id", "column", "factor"),
    [("B5", "gross_contact_area", 0.8), ("B34", "max_force", 0.7), ("B38", "force_rate", 0.6), ("B49", "strain", 2.0)],
)
def test_a_study_without_an_effect_differs(printed: PressStudy, id: str, column: str, factor: float) -> None:
    frame = printed.frame.copy()
    frame[column] = factor * frame[column]
    assert answer(id, dataclasses.replace(printed, frame=frame)).verdict == DIFFERS


def test_the_fall_of_the_real_area_is_that_of_the_table(printed: PressStudy) -> None:
    frame = printed.frame.copy()
    frame["real_contact_area_at_3n"] = np.where(frame["condition"] == 3.0, 12.0, 18.0)
    frame.loc[frame.index % 16 == 0, "real_contact_area_at_3n"] *= 1.01  # some spread over participants
    found = answer("B8", dataclasses.replace(printed, frame=frame))
    assert found.obtained.startswith("33 %")
    assert found.verdict == DIFFERS
