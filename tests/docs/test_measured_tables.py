"""Tests of the tables that the site makes of committed rows: what they count together, and that pages show them."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def made() -> ModuleType:
    """Return the module of the build tools that makes the tables."""
    spec = importlib.util.spec_from_file_location("measured_tables", DOCS / "build_tools" / "measured_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_table_has_rows_and_stands_on_a_page(made: ModuleType) -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
    for name, rows in made.tables():
        assert len(rows) > 2, name
        assert len({len(row) for row in rows}) == 1, name
        assert all(row[0] for row in rows[1:]), name
        assert f"```{{include}} generated/tables/{name}.md" in pages
