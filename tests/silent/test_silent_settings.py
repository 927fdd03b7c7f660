"""Tests that no mistake of a setting gives wrong results without a warning, and that right settings give no warning."""

import pytest

from tests.silent.settings import cases


@pytest.mark.long
def test_no_setting_is_wrong_in_silence() -> None:
    wrong = [one for one in cases() if one.verdict not in ("warned", "refused", "right")]
    assert wrong == []
