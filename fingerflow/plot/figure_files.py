"""Writing of figures to files: format, printed width, font size, and a caption file next to them."""

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.text import Text

from fingerflow.errors import FingerflowError
from fingerflow.plot.axes_style import FONT, MM_PER_INCH
from fingerflow.plot.captions import caption_of
from fingerflow.results.atomic_write import MARK, is_marked, keep_others, write_atomically, write_text

FORMATS = ("pdf", "svg", "png")
_DPI = 300  # dots per inch of PNG files, and of images within the other formats
_LENGTH = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(mm|cm|in)")
_MM = {"mm": 1.0, "cm": 10.0, "in": MM_PER_INCH}
_LEAST_MM, _MOST_MM = 60.0, 400.0
_CLAUSE_END = re.compile(r"(?<=,) (?![^(]*\))")  # end of a clause, where lines of text are broken first
_MOST_RUNS = 5  # largest number of runs of the layout engine
_LINES = 100  # largest number of characters in a line of a caption file
# Keep the text of PDF and SVG files as text: editable, searchable, and drawn with fonts instead of outlines.
_TYPE: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}
_METADATA = {
    "png": {"Comment": MARK},
    "pdf": {"Keywords": MARK, "CreationDate": None},
    "svg": {"Creator": MARK, "Date": None},
}


@dataclass(frozen=True)
class FigureFiles:
    """File formats of figures, and their printed width (mm), or None for the default width of each figure."""

    formats: tuple[str, ...] = ("png",)
    width_mm: float | None = None

    @classmethod
    def parse(cls, formats: str, width: str | None = None) -> "FigureFiles":
        """Return the settings for formats such as "pdf,svg" and a width such as "85mm", "8.5cm" or "3.3in".

        Raises:
            FingerflowError: an unknown format, or a width without unit or outside of 60 to 400 mm.
        """
        names = tuple(dict.fromkeys(name.strip().lower() for name in formats.split(",")))
        if strange := [name for name in names if name not in FORMATS]:
            remedy = f"give one or more of {', '.join(FORMATS)}, with commas between them"
            raise FingerflowError(f"--format {formats}: {strange[0]!r} is none; {remedy}")
        if width is None:
            return cls(names)
        match = _LENGTH.fullmatch(width.strip().lower())
        if match is None:
            raise FingerflowError(f"--width {width}: give a number and its unit: mm, cm or in, such as 85mm")
        wide = float(match[1]) * _MM[match[2]]
        if not _LEAST_MM <= wide <= _MOST_MM:
            raise FingerflowError(
                f"--width {width}: give {_LEAST_MM:g} to {_MOST_MM:g} mm, as type of 7 pt leaves no room for curves on "
                "less; one column of a journal has about 85mm, two have 170mm"
            )
        return cls(names, wide)

    def paths(self, folder: Path, name: str) -> list[Path]:
        """Return the paths of a figure's files: one per format, and the caption file."""
        return [folder / f"{name}.{suffix}" for suffix in (*self.formats, "txt")]

    def keep_others(self, folder: Path, name: str, overwrite: bool) -> None:
        """Raise FingerflowError if a file of a figure would replace one that fingerflow has not written, unless
        ``overwrite`` is set.
        """
        for path in self.paths(folder, name):
            keep_others(path, is_marked, overwrite)

    def save(self, figure: Figure, folder: Path, name: str) -> Path:
        """Write a figure in each format and its caption as text; return the path of the first image file.

        Raises FingerflowError if a file cannot be written.
        """
        settle(figure)
        *pictures, caption = self.paths(folder, name)
        for path, suffix in zip(pictures, self.formats, strict=True):
            _write(figure, path, suffix, name)
        lines = [textwrap.fill(line, _LINES) for line in (*caption_of(figure).splitlines(), f"({MARK})")]
        write_text(caption, "\n".join(lines) + "\n")
        return pictures[0]


PNG = FigureFiles()  #: writer of each figure as PNG, in its own width


def settle(figure: Figure) -> None:
    """Wrap long titles and labels of a figure, then fix its layout, so that it stays the same when drawn again."""
    layout = figure.get_layout_engine()
    if layout is None:
        return
    with mpl.rc_context({"font.family": [FONT]}):
        # Axes become smaller beside labels of several lines, and the labels may then need more lines.
        for _ in range(_MOST_RUNS):
            layout.execute(figure)
            if not _break_long_texts(figure):
                break
    figure.set_layout_engine("none")


def _write(figure: Figure, path: Path, suffix: str, name: str) -> None:
    with mpl.rc_context({**_TYPE, "svg.hashsalt": name}):
        write_atomically(path, lambda part: figure.savefig(part, format=suffix, dpi=_DPI, metadata=_METADATA[suffix]))


def _break_long_texts(figure: Figure) -> bool:
    """Wrap texts that are longer than the side of the axes along which they run; return True if any was wrapped."""
    broken = False
    for axes in figure.axes:
        box = axes.get_window_extent()
        broken |= _wrap_text(axes.title, box.width)
        broken |= _wrap_text(axes.xaxis.label, box.width)
        broken |= _wrap_text(axes.yaxis.label, box.height, upright=True)
    return broken


def _wrap_text(text: Text, room: float, upright: bool = False) -> bool:
    """Wrap a text that is longer than `room` (px), at the ends of clauses if possible; return True if it was."""
    words = text.get_text()
    if not words:
        return False
    extent = text.get_window_extent()
    length = extent.height if upright else extent.width
    longest = max(map(len, words.split("\n")))
    if length <= room or longest < 2:
        return False
    width = max(int(longest * room / length), 8)
    lines = [""]
    for clause in _CLAUSE_END.split(words.replace("\n", " ")):
        if lines[-1] and len(lines[-1]) + 1 + len(clause) <= width:
            lines[-1] += f" {clause}"
        else:
            lines += textwrap.wrap(clause, width, break_long_words=False, break_on_hyphens=False)
    text.set_text("\n".join(lines[1:]))
    return True
