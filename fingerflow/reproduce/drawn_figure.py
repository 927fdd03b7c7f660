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
        write_movie: writes the movie, of which the figure shows some frames.
    """

    name: str
    printed: str
    draw: Callable[[Source], tuple[Figure | None, str]]
    write_movie: Callable[[Source, Path], None] | None = None

    def write(self, source: Source, folder: Path) -> "DrawnFigure":
        """Write the figure as PNG, and its movie as MP4; raise FingerflowError if one cannot be written."""
        figure, shown = self.draw(source)
        if figure is None:
            return DrawnFigure(self.name, self.printed, "", shown)
        path = folder / f"{self.name}.png"
        save_figure(figure, path)
        movie = path.with_suffix(".mp4") if self.write_movie else None
        if self.write_movie and movie:
            self.write_movie(source, movie)
        return DrawnFigure(self.name, self.printed, path.name, shown, "" if movie is None else movie.name)


@dataclass(frozen=True)
class DrawnFigure:
    """A figure of the page: what is printed, its file ("" without one), what it shows or why it is missing, a movie."""

    name: str
    printed: str
    file: str
    shown: str
    movie: str = ""
