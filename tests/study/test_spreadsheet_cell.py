"""Tests that cells which a spreadsheet would run as a formula are quoted, and read back unchanged."""

from typing import Any

import pytest

from fingerflow.study.spreadsheet_cell import plain_cell, quoted_cell


@pytest.mark.parametrize("text", ["=1+1", "+cmd", "-a", "@SUM(A1)", "\t=1", "\r=1", "--1", '=HYPERLINK("x")'])
def test_formulas_are_quoted_and_read_back(text: str) -> None:
    assert quoted_cell(text) == "'" + text
    assert plain_cell(quoted_cell(text)) == text


@pytest.mark.parametrize("value", ["", "-0.5", "+3", "-1e-3", "p01/press", "'quoted", "a=b", -0.5, None, True])
def test_all_others_stay(value: Any) -> None:
    assert quoted_cell(value) is value
    assert plain_cell(value) is value
