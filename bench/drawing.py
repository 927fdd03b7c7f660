"""Parts that the figures of the suites share: colours, saving, and values of several programs as dots in rows."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from bench.rows import Cell, Row

RED, BLUE, GREEN, VIOLET, GREY = "#b5402a", "#2b5c8a", "#3c7d3f", "#6f4a8e", "#777777"


class Mark(NamedTuple):
    """Colour, marker and fill of a program; the project is red, OpenCV blue, DIC codes green."""

    colour: str
    marker: str = "o"
    filled: bool = True

    @property
    def style(self) -> dict[str, Any]:
        """Return the arguments of `Axes.plot`."""
        filling = self.colour if self.filled else "white"
        return {"color": self.colour, "marker": self.marker, "markerfacecolor": filling, "markersize": 6}


@contextmanager
def saved_axes(path: Path, height: float, columns: int = 1, width: float = 8.4, **options: Any) -> Iterator[list[Any]]:
    """Yield the axes of a new figure of this size in inches, and write it to a file at the end."""
    figure, axes = plt.subplots(1, columns, figsize=(width, height), dpi=160, layout="constrained", **options)
    found = [axes] if columns == 1 else list(axes)
    for one in found:
        one.spines[["top", "right"]].set_visible(False)
    yield found
    figure.savefig(path)
    plt.close(figure)


def draw_dots(
    axes: Any, names: Sequence[str], values: Mapping[str, Sequence[float | None]], marks: Mapping[str, Mark]
) -> None:
    """Draw a row per name, from the top down, with the value of each program as a dot; leave out unknown values."""
    rows = range(len(names))
    axes.hlines(rows, 0, 1, transform=axes.get_yaxis_transform(), color="0.92", linewidth=0.8, zorder=0)
    for program, mark in marks.items():
        known = [(value, row) for row, value in zip(rows, values[program], strict=True) if value is not None]
        axes.plot(*zip(*known, strict=True), linestyle="", label=program, clip_on=False, **mark.style)
    axes.set_yticks(rows, names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)


def scale_by_powers(axis: Any) -> None:
    """Make the axis of a plot logarithmic, with ticks at 1, 2 and 5 times powers of ten written as plain numbers."""
    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axis.set_minor_locator(NullLocator())


def cells(rows: Sequence[Row], column: str, by: str, names: Sequence[Cell], **wanted: object) -> list[float | None]:
    """Return a column of the rows that have the wanted cells, in the order of the names in the column `by`; None for a
    name without such a row.
    """
    found = {row[by]: row.get(column) for row in rows if all(row.get(key) == cell for key, cell in wanted.items())}
    return [value if isinstance(value := found.get(name), int | float) else None for name in names]
