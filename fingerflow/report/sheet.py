"""Figure of the supplement, made of lettered panels, with a list of panels that lack input."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure, SubFigure

from fingerflow.plot.axes_style import TWO_COLUMNS_MM, figure_style, new_figure
from fingerflow.plot.captions import caption_of, describe
from fingerflow.plot.panels import join_captions, letter_panel

_COLUMNS = 3
_WIDE_MM, _HIGH_MM = 55.0, 48.0  # mm, least width and height of a panel in which its text fits
_FLATTEST = 0.5  # least height of a panel as a share of its width


@dataclass(frozen=True)
class SheetPanel:
    """Panel of a figure: letter, function that draws it into a subfigure, width in columns of the figure, and height
    relative to the other panels.
    """

    letter: str
    draw: Callable[[SubFigure], Any]
    columns: int = 1
    rows: float = 1.0

    @classmethod
    def single(cls, letter: str, draw: Callable[..., Any], *values: Any, columns: int = 1) -> "SheetPanel":
        """Return a panel with one axes, which is drawn by calling ``draw(axes, *values)``."""
        return cls(letter, lambda part: draw(part.subplots(), *values), columns)


@dataclass(frozen=True)
class Sheet:
    """Figure of the supplement: name, title, panels, and pairs (letter, need) of printed panels left out.

    Panels of the figure have letters without gaps; its caption says which panel in print each is.
    """

    name: str
    panels: tuple[SheetPanel, ...]
    left_out: tuple[tuple[str, str], ...] = ()
    title: str = ""

    def missing(self) -> list[str]:
        """Return one sentence per missing input, such as "A, B need values of curl in the table of trials"."""
        letters: dict[str, list[str]] = {}
        for letter, need in self.left_out:
            letters.setdefault(need, []).append(letter)
        return [f"{', '.join(of)} need{'s' * (len(of) == 1)} {need}" for need, of in letters.items()]

    def figure(self, width_mm: float = TWO_COLUMNS_MM) -> Figure:
        """Draw the panels in rows of at most three, each with its letter, and attach the caption."""
        rows, columns = self._rows(width_mm)
        heights = [max(panel.rows for panel in row) for row in rows]
        with figure_style(width_mm):
            high_mm = max(_HIGH_MM, _FLATTEST * width_mm / columns)
            figure = new_figure(high_mm * sum(heights) / width_mm)
            grid = figure.add_gridspec(len(rows), columns, height_ratios=heights)
            parts: list[SubFigure] = []
            for number, row in enumerate(rows):
                at = 0
                for panel in row:
                    wide = min(panel.columns, columns)
                    part = figure.add_subfigure(grid[number, at : at + wide])
                    if len(self.panels) > 1:
                        letter_panel(part, len(parts))
                    panel.draw(part)
                    parts.append(part)
                    at += wide
        heading = f"Figure {self.name}{': ' * bool(self.title)}{self.title}."
        names = [f"as {self.name} {panel.letter.replace(' (', ', ').rstrip(')')}" for panel in self.panels]
        captions = join_captions(parts, names) if len(parts) > 1 else [caption_of(parts[0])]
        describe(figure, "\n".join((heading, *captions)))
        return figure

    def _rows(self, width_mm: float) -> tuple[list[list[SheetPanel]], int]:
        """Arrange the panels in rows, and return the rows and the number of columns, each at least 55 mm wide."""
        columns = max(1, min(_COLUMNS, int(width_mm // _WIDE_MM), sum(panel.columns for panel in self.panels)))
        rows: list[list[SheetPanel]] = []
        for panel in self.panels:
            taken = sum(min(panel_before.columns, columns) for panel_before in rows[-1]) if rows else columns
            if taken + min(panel.columns, columns) > columns:
                rows.append([])
            rows[-1].append(panel)
        return rows, columns
