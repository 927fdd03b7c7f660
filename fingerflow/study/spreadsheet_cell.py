"""Quote text cells of CSV files that a spreadsheet program would run as a formula."""

from typing import Any

_BEGIN_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def quoted_cell(value: Any) -> Any:
    """Return a cell with an apostrophe before text that a spreadsheet would run as a formula; else the cell itself.

    Names of files and participants come from others: "=HYPERLINK(...)" would be a formula of theirs. Numbers stay.
    """
    return f"'{value}" if isinstance(value, str) and _begins_formula(value) else value


def plain_cell(value: Any) -> Any:
    """Return a cell without the apostrophe that `quoted_cell` adds."""
    return value[1:] if isinstance(value, str) and value[:1] == "'" and _begins_formula(value[1:]) else value


def _begins_formula(text: str) -> bool:
    if not text.startswith(_BEGIN_FORMULA):
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False
