"""Figures as PNG files with a mark of fingerflow, by which a later run knows which files it may replace."""

from pathlib import Path

from matplotlib.figure import Figure

from fingerflow.results.atomic_write import MARK, write_atomically

_DPI = 110


def save_figure(figure: Figure, path: Path) -> None:
    """Write a PNG atomically; raise FingerflowError if it cannot be written."""
    write_atomically(path, lambda part: figure.savefig(part, format="png", dpi=_DPI, metadata={"Comment": MARK}))
