"""Figures and movies of the papers, and the reproduced ones as files."""

import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from fingerflow.plot.axes_style import MM_PER_INCH, TWO_COLUMNS_MM, figure_style
from fingerflow.plot.figure_files import FigureFiles, settle
from fingerflow.report.video_writer import encode_video
from fingerflow.results.atomic_write import write_atomically

Source = TypeVar("Source")
Picture = NDArray[np.uint8]
Drawn = tuple[Figure | Iterable[Picture] | None, str]

_DPI, _COLOURS = 150, 256
_STILLS = 3  # number of frames of a movie shown on the page
_WIDE = TWO_COLUMNS_MM / MM_PER_INCH  # inches, width of such a row of frames


@dataclass(frozen=True)
class DrawnFigure:
    """Figure or movie on the reproduction page: name, what the printed one shows, file names, and what the reproduced
    one shows.

    `file` is empty if nothing was drawn: `shown` then says why. `movie` is empty for a figure.
    """

    name: str
    printed: str
    file: str
    shown: str
    movie: str = ""


@dataclass(frozen=True)
class PrintedFigure(Generic[Source]):
    """Figure or movie of a paper: its number ("2b", "S11", "M1"), what it shows, and the function that draws the
    reproduced one.

    `draw` returns the figure, or the frames of a movie, and what it shows here, a line a panel; None in place of a
    figure where nothing is drawn. Each frame is `repeated` so often in the file.
    """

    name: str
    printed: str
    draw: Callable[[Source], Drawn]
    repeated: int = 1

    def write(self, source: Source, folder: Path) -> DrawnFigure:
        """Draw the reproduced figure and write it as PNG and PDF; of a movie, a PNG of some frames, and the movie as
        MP4 into the folder `movies` next to `folder`.

        Raises FingerflowError if one cannot be written.
        """
        with figure_style():
            drawn, shown = self.draw(source)
            if drawn is None:
                return DrawnFigure(self.name, self.printed, "", shown)
            path, movie = folder / f"{self.name}.png", ""
            if not isinstance(drawn, Figure):
                pictures, movie = list(drawn), f"{self.name}.mp4"
                repeated = (one for one in pictures for _ in range(self.repeated))
                write_atomically(folder.parent / "movies" / movie, lambda part: encode_video(repeated, part))
                drawn = _strip(pictures)
            else:
                FigureFiles(("pdf",)).save(drawn, folder, self.name)
            _save(drawn, path)
        return DrawnFigure(self.name, self.printed, path.name, shown, movie)


def new_frame(layout: Any = None) -> Figure:
    """Return an empty frame of a movie, of which three above each other fit a page."""
    return Figure(figsize=(_WIDE, 0.47 * _WIDE), dpi=_DPI, layout=layout)


def picture_of(frame: Figure) -> Picture:
    """Return a frame of a movie as RGB image (H, W, 3)."""
    canvas = FigureCanvasAgg(frame)
    # matplotlib does not state the types of these two methods.
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _strip(pictures: list[Picture]) -> Figure:
    """Return a figure with three evenly spaced frames of a movie, first to last: in a row if they are tall, else in a
    column.
    """
    chosen = [pictures[at] for at in np.linspace(0, len(pictures) - 1, _STILLS).round().astype(int)]
    height, width = chosen[0].shape[:2]
    in_row = height > 0.8 * width
    shape = (1, _STILLS) if in_row else (_STILLS, 1)
    ratio = height / width / _STILLS if in_row else height / width * _STILLS
    figure = Figure(figsize=(_WIDE, _WIDE * ratio), layout="constrained")
    for axes, one in zip(np.ravel(figure.subplots(*shape)), chosen, strict=True):
        axes.imshow(one, interpolation="antialiased")
        axes.set_axis_off()
    return figure


def _save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG with 256 colours, which has a third of the file size of full colour."""
    settle(figure)
    full = io.BytesIO()
    figure.savefig(full, format="png", dpi=_DPI)
    colours = Image.open(full).convert("RGB")
    picture = colours.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    write_atomically(path, lambda part: picture.save(part, format="png", optimize=True))
