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


def test_runs_of_a_fault_are_counted_together(made: ModuleType) -> None:
    """Faults of one to three frames are one row, and faults of equal cells share it; a fault that a stream does not
    look for has no cells there.
    """
    rows = [
        {"case": f"{kind}: {count} {fault}", "number": f"{found} of {6 * count} excluded, others {off} deviations off"}
        for kind, count, fault, found, off in (
            ("recorded", 1, "black", 6, 0.6),
            ("live", 1, "black", 6, 0.3),
            ("recorded", 1, "torn", 6, 0.2),
            ("recorded", 2, "torn", 12, 0.6),
            ("live", 1, "torn", 6, 0.3),
            ("recorded", 1, "from 5 frames later", 5, 0.7),
            ("recorded", 3, "from 5 frames later", 12, 1.1),
        )
    ]
    assert made.bad_frames(rows)[1:] == [
        ["black; torn", "all", "0.6", "all", "0.3"],
        ["from 5 frames later", "17 of 24", "1.1", "", ""],
    ]


def test_errors_over_deviations_stand_beside_each_other(made: ModuleType) -> None:
    cases = {"presses: position": "z 1.16, 68%, 91%", "slides: position": "z 1.67, 59%, 84%"}
    cases |= {"slides, live: median_divergence": "z 1.72, 41%, 68%"}
    assert made.deviations([{"case": case, "number": number} for case, number in cases.items()])[1:] == [
        ["position", "1.16; 68, 91 %", "1.67; 59, 84 %"],
        ["median divergence, live", "", "1.72; 41, 68 %"],
    ]


def test_an_energy_that_is_not_known_is_no_number(made: ModuleType) -> None:
    cases = {
        "press: dust": "0.03% wrong, energy 0.5 deviations off, NaN in 0%",
        "slide: dust": "0.24% wrong, energy 1.4 deviations off, NaN in 59%",
        "press: H.264": "20.66% wrong, energy nan deviations off, NaN in 0%",
        "onset at the rim: a": "7 missed, 0 by more than 0.2 mm",
    }
    assert made.wrong_points([{"case": case, "number": number} for case, number in cases.items()])[1:] == [
        ["dust", "0.03 %", "0.5", "0.24 %", "1.4, NaN in 59 % of the frames"],
        ["H.264", "20.66 %", "not stated", "", ""],
    ]
