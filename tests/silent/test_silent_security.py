"""Tests that nobody else can read, write or run anything."""

import pytest

from tests.silent.security import cases


@pytest.mark.long
def test_nobody_else_is_let_in() -> None:
    assert [one for one in cases() if one.verdict != "refused"] == []
