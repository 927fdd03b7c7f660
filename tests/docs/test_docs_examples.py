"""Tests of the examples on pages of the documentation, and of `>>>` in the reference."""

import doctest
import re
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks_of(path: Path) -> list[str]:
    """Return the blocks of Python, padded so that an error states the line of the page."""
    text = path.read_text(encoding="utf-8")
    return ["\n" * text[: found.start(1)].count("\n") + found[1] for found in _BLOCK.finditer(text)]


WITH_BLOCKS = [path for path in sorted(DOCS.rglob("*.md")) if "generated" not in path.parts and blocks_of(path)]
REFERENCE = sorted(DOCS.glob("api/*.rst"))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    yield
    plt.close("all")


def test_there_are_examples() -> None:
    assert {path.stem for path in WITH_BLOCKS} >= {"getting_started", "embedding", "forces"}


@pytest.mark.parametrize("path", WITH_BLOCKS, ids=lambda path: path.stem)
def test_blocks_of_a_page_run_from_top_to_bottom(path: Path) -> None:
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks_of(path):
        exec(compile(block, str(path), "exec"), names)


@pytest.mark.parametrize("path", REFERENCE, ids=lambda path: path.stem)
def test_examples_of_the_reference_give_what_they_say(path: Path) -> None:
    found = doctest.testfile(str(path), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.failed == 0
    assert found.attempted or path.stem in ("graphs", "live", "results")
