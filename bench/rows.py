"""What a suite gives: rows of named cells, and how they are printed."""

from collections.abc import Mapping, Sequence

Cell = float | int | str | bool | None
Row = Mapping[str, Cell]


class Skipped(Exception):
    """A suite cannot run here; the message says why."""


def number(row: Row, name: str) -> float:
    """A cell that holds a number; raises TypeError where it does not."""
    cell = row[name]
    if not isinstance(cell, int | float):
        raise TypeError(f"{name} is {cell!r}, not a number")
    return float(cell)


def as_table(rows: Sequence[Row]) -> str:
    """Aligned columns in the order in which the rows name them; a cell that a row lacks stays empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, *([_text(row.get(name)) for name in names] for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(names))]
    left = [all(isinstance(row.get(name), str | None) for row in rows) for name in names]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if words else cell.rjust(width)
            for cell, width, words in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in lines
    )


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
