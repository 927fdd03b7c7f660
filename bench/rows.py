"""Rows of benchmark results with named columns, and their printed table."""

from collections.abc import Mapping, Sequence

Cell = float | int | str | bool | None
Row = Mapping[str, Cell]


class Skipped(Exception):
    """Refusal of a suite that cannot run here, with the reason as its message."""


def number(row: Row, name: str) -> float:
    """Return a cell that holds a number; raise TypeError where it does not."""
    cell = row[name]
    if not isinstance(cell, int | float):
        raise TypeError(f"{name} is {cell!r}, not a number")
    return float(cell)


def as_table(rows: Sequence[Row]) -> str:
    """Return rows as text in aligned columns, in the order of first appearance; a missing cell stays empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, *([as_text(row.get(name)) for name in names] for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(names))]
    left = [all(isinstance(row.get(name), str | None) for row in rows) for name in names]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if words else cell.rjust(width)
            for cell, width, words in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in lines
    )


def as_text(cell: Cell) -> str:
    """Return a cell as it stands in a table: floats with four digits, nothing for None."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
