"""Figures of the reproduction: what the papers show, and the file that shows the same."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from matplotlib.figure import Figure

from fingerflow.report.picture_files import save_figure

Source = TypeVar("Source")


@dataclass(frozen=True)
class PrintedFigure(Generic[Source]):
    """A printed figure: its name, what it shows, and how it is drawn.

    Attributes:
        name: as "2b" or "S11".
        printed: what it shows in print.
        draw: returns the figure and what it shows here; None in place of a figure where nothing can be drawn.
    """

    name: str
    printed: str
    draw: Callable[[Source], tuple[Figure | None, str]]

    def write(self, source: Source, folder: Path) -> "DrawnFigure":
        """Draw the figure and write it as PNG; raise FingerflowError if it cannot be written."""
        figure, shown = self.draw(source)
        if figure is None:
            return DrawnFigure(self.name, self.printed, "", shown)
        path = folder / f"{self.name}.png"
        save_figure(figure, path)
        return DrawnFigure(self.name, self.printed, path.name, shown)


@dataclass(frozen=True)
class DrawnFigure:
    """A figure of the page: what is printed, the file ("" without one), and what it shows or why it is missing."""

    name: str
    printed: str
    file: str
    shown: str
