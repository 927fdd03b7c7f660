"""Fonts, colours, line styles, axes and legends that all figures share."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fingerflow.plot.captions import describe

# Colour-blind readers can tell dark blue, vermilion and bluish green apart (Okabe & Ito 2008).
INK, RED, GREEN, YELLOW, GREY = "#1f3b57", "#d55e00", "#009e73", "#edae49", "#8a96a3"
BAND = 2.0  # half width of a band in standard deviations
BAND_WORDS = f"± {BAND:g} standard deviations"
#: Comes with matplotlib; a single font, since each font of a list would be searched for at each text.
FONT = "DejaVu Sans"
ONE_COLUMN_MM, TWO_COLUMNS_MM = 85.0, 170.0  # mm, widths of a figure on a printed page
MM_PER_INCH = 25.4
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
_DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1.5, 1, 1.5, 1, 1.5)), (0, (1, 3)), (0, (8, 3)))
_COLOURS = (INK, RED, YELLOW, GREEN, GREY)
_LIGHTEST = 0.85  # largest position used in viridis: lighter colours vanish on white paper
_STYLE: dict[Any, Any] = {
    "font.family": [FONT], "font.size": 7.5, "figure.titlesize": 7.5, "axes.titlesize": 7.5, "axes.labelsize": 7.5,
    "xtick.labelsize": 7.0, "ytick.labelsize": 7.0, "legend.fontsize": 7.0, "legend.title_fontsize": 7.0,
    "legend.handlelength": 2.4, "legend.labelspacing": 0.3, "legend.borderaxespad": 0.3, "legend.columnspacing": 1.0,
    "lines.linewidth": 1.0, "lines.markersize": 3.5, "axes.linewidth": 0.6, "grid.linewidth": 0.5,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5, "ytick.major.size": 2.5,
    "axes.titlepad": 3.0, "axes.labelpad": 2.0, "xtick.major.pad": 2.0, "ytick.major.pad": 2.0,
}  # fmt: skip


@contextmanager
def figure_style(width_mm: float = ONE_COLUMN_MM) -> Iterator[None]:
    """Set matplotlib's defaults in a ``with`` block for figures of a printed width, with type of at least 7 pt."""
    wide = width_mm / MM_PER_INCH
    with mpl.rc_context({**_STYLE, "figure.figsize": (wide, 0.75 * wide)}):
        yield


def new_figure(height: float) -> Figure:
    """Return a figure of the width set by `figure_style`; its height is `height` times that width."""
    wide = float(mpl.rcParams["figure.figsize"][0])
    return Figure(figsize=(wide, height * wide), layout="constrained")


def given_or_new(axes: Axes | None, height: float = 0.72) -> Axes:
    """Return the axes given, or else axes in a new figure whose height is `height` times its width."""
    return new_figure(height).subplots() if axes is None else axes


def line_styles(count: int, ordered: bool = False) -> list[dict[str, Any]]:
    """Return keyword arguments of `Axes.plot` for `count` lines that differ in both colour and dashes.

    The lines are read without colour by their dashes. ``ordered`` is for lines of a rising quantity, such as a
    friction: their colours go from dark to light.
    """
    if ordered:
        colours = list(colormaps["viridis"](np.linspace(0, _LIGHTEST, max(count, 1))))
    else:
        colours = [_COLOURS[k % len(_COLOURS)] for k in range(count)]
    return [{"color": colours[k], "linestyle": _DASHES[k % len(_DASHES)]} for k in range(count)]


def named_lines(count: int) -> tuple[int, ...]:
    """Return the indices of those of `count` lines of a rising quantity that a legend names and that have dashes and a
    band: all of up to four, else the first, the middle and the last.
    """
    return tuple(range(count)) if count <= 4 else (0, count // 2, count - 1)


def dot_styles(count: int) -> list[dict[str, Any]]:
    """Return keyword arguments of `Axes.plot` for `count` groups of dots, which differ in colour and marker."""
    marks = [{"marker": MARKERS[k % len(MARKERS)], "linestyle": "none"} for k in range(count)]
    return [style | mark for style, mark in zip(line_styles(count, ordered=True), marks, strict=True)]


def finished(axes: Axes, caption: str = "") -> Axes:
    """Add a light grid, a legend (if any line has a label) and a caption to axes, and return the axes."""
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)
    if caption:
        describe(axes, caption)
    return axes
