"""Writing of figures as PNG files that carry a mark of fingerflow, so that later runs replace no other files."""

from pathlib import Path

from matplotlib.figure import Figure

from fingerflow.results.atomic_write import MARK, write_atomically

_DPI = 110


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG atomically; raise FingerflowError if it cannot be written."""
    write_atomically(path, lambda part: figure.savefig(part, format="png", dpi=_DPI, metadata={"Comment": MARK}))
