"""Tests that no press or roll raises the slip flag of a stream, and that partial slip does."""

import pytest

from fingerflow.kernels.library import is_present
from tests.silent.slip_flag import cases


@pytest.mark.long
@pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")
def test_the_slip_flag_gives_no_false_alarm() -> None:
    assert [one for one in cases() if one.verdict != "right"] == []
