"""A matplotlib figure as SVG inside a page, and the curves in it as numbers for the page to read out."""

import io
import re
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}
_RASTER_DPI = 170  # of the maps within
_DIGITS = 5
_OWN_ID = re.compile(r' id="[A-Za-z]+[0-9A-Za-z]*_\d+"')
_UNIT = re.compile(r"\(([^()]*)\)$")


def inline_svg(figure: Figure, name: str, label: str) -> str:
    """The element <svg> of a figure, as wide as its place; its text is text.

    Args:
        figure: to draw.
        name: of its own in the page: what is referred to within the figure is named by it.
        label: what it shows, for those who do not see it.
    """
    data = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(data, format="svg", dpi=_RASTER_DPI, metadata=_NO_METADATA)
    text = data.getvalue()
    text = text[text.index("<svg") :]
    head, _, rest = text.partition(">")
    box = re.search(r'viewBox="[^"]*"', head)
    assert box is not None
    # The same element twice in a page would share an id: only those that are referred to keep theirs.
    rest = _OWN_ID.sub("", re.sub(r"\s*<metadata>.*?</metadata>", "", rest, flags=re.DOTALL))
    width = figure.get_figwidth()
    return f'<svg {box[0]} role="img" aria-label="{escape(label)}" style="max-width:{1.55 * width:.1f}in">{rest}'


def curves_of(axes: Axes, count: int) -> dict[str, Any] | None:
    """What the page reads out at the cursor: curves of `count` frames, and where in the figure they stand.

    None where the axes have no such curve. ``box`` is left, top, width and height as shares of the figure.
    """
    lines = [line for line in axes.lines if len(line.get_xdata()) == count and not str(line.get_label()).startswith("_")]
    if not lines:
        return None
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()  # the layout is known only then
    place = axes.get_position()
    unit = _UNIT.search(axes.get_ylabel())
    return {
        "box": [_short(one) for one in (place.x0, 1 - place.y1, place.width, place.height)],
        "xlim": [_short(one) for one in axes.get_xlim()],
        "ylim": [_short(one) for one in axes.get_ylim()],
        "label": axes.get_xlabel(),
        "unit": "" if unit is None else unit[1],
        "x": [_short(one) for one in np.asarray(lines[0].get_xdata(), dtype=float)],
        "curves": [
            {
                "name": str(line.get_label()),
                "colour": str(line.get_color()),
                "y": [_short(one) for one in np.asarray(line.get_ydata(), dtype=float)],
            }
            for line in lines
        ],
    }


def _short(value: float) -> float | None:
    """Five digits; None, which JSON has, for what is not known."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None
