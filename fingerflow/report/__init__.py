"""Report of a processed recording: figures, a self-contained HTML page and a video."""

from fingerflow.report.overlay import write_overlay
from fingerflow.report.page import write_report

__all__ = ["write_overlay", "write_report"]
