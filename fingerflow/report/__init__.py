"""Report of a processed scene: figures, a self-contained page and a video."""

from fingerflow.report.overlay import write_overlay
from fingerflow.report.page import write_report

__all__ = ["write_overlay", "write_report"]
