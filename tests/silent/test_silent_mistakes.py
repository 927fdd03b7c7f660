"""Each of the forty mistakes of a new user gets a message that names place, value and remedy, as the page says."""

from pathlib import Path

import pytest

from tests.silent.mistakes import MISTAKES, cases

TROUBLESHOOTING = Path(__file__).resolve().parents[2] / "docs" / "troubleshooting.md"


@pytest.mark.long
def test_every_mistake_is_told() -> None:
    assert [one for one in cases() if one.verdict != "told"] == []


def test_the_page_shows_every_mistake() -> None:
    rows = {line.split(" | ")[0]: line for line in TROUBLESHOOTING.read_text(encoding="utf-8").splitlines()}
    assert len(MISTAKES) >= 40
    for mistake in MISTAKES:
        row = rows[f"| {mistake.what}"]
        assert not [word for word in mistake.words if word not in row], row
