"""Colours, axes and legends that all figures share."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, RED, GREEN, YELLOW, GREY = "#1f3b57", "#d1495b", "#3c8d5a", "#edae49", "#9aa5b1"
BAND = 2.0  # standard deviations that a band shows on either side


def given_or_new(axes: Axes | None, width: float = 4.6, height: float = 3.3) -> Axes:
    """Return the given axes, or the axes of a new figure of a given size in inches."""
    return Figure(figsize=(width, height), layout="constrained").subplots() if axes is None else axes


def finished(axes: Axes) -> Axes:
    """Add a light grid to axes, and a legend if any line has a name; return the axes."""
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize="small")
    return axes
