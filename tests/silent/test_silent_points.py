"""Tests that no tracked point is wrong without a warning, and that no right point is dropped."""

import pytest

from tests.silent.points import cases


@pytest.mark.long
def test_no_point_is_wrong_in_silence() -> None:
    assert [one for one in cases() if one.verdict not in ("warned", "right")] == []
