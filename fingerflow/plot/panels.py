"""Panels of a figure: their letters and arrangement at a printed width."""

from collections.abc import Sequence
from string import ascii_uppercase
from typing import Any

from matplotlib.figure import Figure, SubFigure

from fingerflow.plot.axes_style import new_figure
from fingerflow.plot.captions import caption_of

# mm, least width of a panel; if panels would be narrower, they are drawn in a column instead of a row.
_BESIDE_MM = 50.0


def row_of_panels(count: int, width_mm: float) -> tuple[Figure, Sequence[SubFigure]]:
    """Return a figure with lettered panels in a row, or in a column where panels in a row would be under 50 mm wide.

    Args:
        count: of panels.
        width_mm: of the figure, as set by `figure_style`.
    """
    row = width_mm >= count * _BESIDE_MM
    figure = new_figure(1.05 / count if row else 0.75 * count)
    parts: Any = figure.subfigures(1, count) if row else figure.subfigures(count, 1)
    for number, part in enumerate(parts):
        letter_panel(part, number)
    return figure, list(parts)


def letter_panel(part: SubFigure, number: int) -> None:
    """Write the letter of a panel, counted from 0, into its upper left corner."""
    part.suptitle(ascii_uppercase[number], x=0.01, ha="left", fontweight="bold")


def join_captions(parts: Sequence[SubFigure], named: Sequence[str] = ()) -> list[str]:
    """Return one caption line per panel: letter, name (if names are given) and caption."""
    names = [f" ({name})" if name else "" for name in named] or [""] * len(parts)
    return [f"{ascii_uppercase[k]}{names[k]}. {caption_of(part)}" for k, part in enumerate(parts)]
