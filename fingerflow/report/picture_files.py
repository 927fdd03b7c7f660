"""Figures as PNG files that say who drew them, by which a later run knows what it may replace."""

from pathlib import Path

from matplotlib.figure import Figure

from fingerflow.results.atomic_write import MARK, write_atomically

_DPI = 110


def save_figure(figure: Figure, path: Path) -> None:
    """Writes a PNG, whole or not at all; raises FingerflowError where it cannot be written."""
    write_atomically(path, lambda part: figure.savefig(part, format="png", dpi=_DPI, metadata={"Comment": MARK}))
