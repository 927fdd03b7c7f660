"""What all figures of the models share."""

from matplotlib.axes import Axes

INK, RED, GREEN, YELLOW, GREY = "#1f3b57", "#d1495b", "#3c8d5a", "#edae49", "#9aa5b1"


def finished(axes: Axes) -> Axes:
    """With a light grid, and a legend where lines have names."""
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize="small")
    return axes
