"""Figure of the supplement, made of lettered panels, with a list of panels that lack input."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure, SubFigure

from fingerflow.report.picture_files import save_figure

_COLUMNS = 3
_PANEL_INCHES = (4.6, 3.8)


@dataclass(frozen=True)
class SheetPanel:
    """Panel of a figure: letter, drawing function, width in columns (of three), and relative height."""

    letter: str
    draw: Callable[[SubFigure], Any]
    columns: int = 1
    rows: float = 1.0

    @classmethod
    def of_axes(cls, letter: str, draw: Callable[..., Any], *values: Any, columns: int = 1) -> "SheetPanel":
        """Return a panel with a single axes, into which ``draw(axes, *values)`` draws."""
        return cls(letter, lambda part: draw(part.subplots(), *values), columns)


@dataclass(frozen=True)
class Sheet:
    """Figure of the supplement with its panels; `left_out` says which panels are missing and what they need."""

    name: str
    panels: tuple[SheetPanel, ...]
    left_out: tuple[str, ...] = ()

    @staticmethod
    def sentences(missing: Iterable[tuple[str, str]]) -> tuple[str, ...]:
        """Return, for each missing input, a sentence that names the panels that need it."""
        letters: dict[str, list[str]] = {}
        for letter, need in missing:
            letters.setdefault(need, []).append(letter)
        return tuple(f"{', '.join(of)} need{'s' * (len(of) == 1)} {need}" for need, of in letters.items())

    def figure(self) -> Figure:
        """Draw the panels in rows of three columns, each with its letter."""
        rows: list[list[SheetPanel]] = []
        for panel in self.panels:
            if not rows or sum(other.columns for other in rows[-1]) + panel.columns > _COLUMNS:
                rows.append([])
            rows[-1].append(panel)
        columns = max(sum(panel.columns for panel in row) for row in rows)
        wide, high = _PANEL_INCHES
        heights = [max(panel.rows for panel in row) for row in rows]
        figure = Figure(figsize=(wide * columns, high * sum(heights)), layout="constrained")
        grid = figure.add_gridspec(len(rows), columns, height_ratios=heights)
        for number, row in enumerate(rows):
            at = 0
            for panel in row:
                part = figure.add_subfigure(grid[number, at : at + panel.columns])
                if panel.letter:
                    part.suptitle(panel.letter, x=0.01, ha="left", fontweight="bold")
                panel.draw(part)
                at += panel.columns
        return figure

    def write(self, folder: Path) -> Path:
        """Write the figure as PNG under its name ("S1.png") atomically; raise FingerflowError if that fails."""
        path = folder / f"{self.name}.png"
        save_figure(self.figure(), path)
        return path
