"""Convert a matplotlib figure to inline SVG for a page, with curve values that the page shows at the cursor."""

import base64
import io
import re
from html import escape
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fingerflow.plot.axes_style import FONT
from fingerflow.plot.figure_files import settle

_NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}
_RASTER_DPI = 170  # dots per inch of rasterized maps
_WIDER = 1.5  # largest magnification of a figure relative to its printed size
_DIGITS = 5
_LARGE, _QUALITY = 100_000, 88  # size in bytes above which an image is stored as JPEG; JPEG quality in percent
_PNG = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=\s]+)")
_OWN_ID = re.compile(r' id="[A-Za-z][\w.]*_\d+"')
_UNIT = re.compile(r"\(([^()]*)\)$")


def inline_svg(figure: Figure, name: str, label: str) -> str:
    """Return a figure as an <svg> element of its container's width; text is kept as text, not as outlines.

    Args:
        figure: figure to draw.
        name: unique in the page; ids within the figure are derived from it.
        label: text alternative (aria-label).
    """
    settle(figure)
    data = io.StringIO()
    figure.set_dpi(_RASTER_DPI)
    # Readers copy numbers to where U+2212 is no minus.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "axes.unicode_minus": False}):
        # `savefig` would draw the figure twice, the first time to settle the layout.
        FigureCanvasSVG(figure).print_svg(data, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
    text = data.getvalue()
    text = text[text.index("<svg") :]
    head, _, rest = text.partition(">")
    box = re.search(r'viewBox="[^"]*"', head)
    assert box is not None
    # Ids must be unique in a page, so only those that are referred to are kept.
    rest = _PNG.sub(_compressed, rest)
    rest = rest.replace(f"'{FONT}'", f"'{FONT}', sans-serif")
    rest = _OWN_ID.sub("", re.sub(r"\s*<metadata>.*?</metadata>", "", rest, flags=re.DOTALL))
    # A reader's font may be larger than that of the layout, and would be cut at the edge.
    style = f"overflow:visible;max-width:{_WIDER * figure.get_figwidth():.1f}in"
    return f'<svg {box[0]} role="img" aria-label="{escape(label)}" style="{style}">{rest}'


def _compressed(match: re.Match[str]) -> str:
    """Return the data URI of an image as JPEG if the image is large and opaque, else unchanged."""
    data = np.frombuffer(base64.b64decode(match[1]), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) > _LARGE else None
    if image is None or (image.shape[2] == 4 and image[..., 3].min() < 255):
        return match[0]
    coded = cv2.imencode(".jpg", image[..., :3], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(coded.tobytes()).decode('ascii')}"


def hover_curves(axes: Axes, count: int) -> dict[str, Any] | None:
    """Return the labelled curves of axes that have `count` values, with axis limits, labels and place in the figure,
    for the page to display values at the cursor; None if there are none.

    The axes must have been drawn by `inline_svg`, which settles their layout. Return None without such a curve.
    ``box`` is left, top, width and height as shares of the figure.
    """
    named = [line for line in axes.lines if not str(line.get_label()).startswith("_")]
    lines = [line for line in named if len(np.asarray(line.get_xdata())) == count]
    if not lines:
        return None
    box = axes.get_position()
    unit = _UNIT.search(axes.get_ylabel())
    return {
        "box": _rounded((box.x0, 1 - box.y1, box.width, box.height)),
        "xlim": _rounded(axes.get_xlim()),
        "ylim": _rounded(axes.get_ylim()),
        "label": axes.get_xlabel(),
        "unit": "" if unit is None else unit[1],
        "x": _rounded(lines[0].get_xdata()),
        "curves": [
            {"name": str(line.get_label()), "colour": str(line.get_color()), "y": _rounded(line.get_ydata())}
            for line in lines
        ],
    }


def _rounded(values: ArrayLike) -> list[float | None]:
    """Return numbers rounded to five significant digits for JSON, with None (null) for those that are not finite."""
    numbers = np.asarray(values, dtype=float)
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in numbers]
