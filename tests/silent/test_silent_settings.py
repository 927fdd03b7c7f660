"""No mistake of a setting is wrong in silence, and nothing right is warned of."""

import pytest

from tests.silent.settings import cases


@pytest.mark.long
def test_no_setting_is_wrong_in_silence() -> None:
    wrong = [one for one in cases() if one.verdict not in ("warned", "refused", "right")]
    assert wrong == []
